#include "bench/training/repeated_scene.h"

#include "gld/base/error.h"
#include "models/cost/cost_model.h"
#include "models/dit/flow_matching_loss.h"
#include "models/layers/layer_precision.h"

#include <ATen/CPUGeneratorImpl.h>

namespace gld {
namespace {

constexpr double kFlowTime = 0.7;

}  // namespace

RepeatedScene::RepeatedScene(const BundleOptions& bundle, const DitOptions& options, const CameraRow& size,
                             const torch::Device& device)
    : grid_(bundle.backbone.grid_of(size.views, size.image.height, size.image.width)) {
  auto generator = at::detail::createCPUGenerator(1);
  ParameterPlacement placement;
  placement.device = device;
  dit_ = std::make_shared<DitDh>(options, placement);
  dit_->initialise(generator);
  const int64_t tokens = dit_->tokens_per_view(grid_), channels = options.in_channels;
  inputs_.views = cameras_in_a_row(size);
  set_no_warp(inputs_, options);
  inputs_.source_features = torch::randn({size.sources, tokens, channels}, generator).to(device);
  clean_ = torch::randn({size.views, tokens, channels}, generator).to(device);
  noise_ = torch::randn({size.views, tokens, channels}, generator).to(device);
}

double RepeatedScene::flop() const { return dit_cost(dit_->options(), grid_).flop(); }

torch::Tensor RepeatedScene::loss() const {
  FlowMatchingDraw draw;
  draw.clean = clean_;
  draw.noise = noise_;
  draw.time = kFlowTime;
  return flow_matching_errors(*dit_, inputs_, draw).all;
}

int64_t RepeatedScene::learn_in(ComputePrecision precision) { return gld::learn_in(*dit_, precision); }

void RepeatedScene::export_model(const std::filesystem::path& folder, DType /*dtype*/) const {
  fail({"a benchmark", "no export", folder.string(), "train with gld train"});
}

}  // namespace gld
