#pragma once

#include "models/dit/dit_dh.h"
#include "models/weights/weight_loading.h"
#include "tests/support/random_cameras.h"

#include <memory>
#include <string>

#include <torch/autograd.h>

namespace gld::test {

// A small DiT^DH with every weight random (none zero, as after initialise()), and a scene for it.
inline DitOptions small_dit_options() {
  DitOptions options;
  options.in_channels = 24;
  options.hidden_size = {32, 48};
  options.depth = {2, 2};
  options.num_heads = {2, 3};
  return options;
}

// The same as a cascade.
inline DitOptions small_cascade_options() {
  auto options = small_dit_options();
  options.conditioning = DitConditioning::kDeeperLevel;
  return options;
}

inline std::shared_ptr<DitDh> random_dit(const DitOptions& options, uint64_t seed = 1) {
  auto model = std::make_shared<DitDh>(options, ParameterPlacement{});
  const torch::NoGradGuard no_grad;
  torch::manual_seed(seed);
  for (auto& parameter : model->named_parameters()) {
    auto& value = parameter.value();
    if (value.dim() >= 2) {
      const int64_t inputs = value.numel() / value.size(0);
      value.copy_(torch::randn(value.sizes()) / std::sqrt(static_cast<double>(inputs)));
    } else if (parameter.key().find("norm") != std::string::npos) {
      value.copy_(1.0 + 0.2 * torch::randn(value.sizes()));
    } else if (parameter.key() == "t_embedder.W") {
      value.copy_(torch::randn(value.sizes()));
    } else {
      value.copy_(0.1 * torch::randn(value.sizes()));
    }
  }
  return model;
}

// The same weights in double.
inline std::shared_ptr<DitDh> in_double(const DitDh& model) {
  ParameterPlacement placement;
  placement.dtype = torch::kFloat64;
  auto copy = std::make_shared<DitDh>(model.options(), placement);
  load_strict(*copy, named_tensors(model), "small model");
  return copy;
}

struct DitTestScene {
  DitSceneInputs inputs;
  torch::Tensor noisy;
};

inline DitTestScene random_dit_scene(const DitOptions& options, const RandomCameras::SceneSizes& sizes,
                                     uint64_t seed = 5) {
  torch::manual_seed(seed);
  DitTestScene scene;
  scene.inputs.views = RandomCameras(static_cast<uint32_t>(seed)).ordinary_scene(sizes);
  const int64_t side = options.camera_patch_size;
  const int64_t tokens = options.num_special_tokens + sizes.height / side * (sizes.width / side);
  scene.inputs.source_features = torch::randn({sizes.sources, tokens, options.in_channels});
  scene.noisy = torch::randn({sizes.views, tokens, options.in_channels});
  if (options.conditioning == DitConditioning::kDeeperLevel) {
    scene.inputs.deeper_level = torch::randn({sizes.views, tokens, options.in_channels});
  }
  if (options.warped_sources > 0) {
    const int64_t targets = sizes.views - sizes.sources;
    scene.inputs.warp_agreement = torch::rand({targets, options.warped_sources, sizes.height, sizes.width});
    scene.inputs.warped_features =
        torch::randn({targets, tokens - options.num_special_tokens, options.in_channels});
  }
  return scene;
}

inline DitTestScene in_double(DitTestScene scene) {
  scene.inputs.source_features = scene.inputs.source_features.to(torch::kFloat64);
  if (scene.inputs.deeper_level.defined()) {
    scene.inputs.deeper_level = scene.inputs.deeper_level.to(torch::kFloat64);
  }
  if (scene.inputs.warp_agreement.defined()) {
    scene.inputs.warp_agreement = scene.inputs.warp_agreement.to(torch::kFloat64);
    scene.inputs.warped_features = scene.inputs.warped_features.to(torch::kFloat64);
  }
  scene.noisy = scene.noisy.to(torch::kFloat64);
  return scene;
}

// max |a - b| / max(1, max |b|).
inline double relative_difference(const torch::Tensor& a, const torch::Tensor& b) {
  const auto exact = b.to(torch::kFloat64);
  return (a.to(torch::kFloat64) - exact).abs().max().item<double>() /
         std::max(1.0, exact.abs().max().item<double>());
}

}  // namespace gld::test
