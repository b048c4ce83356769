#include "infer/sample/sampling_evidence.h"

#include "gld/page/run_report.h"
#include "gld/photogrammetry/photograph_composition.h"
#include "gld/tensors/torch_version.h"
#include "models/bundle/seen_scenes.h"

#include <algorithm>

namespace gld {

std::vector<LeftOutPhotograph> left_out_photographs(const SamplingScene& scene, const PhotographUse& use,
                                                    const PipelineResult& result) {
  // What is compared is of the model's size: more than a few times its pixels would be work for nothing.
  const int64_t side = std::max(scene.size.width, scene.size.height);
  LeaveOneOutOptions options;
  options.stereo = use.stereo;
  std::vector<PicturedView> views;
  for (size_t i = 0; i < scene.photographs.views.size(); ++i) {
    const PicturedView& taken = scene.photographs.views[i];
    options.block =
        std::min(taken.width / scene.size.width, std::max<int64_t>(1, kMatchedPhotographSide / side));
    views.push_back(reduced_view(taken, options.block * side));
    if (i < result.head_depth.size()) views.back().depth = result.head_depth[i];
  }
  KernelSettings settings;
  settings.threads = static_cast<int>(thread_count());
  return leave_one_out(views, scene.photographs.points_in_world, options, settings);
}

PictureEvidence sampling_evidence(const PreparedSampling& prepared, const PipelineResult& result) {
  PictureEvidence evidence;
  evidence.sources = prepared.scene.views.num_sources;
  evidence.keeps_photographs = result.composed.has_value();
  if (result.composed) {
    evidence.kept = result.composed->shown.mean().item<double>();
    for (int64_t target = 0; target < prepared.scene.views.num_targets(); ++target) {
      const auto view = static_cast<size_t>(prepared.scene.views.num_sources + target);
      evidence.views.push_back({prepared.scene.view_names[view], expected_psnr(*result.composed, target),
                                result.composed->shown[target].mean().item<double>()});
    }
  }
  if (result.stereo) evidence.prior = result.stereo->prior;
  evidence.divergences = result.divergences;
  evidence.unit_log_deviation = result.head_depth_log_deviation;
  const auto seen = read_seen_scenes(prepared.bundle);
  if (!seen) return evidence;
  evidence.drawn_rooms_only = seen->drawn;
  for (const auto& part : prepared.bundle.options().generators) {
    for (const SeenLevel& level : seen->levels) {
      if (level.level == part.generator.level) evidence.usual.push_back(level);
    }
  }
  return evidence;
}

std::vector<std::string> doubts_of(const std::optional<PictureVerdict>& verdict,
                                   const PictureEvidence& evidence,
                                   const std::vector<std::string>& warnings) {
  nlohmann::ordered_json report;
  report["warnings"] = warnings;
  if (verdict) report["verdict"] = verdict_json(*verdict, evidence);
  return doubts_of_run(report);
}

std::vector<std::string> doubts_of_generated(const PreparedSampling& prepared, const PipelineResult& result) {
  const bool all_carried =
      static_cast<int64_t>(result.carried_only.size()) == prepared.scene.views.num_targets();
  return all_carried ? std::vector<std::string>() : prepared.unlike_training;
}

}  // namespace gld
