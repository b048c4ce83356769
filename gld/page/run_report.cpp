#include "gld/page/run_report.h"

#include "gld/base/atomic_file.h"
#include "gld/base/json_text.h"

#include <algorithm>
#include <cctype>

namespace gld {
namespace {

constexpr uint64_t kLargestReport = uint64_t{1} << 28;

// Turns "a word" into "A word."
std::string as_sentence(std::string text) {
  if (text.empty()) return text;
  text[0] = static_cast<char>(std::toupper(static_cast<unsigned char>(text[0])));
  if (text.back() != '.' && text.back() != '!' && text.back() != '?') text += '.';
  return text;
}

}  // namespace

nlohmann::ordered_json read_run_report(const std::filesystem::path& run) {
  const auto file = run / "report.json";
  return parse_ordered_json(read_file(file, kLargestReport), file.string());
}

const nlohmann::ordered_json& report_value(const nlohmann::ordered_json& report, const std::string& path) {
  static const nlohmann::ordered_json none;
  const nlohmann::ordered_json::json_pointer pointer(path);
  return report.contains(pointer) ? report.at(pointer) : none;
}

std::string report_text_at(const nlohmann::ordered_json& report, const std::string& path) {
  const auto& value = report_value(report, path);
  return value.is_string() ? value.get<std::string>() : "";
}

std::string report_number_at(const nlohmann::ordered_json& report, const std::string& path) {
  const auto& value = report_value(report, path);
  return value.is_number() ? value.dump() : "";
}

std::vector<std::string> doubts_of_run(const nlohmann::ordered_json& report) {
  std::vector<std::string> doubts;
  const auto add = [&](const std::string& text) {
    const std::string sentence = as_sentence(text);
    if (!sentence.empty() && std::find(doubts.begin(), doubts.end(), sentence) == doubts.end()) {
      doubts.push_back(sentence);
    }
  };
  const auto& warnings = report_value(report, "/warnings");
  if (!warnings.is_array()) return doubts;
  for (const auto& warning : warnings) {
    if (!warning.is_string()) continue;
    const auto text = warning.get<std::string>();
    add(text.rfind(kScaleNotKnown, 0) == 0
            ? "How large the scene is is not known: depth, cloud and cameras are in the model's own unit"
            : text);
  }
  return doubts;
}

TextItems provenance_of_run(const nlohmann::ordered_json& report) {
  Provenance provenance;
  provenance.program = program_version();
  provenance.command = report_text_at(report, "/command");
  const nlohmann::ordered_json& options = report_value(report, "/options");
  if (options.is_object()) provenance.options = identifying_options(options);
  provenance.model_hash = report_text_at(report, "/model/hash");
  if (provenance.model_hash.empty()) provenance.model_hash = report_text_at(report, "/model_hash");
  const nlohmann::ordered_json& seed = report_value(report, "/seed");
  if (seed.is_number_integer()) provenance.seed = seed.get<int64_t>();
  provenance.precision = report_text_at(report, "/precision");
  return provenance_items(provenance);
}

}  // namespace gld
