#include "infer/evaluate/evaluation_columns.h"

#include "gld/metrics/metric_list.h"

#include <algorithm>

namespace gld {

std::string column_name(const Predictor& predictor, const Metric& metric) {
  return is_trivial(predictor) ? metric.name + "_" + predictor_name(predictor)
                               : predictor_name(predictor) + "_" + metric.name;
}

bool is_trivial(const Predictor& predictor) {
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
      Predictor::kSample,     Predictor::kMeanPrediction,    Predictor::kNearestSource,
      Predictor::kMeanSource, Predictor::kMeanColor,         Predictor::kWarpedSources,
      Predictor::kFill,       Predictor::kReconstructedFill, Predictor::kFillByTrueDepth,
      Predictor::kGenerated,  Predictor::kReconstruction};
  return predictors;
}

const std::vector<Predictor>& level_predictors() {
  static const std::vector<Predictor> predictors = [] {
    std::vector<Predictor> levels;
    for (int64_t level = 0; level < kLevelColumns; ++level) {
      levels.emplace_back(Predictor::kReconstructionOfLevel, level);
    }
    return levels;
  }();
  return predictors;
}

const std::vector<Predictor>& trivial_predictors() {
  static const std::vector<Predictor> predictors{Predictor::kNearestSource, Predictor::kMeanSource,
                                                 Predictor::kMeanColor};
  return predictors;
}

const std::vector<Predictor>& rivals() {
  static const std::vector<Predictor> predictors{Predictor::kNearestSource, Predictor::kMeanSource,
                                                 Predictor::kMeanColor,     Predictor::kWarpedSources,
                                                 Predictor::kFill,          Predictor::kReconstructedFill,
                                                 Predictor::kMeanPrediction};
  return predictors;
}

const std::vector<Metric>& compared_metrics() {
  static const std::vector<Metric> metrics = [] {
    std::vector<Metric> list;
    for (const char* name : {"psnr", "energy_score", "energy_score_features"}) {
      for (const char* pixels : {"", "_seen", "_unseen"})
        list.push_back(metric_named(std::string(name) + pixels));
    }
    return list;
  }();
  return metrics;
}

bool of_every_predictor(const Metric& metric) { return metric.of_images() || metric.of_samples(); }

std::string predictor_name(const Predictor& predictor) {
  static const std::vector<std::string> names{"sample",
                                              "mean_prediction",
                                              "nearest_source",
                                              "mean_source",
                                              "mean_color",
                                              "warped_sources",
                                              "fill",
                                              "reconstructed_fill",
                                              "fill_by_true_depth",
                                              "generated",
                                              "reconstruction",
                                              "reconstruction_level",
                                              "from_true_levels"};
  const std::string& name = names[static_cast<size_t>(predictor.kind)];
  return predictor.kind == Predictor::kReconstructionOfLevel ? name + std::to_string(predictor.level) : name;
}

namespace {

// Returns whether a metric compares the depth of target views with the true one, and needs nothing else.
bool compares_depth(const Metric& metric) {
  const auto& needs = metric.needs;
  return std::find(needs.begin(), needs.end(), MetricNeed::kTrueDepth) != needs.end() &&
         std::all_of(needs.begin(), needs.end(), [](MetricNeed need) {
           return need == MetricNeed::kTrueDepth || need == MetricNeed::kDepth ||
                  need == MetricNeed::kDepthScale;
         });
}

bool compares_latents(const Metric& metric) {
  return metric.needs == std::vector<MetricNeed>{MetricNeed::kLatents};
}

}  // namespace

const std::vector<EvaluationColumn>& evaluation_columns() {
  static const std::vector<EvaluationColumn> columns = [] {
    std::vector<EvaluationColumn> list;
    for (const Metric& metric : metric_list()) {
      if (compares_latents(metric)) {
        for (const Predictor::Kind kind :
             {Predictor::kSample, Predictor::kMeanPrediction, Predictor::kFromTrueLevels}) {
          list.push_back({column_name(kind, metric), metric, kind});
        }
        continue;
      }
      if (!of_every_predictor(metric)) {
        list.push_back({metric.name, metric, Predictor::kSample});
        if (compares_depth(metric)) {
          list.push_back({column_name(Predictor::kWarpedSources, metric), metric, Predictor::kWarpedSources});
        }
        continue;
      }
      for (const Predictor& predictor : all_predictors()) {
        list.push_back({column_name(predictor, metric), metric, predictor});
      }
    }
    return list;
  }();
  return columns;
}

}  // namespace gld
