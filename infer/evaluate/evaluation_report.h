#pragma once

#include "gld/report/plot.h"
#include "infer/evaluate/scene_evaluation.h"

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// Returns eval.csv: the header and one row a scene, with numbers with 6 digits, "inf" for the PSNR of a perfect
// prediction, nothing where a number is absent; then 1 or 0 for each trivial predictor that the sample beats or does
// not, for each rival against which the samples win or do not by an energy score, and the numbers of sources and of
// samples. Text that CSV would split is quoted.
std::string evaluation_csv(const std::vector<SceneEvaluation>& scenes);

// Returns targets.csv: one row a scene, number of sources, sample and target view, for the metrics that have a value a
// target. What does not depend on the sample stands in the rows of the first one only.
std::string targets_csv(const std::vector<SceneEvaluation>& scenes);

// A metric's values over scenes, sorted, a line for each predictor that has it: "psnr", "depth_abs_rel_unscaled". Only
// metrics with a finite value in at least 2 scenes.
struct MetricPicture {
  std::string name;
  Figure figure;
};
std::vector<MetricPicture> metric_pictures(const std::vector<SceneEvaluation>& scenes);

// Returns for report.json each column's mean, deviation and intervals over scenes, with how many scenes have a finite
// value, an infinite one or none, and why; the best trivial predictor, the margins over it, and how often samples beat
// them; how often samples win against each rival by each of compared_metrics(), and what their energy score is made of.
nlohmann::ordered_json evaluation_summary(const std::vector<SceneEvaluation>& scenes);

// Returns the same for people: predictors side by side, then the samples' geometry.
std::string evaluation_text(const nlohmann::ordered_json& summary);

}  // namespace gld
