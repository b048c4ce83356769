#include "models/dit/flow_matching_loss.h"

#include "gld/flow/flow.h"

namespace gld {

FlowMatchingErrors flow_matching_errors(const DitDh& model, const DitSceneInputs& scene,
                                        const FlowMatchingDraw& draw) {
  auto prepared = model.prepare_scene(scene);
  prepared.taps = draw.taps;
  const auto velocity = model.velocity(prepared, interpolate(draw.clean, draw.noise, draw.time),
                                       model.time_rows({draw.time}).front(), draw.branch);
  const auto squared = (velocity - velocity_target(draw.clean, draw.noise)).square();
  const int64_t sources = prepared.num_sources();
  FlowMatchingErrors errors;
  errors.all = squared.mean();
  errors.source = squared.detach().narrow(0, 0, sources).mean();
  errors.target = squared.detach().narrow(0, sources, squared.size(0) - sources).mean();
  return errors;
}

}  // namespace gld
