#include "infer/run_export/export_provenance.h"

#include <fmt/format.h>

namespace gld {
namespace {

std::string escaped(const std::string& text) {
  std::string result;
  for (const char letter : text) {
    switch (letter) {
      case '&':
        result += "&amp;";
        break;
      case '<':
        result += "&lt;";
        break;
      case '>':
        result += "&gt;";
        break;
      default:
        result += static_cast<unsigned char>(letter) < ' ' ? ' ' : letter;
    }
  }
  return result;
}

// It leaves "gld:run_options" as it is, and makes of "Software" the property that XMP has for it.
std::string element_name(const std::string& name) {
  return name.rfind("gld:", 0) == 0 ? name : "xmp:CreatorTool";
}

}  // namespace

TextItems export_provenance(const FinishedRun& run, const std::string& export_options) {
  Provenance provenance;
  provenance.program = program_version();
  provenance.command = "export";
  provenance.options = export_options;
  provenance.model_hash = run.model_hash;
  provenance.seed = run.seed;
  provenance.precision = run.precision;
  TextItems items = provenance_items(provenance);
  items.emplace_back("gld:run_options", run.options);
  return items;
}

std::string xmp_packet(const TextItems& items) {
  std::string text =
      "<?xpacket begin=\"\xEF\xBB\xBF\" id=\"W5M0MpCehiHzreSzNTczkc9d\"?>\n"
      "<x:xmpmeta xmlns:x=\"adobe:ns:meta/\">\n"
      "<rdf:RDF xmlns:rdf=\"http://www.w3.org/1999/02/22-rdf-syntax-ns#\">\n"
      "<rdf:Description rdf:about=\"\" xmlns:xmp=\"http://ns.adobe.com/xap/1.0/\" xmlns:gld=\"urn:gld:\">\n";
  for (const auto& [name, value] : items) {
    const std::string element = element_name(name);
    text += fmt::format("<{}>{}</{}>\n", element, escaped(value), element);
  }
  return text + "</rdf:Description>\n</rdf:RDF>\n</x:xmpmeta>\n<?xpacket end=\"r\"?>";
}

}  // namespace gld
