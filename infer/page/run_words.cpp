#include "infer/page/run_words.h"

#include <algorithm>
#include <cctype>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr const char* kScaleWarning = "The scale of the predicted depth is not known";

// "a word" -> "A word."
std::string as_sentence(std::string text) {
  if (text.empty()) return text;
  text[0] = static_cast<char>(std::toupper(static_cast<unsigned char>(text[0])));
  if (text.back() != '.' && text.back() != '!' && text.back() != '?') text += '.';
  return text;
}

std::string counted(size_t count, const std::string& what) {
  return fmt::format("{} {}{}", count, what, count == 1 ? "" : "s");
}

}  // namespace

const nlohmann::ordered_json& report_value(const nlohmann::ordered_json& report, const std::string& path) {
  static const nlohmann::ordered_json none;
  const nlohmann::ordered_json::json_pointer pointer(path);
  return report.contains(pointer) ? report.at(pointer) : none;
}

std::string report_text_at(const nlohmann::ordered_json& report, const std::string& path) {
  const auto& value = report_value(report, path);
  return value.is_string() ? value.get<std::string>() : "";
}

std::string asked_of_sample(const nlohmann::ordered_json& report) {
  const auto& views = report_value(report, "/scene/views");
  const auto& sources = report_value(report, "/scene/sources");
  if (!views.is_array() || !sources.is_number_unsigned() || sources.get<size_t>() > views.size()) return "";
  const auto given = sources.get<size_t>();
  const auto& width = report_value(report, "/scene/width");
  const auto& height = report_value(report, "/scene/height");
  const std::string size = width.is_number() && height.is_number()
                               ? fmt::format(" at {}x{} pixels", width.dump(), height.dump())
                               : "";
  const std::string model = report_text_at(report, "/model/name");
  return fmt::format("Asked for: {} of {} from {}{}{}.", counted(views.size() - given, "new view"),
                     report_text_at(report, "/scene/name"), counted(given, "photograph"), size,
                     model.empty() ? "" : ", by the model " + model);
}

std::string verdict_of_sample(const nlohmann::ordered_json& report) {
  const std::string sentence = report_text_at(report, "/verdict/sentence");
  if (!sentence.empty()) return sentence;
  return "No pictures were asked for, so that nothing is said of their quality.";
}

std::vector<std::string> doubts_of_run(const nlohmann::ordered_json& report) {
  std::vector<std::string> doubts;
  const auto add = [&](const std::string& text) {
    const std::string sentence = as_sentence(text);
    if (!sentence.empty() && std::find(doubts.begin(), doubts.end(), sentence) == doubts.end()) {
      doubts.push_back(sentence);
    }
  };
  const auto is_true = [&](const std::string& path) {
    const auto& value = report_value(report, path);
    return value.is_boolean() && value.get<bool>();
  };
  // Where the photographs are unlike what it has seen, the verdict says so.
  if (is_true("/verdict/drawn_rooms_only") && !is_true("/verdict/unfamiliar")) {
    add("The model has seen drawn rooms only: do not expect it to know what real places look like");
  }
  const auto& warnings = report_value(report, "/warnings");
  if (!warnings.is_array()) return doubts;
  for (const auto& warning : warnings) {
    if (!warning.is_string()) continue;
    const auto text = warning.get<std::string>();
    add(text.rfind(kScaleWarning, 0) == 0
            ? "How large the scene is is not known: depth, cloud and cameras are in the model's own unit"
            : text);
  }
  return doubts;
}

}  // namespace gld
