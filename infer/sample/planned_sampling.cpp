#include "infer/sample/planned_sampling.h"

#include "gld/base/error.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/torch_version.h"
#include "infer/forecast/splat_forecast.h"
#include "infer/pipeline/bundle_models.h"
#include "infer/request/scene_request.h"

#include <fmt/format.h>

namespace gld {

PlannedSampling plan_of(const PreparedSampling& prepared, const SampleOptions& options, PlanTiming timing,
                        const std::function<std::string()>& model_hash) {
  const BundleOptions& bundle = prepared.bundle.options();
  PlanRequest request = plan_request(prepared, options);
  PlannedSampling planned;
  const bool on_cpu = prepared.device.is_cpu();
  if (!on_cpu && timing == PlanTiming::kMeasured) {
    fail({"--measure", "--device cpu, whose rates are what is measured", prepared.device.str(),
          "leave one of the two out"});
  }
  planned.speed = timing == PlanTiming::kMeasured ? renew_machine_speed() : known_machine_speed();
  const MachineSpeed& speed = planned.speed.speed;
  planned.choice = choose_method(options, prepared.bundle, request, speed, model_hash);
  planned.settings = flow_settings(planned.choice.method, options.guidance, bundle);
  request.flow = planned.settings;
  planned.plan = plan_sampling(bundle, request);
  if (!on_cpu) {
    planned.speed.origin = fmt::format(
        "how long {} takes is not predicted: the rates known are the processor's", prepared.device.str());
    planned.speed.doubts.clear();
    return planned;
  }
  if (timing == PlanTiming::kMeasured) {
    measure_seconds(planned.plan, bundle, request, speed);
  } else {
    predict_seconds(planned.plan, speed);
  }
  time_splat_stage(planned.plan, request, bundle.backbone.patch_side(), static_cast<int>(thread_count()));
  return planned;
}

PipelineRequest pipeline_request(const PreparedSampling& prepared, const SampleOptions& options,
                                 const FlowSettings& settings) {
  const RequestedOutputs requested = options.requested();
  PipelineRequest request =
      scene_request(prepared.scene, prepared.bundle.options(), options.seed, prepared.device);
  request.flow = settings;
  request.savings = options.savings();
  request.photographs = photograph_use_of(options.photograph_use, prepared.bundle);
  request.all_latents = requested.latents;
  request.image_views = requested.image_views();
  request.geometry_views = requested.geometry_views();
  request.geometry_maps = requested.geometry_maps();
  request.geometry_cameras = options.geometry_cameras;
  return request;
}

}  // namespace gld
