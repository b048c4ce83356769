#include "gld/page/page.h"

#include "gld/page/embedded_page.h"
#include "gld/page/page_text.h"

#include <map>

namespace gld {
namespace {

// Returns the policy of one page: nothing is fetched, and of scripts and styles only those run that the build put in.
std::string policy_text() {
  std::string scripts, styles;
  for (const PagePart& part : embedded_page()) {
    const bool is_script = part.seam == "three" || part.seam == "controls" || part.seam == "scripts";
    if (is_script) scripts += " " + policy_hash(part.text);
    if (part.seam == "style") styles += " " + policy_hash(part.text);
  }
  return "default-src 'none'; img-src data:; script-src" + scripts + "; style-src" + styles +
         "; base-uri 'none'; form-action 'none'";
}

std::string provenance_elements(const TextItems& items) {
  std::string html;
  for (const auto& [name, text] : items) {
    html += "<meta name=\"" + html_text(name) + "\" content=\"" + html_text(text) + "\">\n";
  }
  return html;
}

std::string list_elements(const std::vector<std::string>& texts) {
  std::string html;
  for (const std::string& text : texts) html += "<li>" + html_text(text) + "</li>\n";
  return html;
}

std::string reload_element(int64_t seconds) {
  if (seconds <= 0) return "";
  return "<meta http-equiv=\"refresh\" content=\"" + std::to_string(seconds) + "\">\n";
}

std::map<std::string, std::string> filled_seams(const Page& page) {
  static const std::string policy = policy_text();
  return {{"policy", html_text(policy)},
          {"provenance", provenance_elements(page.provenance)},
          {"reload", reload_element(page.reload_seconds)},
          {"title", html_text(page.title)},
          {"heading", html_text(page.heading)},
          {"asked", html_text(page.asked)},
          {"verdict", html_text(page.verdict)},
          {"doubts", list_elements(page.doubts)},
          {"data", script_json(page.data)}};
}

}  // namespace

std::string page_html(const Page& page) {
  const auto seams = filled_seams(page);
  std::string html;
  for (const PagePart& part : embedded_page()) {
    const auto filled = seams.find(part.seam);
    if (part.seam == "notice") {
      html += escaped_text(part.text);
    } else if (filled != seams.end()) {
      html += filled->second;
    } else {
      html += part.text;
    }
  }
  return html;
}

size_t page_size(const Page& page) { return page_html(page).size(); }

}  // namespace gld
