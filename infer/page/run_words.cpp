#include "infer/page/run_words.h"

#include "gld/page/run_report.h"

#include <fmt/format.h>

namespace gld {
namespace {

std::string counted(size_t count, const std::string& what) {
  return fmt::format("{} {}{}", count, what, count == 1 ? "" : "s");
}

}  // namespace

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
  std::string sentence = report_text_at(report, "/verdict/sentence");
  if (!sentence.empty()) return sentence;
  return "No pictures were asked for, so that nothing is said of their quality.";
}

}  // namespace gld
