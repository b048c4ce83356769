#include "infer/method/flow_request.h"

namespace gld {

void use_flow_settings(PipelineRequest& request, const FlowSettings& settings) {
  request.level1_solver = settings.level1_solver;
  request.cascade_solver = settings.cascade_solver;
  request.guidance = settings.guidance;
  request.approximate = settings.approximate;
}

FlowSettings mean_prediction_settings(const BundleOptions& bundle) {
  SamplingMethod method;
  method.name = "mean prediction";
  method.solver.evaluations = 1;
  GuidanceOptions guidance;
  guidance.guidance_scale = 1;
  return flow_settings(method, guidance, bundle);
}

}  // namespace gld
