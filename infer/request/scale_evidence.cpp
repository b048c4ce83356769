#include "infer/request/scale_evidence.h"

#include "infer/request/scene_request.h"

#include <algorithm>

namespace gld {
namespace {

bool is_named(const std::vector<std::string>& kinds, const std::string& kind) {
  return std::find(kinds.begin(), kinds.end(), kind) != kinds.end();
}

}  // namespace

const std::vector<std::string>& scale_evidence_names() {
  static const std::vector<std::string> names{"camera_poses", "photographs", "sparse_points", "source_depth",
                                              kUsualUnitEvidence};
  return names;
}

std::vector<std::string> usual_scale_evidence() {
  return {"camera_poses", "photographs", "sparse_points", kUsualUnitEvidence};
}

ScaleEvidence scale_evidence(const SamplingScene& scene, const std::vector<std::string>& kinds) {
  const auto named = [&](const char* kind) { return is_named(kinds, kind); };
  ScaleEvidence evidence;
  // With one photograph all other cameras are predicted from views that the model made itself: they show how far it
  // believes to have moved and not how far that was. Of 64 drawn rooms 9 had a scale of them, 0.3 to 0.8 of the truth.
  const bool poses_alone = kinds.size() == 1;
  evidence.camera_poses = named("camera_poses") && (scene.source_images.size() > 1 || poses_alone);
  if (named("photographs")) {
    evidence.photographs = stacked(scene.source_images);
  }
  if (named("sparse_points")) evidence.points_in_world = scene.points_in_world;
  if (scene.seen_depth && kinds.size() > 1) {
    evidence.source_depth = scene.seen_depth->views;
  } else if (named("source_depth")) {
    for (const DepthMap& map : scene.source_depths) {
      evidence.source_depth.push_back({map.width, map.height, map.metres});
    }
  }
  return evidence;
}

ScaleEvidence scale_evidence(const SamplingScene& scene, const std::vector<std::string>& kinds,
                             const PipelineResult& found) {
  ScaleEvidence evidence = scale_evidence(scene, kinds);
  if (is_named(kinds, "photographs") && found.stereo) evidence.matched_depth = confident_depth(*found.stereo);
  // A unit without its error tells how deep a picture is carried, but not how sure a scale is.
  if (is_named(kinds, kUsualUnitEvidence) && found.head_depth_log_deviation > 0) {
    evidence.usual_unit_depth = found.head_depth;
    evidence.usual_unit_log_deviation = found.head_depth_log_deviation;
  }
  return evidence;
}

nlohmann::ordered_json depth_scale_json(const DepthScale& estimate) {
  nlohmann::ordered_json json{{"estimator", estimate.estimator},
                              {"scale", estimate.scale},
                              {"interval", {estimate.low, estimate.high}},
                              {"residual", estimate.residual}};
  const std::string doubt = doubt_about(estimate);
  if (!doubt.empty()) json["doubt"] = doubt;
  return json;
}

nlohmann::ordered_json estimates_json(const std::vector<DepthScale>& estimates) {
  auto list = nlohmann::ordered_json::array();
  for (const DepthScale& estimate : estimates) list.push_back(depth_scale_json(estimate));
  return list;
}

}  // namespace gld
