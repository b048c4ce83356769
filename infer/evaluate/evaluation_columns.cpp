#include "infer/evaluate/evaluation_columns.h"

#include "gld/metrics/metric_list.h"

#include <algorithm>

namespace gld {

std::string column_name(Predictor predictor, const Metric& metric) {
  return is_trivial(predictor) ? metric.name + "_" + predictor_name(predictor)
                               : predictor_name(predictor) + "_" + metric.name;
}

bool is_trivial(Predictor predictor) {
  const auto& trivial = trivial_predictors();
  return std::find(trivial.begin(), trivial.end(), predictor) != trivial.end();
}

const std::vector<Predictor>& all_predictors() {
  static const std::vector<Predictor> predictors = [] {
    std::vector<Predictor> all = main_predictors();
    all.insert(all.end(), level_predictors().begin(), level_predictors().end());
    return all;
  }();
  return predictors;
}

const std::vector<Predictor>& main_predictors() {
  static const std::vector<Predictor> predictors{
      Predictor::kSample,    Predictor::kMeanPrediction, Predictor::kNearestSource, Predictor::kMeanSource,
      Predictor::kMeanColor, Predictor::kWarpedSources,  Predictor::kReconstruction};
  return predictors;
}

const std::vector<Predictor>& level_predictors() {
  static const std::vector<Predictor> predictors{
      Predictor::kReconstructionLevel0, Predictor::kReconstructionLevel1, Predictor::kReconstructionLevel2,
      Predictor::kReconstructionLevel3};
  return predictors;
}

const std::vector<Predictor>& trivial_predictors() {
  static const std::vector<Predictor> predictors{Predictor::kNearestSource, Predictor::kMeanSource,
                                                 Predictor::kMeanColor};
  return predictors;
}

std::string predictor_name(Predictor predictor) {
  static const std::vector<std::string> names{"sample",        "mean_prediction", "nearest_source",
                                              "mean_source",   "mean_color",      "warped_sources",
                                              "reconstruction"};
  const auto number = static_cast<size_t>(predictor);
  if (number < names.size()) return names[number];
  return "reconstruction_level" + std::to_string(number - names.size());
}

namespace {

// Whether a metric compares the depth of target views with the true one, and needs nothing else.
bool compares_depth(const Metric& metric) {
  const auto& needs = metric.needs;
  return std::find(needs.begin(), needs.end(), MetricNeed::kTrueDepth) != needs.end() &&
         std::all_of(needs.begin(), needs.end(), [](MetricNeed need) {
           return need == MetricNeed::kTrueDepth || need == MetricNeed::kDepth ||
                  need == MetricNeed::kDepthScale;
         });
}

}  // namespace

const std::vector<EvaluationColumn>& evaluation_columns() {
  static const std::vector<EvaluationColumn> columns = [] {
    std::vector<EvaluationColumn> list;
    for (const Metric& metric : metric_list()) {
      if (!metric.of_images()) {
        list.push_back({metric.name, metric, Predictor::kSample});
        if (compares_depth(metric)) {
          list.push_back({column_name(Predictor::kWarpedSources, metric), metric, Predictor::kWarpedSources});
        }
        continue;
      }
      for (const Predictor predictor : all_predictors()) {
        list.push_back({column_name(predictor, metric), metric, predictor});
      }
    }
    return list;
  }();
  return columns;
}

}  // namespace gld
