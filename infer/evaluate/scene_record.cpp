#include "infer/evaluate/scene_record.h"

#include "gld/base/error.h"

#include <cmath>
#include <limits>
#include <string>
#include <vector>

namespace gld {
namespace {

double number_from(const nlohmann::json& value) {
  if (value.is_null()) return std::numeric_limits<double>::quiet_NaN();
  if (value == "inf") return std::numeric_limits<double>::infinity();
  if (value == "-inf") return -std::numeric_limits<double>::infinity();
  return value.get<double>();
}

}  // namespace

nlohmann::ordered_json number_record(double value) {
  if (std::isnan(value)) return nullptr;
  if (std::isinf(value)) return value > 0 ? "inf" : "-inf";
  return value;
}

nlohmann::ordered_json scene_record(const SceneEvaluation& scene) {
  nlohmann::ordered_json record{{"scene", scene.scene},
                                {"samples", scene.samples},
                                {"sources", scene.sources},
                                {"targets", scene.targets}};
  auto& numbers = record["numbers"] = nlohmann::ordered_json::object();
  const auto& columns = evaluation_columns();
  for (size_t i = 0; i < columns.size(); ++i) {
    const SceneNumber& number = scene.numbers[i];
    auto& entry = numbers[columns[i].name] = {{"value", number_record(number.value)}};
    if (!number.absent.empty()) entry["absent"] = number.absent;
    if (number.absent_samples > 0) entry["absent_samples"] = number.absent_samples;
    if (number.of_targets.empty()) continue;
    auto& samples = entry["of_targets"] = nlohmann::ordered_json::array();
    for (const auto& targets : number.of_targets) {
      auto list = nlohmann::ordered_json::array();
      for (const double value : targets) list.push_back(number_record(value));
      samples.push_back(std::move(list));
    }
  }
  return record;
}

SceneEvaluation scene_from_record(const nlohmann::json& record, const std::string& where) {
  try {
    SceneEvaluation scene;
    scene.scene = record.at("scene");
    scene.samples = record.at("samples");
    scene.sources = record.at("sources").get<std::vector<std::string>>();
    scene.targets = record.at("targets").get<std::vector<std::string>>();
    const auto& numbers = record.at("numbers");
    for (const EvaluationColumn& column : evaluation_columns()) {
      const auto found = numbers.find(column.name);
      SceneNumber number;
      if (found == numbers.end()) {
        number.value = std::numeric_limits<double>::quiet_NaN();
        number.absent = "the version of the program that evaluated the scene did not measure it";
      } else {
        number.value = number_from(found->at("value"));
        number.absent = found->value("absent", "");
        number.absent_samples = found->value("absent_samples", int64_t{0});
        if (found->contains("of_targets")) {
          for (const auto& sample : found->at("of_targets")) {
            auto& targets = number.of_targets.emplace_back();
            for (const auto& value : sample) targets.push_back(number_from(value));
          }
        }
      }
      scene.numbers.push_back(std::move(number));
    }
    return scene;
  } catch (const nlohmann::json::exception& error) {
    fail({where, "a scene that gld eval has measured", error.what(),
          "remove the file: the scene is measured again"});
  }
}

}  // namespace gld
