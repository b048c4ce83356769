#include "infer/evaluate/evaluation_report.h"

#include "gld/metrics/metric_list.h"
#include "gld/report/table.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

// JSON has no NaN and no infinity.
nlohmann::ordered_json number_or_null(double value) {
  return std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json();
}

double number_of(const nlohmann::ordered_json& value) {
  return value.is_null() ? std::numeric_limits<double>::quiet_NaN() : value.get<double>();
}

nlohmann::ordered_json statistics_json(const EvaluationColumn& column,
                                       const std::vector<SceneEvaluation>& scenes) {
  std::vector<double> values;
  nlohmann::ordered_json reasons = nlohmann::ordered_json::object();
  for (const SceneEvaluation& scene : scenes) {
    const SceneNumber& number = scene.number(column.name);
    values.push_back(number.value);
    if (!number.absent.empty()) reasons[number.absent] = reasons.value(number.absent, 0) + 1;
  }
  int64_t absent_samples = 0;
  for (const SceneEvaluation& scene : scenes) absent_samples += scene.number(column.name).absent_samples;
  const SceneStatistics statistics = statistics_over_scenes(values);
  const Interval& interval = statistics.interval;
  nlohmann::ordered_json json{{"mean", number_or_null(statistics.mean)},
                              {"interval_95", {number_or_null(interval.low), number_or_null(interval.high)}},
                              {"deviation", number_or_null(statistics.deviation)},
                              {"scenes", statistics.count},
                              {"unit", column.metric.unit},
                              {"better", better_name(column.metric.better)}};
  if (statistics.infinite > 0) json["infinite"] = statistics.infinite;
  if (!reasons.empty()) json["absent"] = reasons;
  if (absent_samples > 0) json["absent_samples"] = absent_samples;
  return json;
}

// Returns the median, of an even number the upper middle one.
double median_over_scenes(std::vector<double> values) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

const EvaluationColumn* column_of(const Metric& metric, const Predictor& predictor) {
  for (const EvaluationColumn& column : evaluation_columns()) {
    if (column.metric.name == metric.name && column.of == predictor) return &column;
  }
  return nullptr;
}

std::string with_interval(const nlohmann::ordered_json& statistics, const std::string& unit) {
  if (statistics.at("mean").is_null()) return statistics.contains("infinite") ? "infinite" : "absent";
  const double mean = statistics.at("mean").get<double>();
  // A small number keeps two digits of its own.
  const bool small = mean != 0 && std::abs(mean) < 0.01;
  const int digits = unit == "dB" || unit == "degrees" ? 2 : 3;
  const auto text = [&](double value) {
    return small ? fmt::format("{:.1e}", value) : fmt::format("{:.{}f}", value, digits);
  };
  const auto& interval = statistics.at("interval_95");
  if (interval.at(0).is_null()) return text(mean);
  return fmt::format("{} [{}, {}]", text(mean), text(interval.at(0).get<double>()),
                     text(interval.at(1).get<double>()));
}

std::string name_with_unit(const Metric& metric) {
  return metric.unit.empty() ? metric.name : metric.name + " (" + metric.unit + ")";
}

// Returns a line a reason: "depth_abs_rel_unscaled, depth_rmse_unscaled: absent in 52 of 64 scenes, the cameras do not
// tell ...".
std::string absent_text(const nlohmann::ordered_json& means, size_t scenes) {
  std::vector<std::pair<std::string, std::string>> names_by_reason;
  for (const Metric& metric : metric_list()) {
    const auto& statistics = means.at(column_of(metric, Predictor::kSample)->name);
    if (!statistics.contains("absent")) continue;
    for (const auto& item : statistics.at("absent").items()) {
      const auto reason =
          fmt::format("absent in {} of {} scenes, {}", item.value().get<int64_t>(), scenes, item.key());
      const auto known = std::find_if(names_by_reason.begin(), names_by_reason.end(),
                                      [&](const auto& entry) { return entry.first == reason; });
      if (known == names_by_reason.end()) {
        names_by_reason.emplace_back(reason, metric.name);
      } else {
        known->second += ", " + metric.name;
      }
    }
  }
  std::string text;
  for (const auto& [reason, names] : names_by_reason) text += fmt::format("{}: {}\n", names, reason);
  return text;
}

std::string image_table(const nlohmann::ordered_json& means) {
  std::vector<std::string> header{"target views"};
  for (const Predictor& predictor : main_predictors()) {
    std::string name = predictor_name(predictor);
    std::replace(name.begin(), name.end(), '_', ' ');
    header.push_back(name);
  }
  Table table(header);
  for (const Metric& metric : metric_list()) {
    if (!of_every_predictor(metric)) continue;
    std::vector<TableCell> row{name_with_unit(metric)};
    for (const Predictor& predictor : main_predictors()) {
      row.emplace_back(with_interval(means.at(column_of(metric, predictor)->name), metric.unit));
    }
    table.add_row(row);
  }
  return table.markdown();
}

// Returns how often samples win, and of how many scenes that have both numbers.
nlohmann::ordered_json wins_json(const std::vector<SceneEvaluation>& scenes, const Predictor& rival,
                                 const Metric& metric) {
  int64_t won = 0, compared = 0;
  for (const SceneEvaluation& scene : scenes) {
    const auto wins = scene.sample_wins(rival, metric);
    compared += wins ? 1 : 0;
    won += wins.value_or(false) ? 1 : 0;
  }
  return {{"won", won}, {"scenes", compared}};
}

std::string wins_table(const nlohmann::ordered_json& wins) {
  std::vector<std::string> header{"scenes where samples win against"};
  for (const Metric& metric : compared_metrics()) header.push_back(metric.name);
  Table table(header);
  for (const Predictor& rival : rivals()) {
    std::string name = predictor_name(rival);
    std::replace(name.begin(), name.end(), '_', ' ');
    std::vector<TableCell> row{name};
    for (const Metric& metric : compared_metrics()) {
      const auto& of_both = wins.at(metric.name).at(predictor_name(rival));
      const auto compared = of_both.at("scenes").get<int64_t>();
      row.emplace_back(compared == 0 ? std::string("absent")
                                     : fmt::format("{} of {}", of_both.at("won").get<int64_t>(), compared));
    }
    table.add_row(row);
  }
  return table.markdown();
}

// Returns what the energy score of samples is made of: with one sample a scene it is no score of its distribution.
nlohmann::ordered_json energy_score_json(const std::vector<SceneEvaluation>& scenes) {
  int64_t fewest = std::numeric_limits<int64_t>::max();
  for (const SceneEvaluation& scene : scenes) fewest = std::min(fewest, scene.samples);
  const bool pairs = fewest > 1;
  return {{"samples", fewest},
          {"formula", pairs ? "E|x - y| - E|x - x'| / 2" : "|x - y|"},
          {"note", pairs ? "proper: unbiased over pairs of different samples"
                         : "of one sample a scene its distance alone, which a blur wins; --samples 2 or more "
                           "make it the energy score"}};
}

std::string geometry_table(const nlohmann::ordered_json& means) {
  Table table({"geometry and latents", "mean", "scenes"});
  for (const EvaluationColumn& column : evaluation_columns()) {
    if (of_every_predictor(column.metric) || column.of == Predictor::kWarpedSources) continue;
    const auto& statistics = means.at(column.name);
    if (statistics.at("scenes") == 0 && !statistics.contains("infinite")) continue;  // absent_text says why
    const std::string& unit = column.metric.unit;
    table.add_row({unit.empty() ? column.name : column.name + " (" + unit + ")",
                   with_interval(statistics, unit), std::to_string(statistics.at("scenes").get<int64_t>())});
  }
  return table.markdown();
}

// Quotes as RFC 4180 does: names of scenes are names of folders.
std::string csv_cell(const std::string& text) {
  if (text.find_first_of(",\"\n\r") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + "\"";
}

// Returns those whose wins stand in the rows of eval.csv.
const std::vector<Metric>& metrics_of_rows() {
  static const std::vector<Metric> metrics{metric_named("energy_score"),
                                           metric_named("energy_score_features")};
  return metrics;
}

std::string win_column(const Predictor& rival, const Metric& metric) {
  return "sample_wins_" + metric.name + "_" + predictor_name(rival);
}

std::string target_cell(const SceneNumber& number, size_t sample, size_t target) {
  if (sample >= number.of_targets.size() || target >= number.of_targets[sample].size()) return "";
  const double value = number.of_targets[sample][target];
  return std::isnan(value) ? "" : fmt::format("{:.6f}", value);
}

// Returns the finite ones, ascending.
std::vector<double> sorted_values(const std::vector<SceneEvaluation>& scenes, const std::string& column) {
  std::vector<double> values;
  for (const SceneEvaluation& scene : scenes) {
    const double value = scene.number(column).value;
    if (std::isfinite(value)) values.push_back(value);
  }
  std::sort(values.begin(), values.end());
  return values;
}

}  // namespace

std::string evaluation_csv(const std::vector<SceneEvaluation>& scenes) {
  std::string text = "scene";
  for (const EvaluationColumn& column : evaluation_columns()) text += "," + column.name;
  for (const Predictor& trivial : trivial_predictors()) text += ",sample_beats_" + predictor_name(trivial);
  for (const Metric& metric : metrics_of_rows()) {
    for (const Predictor& rival : rivals()) text += "," + win_column(rival, metric);
  }
  text += ",sources,samples\n";
  for (const SceneEvaluation& scene : scenes) {
    text += csv_cell(scene.scene);
    for (const SceneNumber& number : scene.numbers) {
      text += number.absent.empty() ? fmt::format(",{:.6f}", number.value) : ",";
    }
    for (const Predictor& trivial : trivial_predictors()) text += scene.sample_beats(trivial) ? ",1" : ",0";
    for (const Metric& metric : metrics_of_rows()) {
      for (const Predictor& rival : rivals()) {
        const auto wins = scene.sample_wins(rival, metric);
        text += !wins ? "," : *wins ? ",1" : ",0";
      }
    }
    text += fmt::format(",{},{}\n", scene.sources.size(), scene.samples);
  }
  return text;
}

std::string targets_csv(const std::vector<SceneEvaluation>& scenes) {
  const auto& columns = evaluation_columns();
  std::vector<size_t> shown;
  for (size_t i = 0; i < columns.size(); ++i) {
    if (std::any_of(scenes.begin(), scenes.end(),
                    [&](const SceneEvaluation& scene) { return !scene.numbers[i].of_targets.empty(); })) {
      shown.push_back(i);
    }
  }
  std::string text = "scene,sources,sample,target";
  for (const size_t i : shown) text += "," + columns[i].name;
  text += '\n';
  for (const SceneEvaluation& scene : scenes) {
    for (int64_t sample = 0; sample < scene.samples; ++sample) {
      for (size_t target = 0; target < scene.targets.size(); ++target) {
        text += fmt::format("{},{},{},{}", csv_cell(scene.scene), scene.sources.size(), sample,
                            csv_cell(scene.targets[target]));
        for (const size_t i : shown)
          text += "," + target_cell(scene.numbers[i], static_cast<size_t>(sample), target);
        text += '\n';
      }
    }
  }
  return text;
}

std::vector<MetricPicture> metric_pictures(const std::vector<SceneEvaluation>& scenes) {
  std::vector<MetricPicture> pictures;
  for (const Metric& metric : metric_list()) {
    PlotPanel panel;
    panel.x.label = "scenes, sorted";
    panel.y.label = name_with_unit(metric) + ", " + better_name(metric.better) + " is better";
    for (const Predictor& predictor : main_predictors()) {
      const EvaluationColumn* column = column_of(metric, predictor);
      if (column == nullptr) continue;
      const auto values = sorted_values(scenes, column->name);
      if (values.size() < 2) continue;
      PlotSeries series;
      series.name = column->name == metric.name ? "sample" : predictor_name(predictor);
      std::replace(series.name.begin(), series.name.end(), '_', ' ');
      for (size_t i = 0; i < values.size(); ++i)
        series.points.emplace_back(static_cast<double>(i + 1), values[i]);
      panel.series.push_back(std::move(series));
    }
    if (panel.series.empty()) continue;
    panel.title = fmt::format("{} over {} scenes", metric.name, scenes.size());
    pictures.push_back({metric.name, {"gld eval", {std::move(panel)}}});
  }
  return pictures;
}

nlohmann::ordered_json evaluation_summary(const std::vector<SceneEvaluation>& scenes) {
  nlohmann::ordered_json means;
  for (const EvaluationColumn& column : evaluation_columns()) {
    means[column.name] = statistics_json(column, scenes);
  }
  const Metric& metric = metric_named("psnr");
  const auto mean_psnr = [&](const Predictor& predictor) {
    return number_of(means.at(column_of(metric, predictor)->name).at("mean"));
  };
  const auto& trivial = trivial_predictors();
  const Predictor best =
      *std::max_element(trivial.begin(), trivial.end(),
                        [&](const Predictor& a, const Predictor& b) { return mean_psnr(a) < mean_psnr(b); });
  nlohmann::ordered_json summary = {{"scenes", scenes.size()}, {"means", means}};
  summary["best_trivial_predictor"] = column_of(metric, best)->name;
  summary["sample_margin_over_best_trivial_db"] =
      number_or_null(mean_psnr(Predictor::kSample) - mean_psnr(best));
  summary["mean_prediction_margin_over_best_trivial_db"] =
      number_or_null(mean_psnr(Predictor::kMeanPrediction) - mean_psnr(best));
  for (const Predictor& predictor : trivial) {
    summary["sample_beats"][predictor_name(predictor)] =
        std::count_if(scenes.begin(), scenes.end(),
                      [&](const SceneEvaluation& scene) { return scene.sample_beats(predictor); });
  }
  summary["better_than_every_trivial"] =
      std::count_if(scenes.begin(), scenes.end(),
                    [](const SceneEvaluation& scene) { return scene.sample_beats_every_trivial(); });
  for (const Metric& compared : compared_metrics()) {
    for (const Predictor& rival : rivals()) {
      summary["sample_wins"][compared.name][predictor_name(rival)] = wins_json(scenes, rival, compared);
    }
  }
  summary["energy_score"] = energy_score_json(scenes);
  // A scene whose scale is not known is one where it is missed.
  const auto right = std::count_if(scenes.begin(), scenes.end(), [](const SceneEvaluation& scene) {
    const double ratio = scene.number("depth_scale_ratio").value;
    return ratio >= 0.9 && ratio <= 1.1;
  });
  const auto unknown = std::count_if(scenes.begin(), scenes.end(), [](const SceneEvaluation& scene) {
    return std::isnan(scene.number("depth_scale_ratio").value);
  });
  summary["depth_scale"] = {{"within_10_percent", right}, {"unknown", unknown}};
  std::vector<double> distances;
  for (const SceneEvaluation& scene : scenes) {
    const double distance = scene.number("cloud_distance").value;
    distances.push_back(std::isnan(distance) ? std::numeric_limits<double>::infinity() : distance);
  }
  summary["median_cloud_distance"] = number_or_null(median_over_scenes(distances));
  return summary;
}

std::string evaluation_text(const nlohmann::ordered_json& summary) {
  const auto& means = summary.at("means");
  const auto scenes = summary.at("scenes").get<size_t>();
  std::string text =
      image_table(means) + "\n" + wins_table(summary.at("sample_wins")) + "\n" + geometry_table(means) + "\n";
  text += absent_text(means, scenes);
  text += fmt::format("samples are better than every trivial predictor in {} of {} scenes (PSNR)\n",
                      summary.at("better_than_every_trivial").get<int64_t>(), scenes);
  const auto& energy = summary.at("energy_score");
  text +=
      fmt::format("energy scores of samples: {} ({} a scene), {}\n", energy.at("formula").get<std::string>(),
                  energy.at("samples").get<int64_t>(), energy.at("note").get<std::string>());
  const auto& scale = summary.at("depth_scale");
  const auto& distance = summary.at("median_cloud_distance");
  text += fmt::format(
      "the scale of depth is within 10 % of the true one in {} of {} scenes (unknown in {}); median distance of the "
      "cloud from the true surface: {}\n",
      scale.at("within_10_percent").get<int64_t>(), scenes, scale.at("unknown").get<int64_t>(),
      distance.is_null() ? "unknown"
                         : fmt::format("{:.2f} % of the scene's largest side", 100 * distance.get<double>()));
  const auto margin = [&](const char* key) {
    const auto& value = summary.at(key);
    return value.is_null() ? std::string("unknown") : fmt::format("{:+.2f} dB", value.get<double>());
  };
  return text + fmt::format("over {}: samples {}, mean prediction {}\n",
                            summary.at("best_trivial_predictor").get<std::string>(),
                            margin("sample_margin_over_best_trivial_db"),
                            margin("mean_prediction_margin_over_best_trivial_db"));
}

}  // namespace gld
