#pragma once

#include "infer/evaluate/scene_evaluation.h"

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// eval.csv: the header and one row a scene, numbers with 6 digits, "inf" for the PSNR of a perfect prediction, nothing
// where a number is absent; then 1 or 0 for each trivial predictor that the sample beats or does not.
std::string evaluation_csv(const std::vector<SceneEvaluation>& scenes);

// For report.json: each column's mean, deviation and interval over scenes, with how many scenes have a finite value, an
// infinite one or none, and why; the best trivial predictor, the margins over it, and how often samples beat them.
nlohmann::ordered_json evaluation_summary(const std::vector<SceneEvaluation>& scenes);

// The same for people: predictors side by side, then the samples' geometry.
std::string evaluation_text(const nlohmann::ordered_json& summary);

}  // namespace gld
