#include "infer/request/scale_evidence.h"

#include "infer/request/scene_request.h"

#include <algorithm>

namespace gld {

const std::vector<std::string>& scale_evidence_names() {
  static const std::vector<std::string> names{"camera_poses", "photographs", "sparse_points", "source_depth"};
  return names;
}

std::vector<std::string> usual_scale_evidence() { return {"camera_poses", "photographs", "sparse_points"}; }

ScaleEvidence scale_evidence(const SamplingScene& scene, const std::vector<std::string>& kinds,
                             const std::optional<StereoScene>& stereo) {
  const auto named = [&](const char* kind) {
    return std::find(kinds.begin(), kinds.end(), kind) != kinds.end();
  };
  ScaleEvidence evidence;
  // With one photograph all other cameras are predicted from views that the model made itself: they show how far it
  // believes to have moved and not how far that was. Of 64 drawn rooms 9 had a scale of them, 0.3 to 0.8 of the truth.
  const bool poses_alone = kinds.size() == 1;
  evidence.camera_poses = named("camera_poses") && (scene.source_images.size() > 1 || poses_alone);
  if (named("photographs")) {
    evidence.photographs = stacked(scene.source_images);
    if (stereo) evidence.matched_depth = confident_depth(*stereo);
  }
  if (named("sparse_points")) evidence.points_in_world = scene.points_in_world;
  if (scene.seen_depth && kinds == usual_scale_evidence()) {
    evidence.source_depth = scene.seen_depth->views;
  } else if (named("source_depth")) {
    for (const DepthMap& map : scene.source_depths) {
      evidence.source_depth.push_back({map.width, map.height, map.metres});
    }
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
