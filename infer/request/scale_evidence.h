#pragma once

#include "infer/pipeline/sampling_pipeline.h"
#include "infer/request/sampling_scene.h"
#include "models/scene_geometry/geometry_placement.h"

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// The kinds of evidence, as DepthScale::estimator and --scale-from name them.
const std::vector<std::string>& scale_evidence_names();
// Returns what a scene has of those kinds, for the geometry of all of its views. source_depth takes
// scene.source_depths; where more than one kind is asked for, what a model saw of a single photograph
// (scene.seen_depth) stands in their place. With one photograph camera_poses tell nothing, and count only where they
// alone are asked for.
ScaleEvidence scale_evidence(const SamplingScene& scene, const std::vector<std::string>& kinds);
// Returns the same with what a run has found of the sources: what the photographs agree on, which says more than
// pictures laid over each other, and the depth of a single source in the unit that the model guesses.
ScaleEvidence scale_evidence(const SamplingScene& scene, const std::vector<std::string>& kinds,
                             const PipelineResult& found);
// Returns the kinds that are taken unless others are named: all but source_depth, which nobody has of photographs
// alone.
std::vector<std::string> usual_scale_evidence();

// Returns what every kind of evidence said, for report.json: estimator, scale, interval, residual and, where it is not
// believed, the doubt.
nlohmann::ordered_json depth_scale_json(const DepthScale& estimate);
nlohmann::ordered_json estimates_json(const std::vector<DepthScale>& estimates);

}  // namespace gld
