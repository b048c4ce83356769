#pragma once

#include "models/dit/dit_dh.h"
#include "models/weights/weight_loading.h"
#include "tests/support/random_cameras.h"
#include "tests/support/worst_of.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <memory>
#include <string>
#include <vector>

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

// Returns the same as a cascade.
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

// Returns the same weights in double.
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

// The following is what float32 may make of a computation with a small DiT^DH, from the condition of the computation
// itself, so that a bound holds for whatever order the kernels of a processor sum in.
//
// A sum of K products that rounds each of its K partial sums is the exact sum of products that moved by sqrt(K) unit
// roundoffs u = 2^-24 each, as far as roundings are independent (Higham and Mary 2019). So a result errs by about
// sqrt(K) times what it moves by in double when every weight and every input moves by u at random; and what lies
// between the products (norms, softmax, the residual stream) rounds as often as they do, which the factor 2 is for.
// OpenBLAS's Haswell kernels and ours err by up to 7 such moves, of the 28 that are allowed.
constexpr int64_t kLongestSum = 192;  // 4 x 48 channels inside the velocity decoder's blocks
inline double rounding_bound(double moved_by_units) {
  return 2 * std::sqrt(static_cast<double>(kLongestSum)) * moved_by_units;
}

// Returns a double tensor with every number moved by up to u of itself; undefined stays undefined.
inline torch::Tensor moved_by_a_unit(const torch::Tensor& x) {
  return x.defined() ? x * (1 + 0x1p-24 * (2 * torch::rand_like(x) - 1)) : x;
}

inline DitSceneInputs moved_by_a_unit(DitSceneInputs inputs) {
  for (auto* tensor :
       {&inputs.source_features, &inputs.deeper_level, &inputs.warp_agreement, &inputs.warped_features}) {
    *tensor = moved_by_a_unit(*tensor);
  }
  return inputs;
}

inline std::shared_ptr<DitDh> moved_by_a_unit(const DitDh& model) {
  auto moved = in_double(model);
  const torch::NoGradGuard no_grad;
  // They get numbers of their own: loading from a model that is in double already shares them.
  for (auto& parameter : moved->parameters()) parameter.set_data(moved_by_a_unit(parameter));
  return moved;
}

// Returns the largest change of any number of each tensor that result() makes of moved weights and inputs, over some
// draws.
inline std::vector<double> moved_by_units(const std::vector<torch::Tensor>& exact,
                                          const std::function<std::vector<torch::Tensor>()>& result) {
  std::vector<double> largest(exact.size());
  constexpr uint64_t kDraws = 3;
  for (uint64_t draw = 0; draw < kDraws; ++draw) {
    torch::manual_seed(100 + draw);
    const auto moved = result();
    for (size_t i = 0; i < exact.size(); ++i) {
      if (!exact[i].defined()) continue;
      largest[i] = worst_of(largest[i], (moved[i] - exact[i]).abs().max().item<double>());
    }
  }
  return largest;
}

// Returns max |a - b|, with b in double.
inline double largest_difference(const torch::Tensor& a, const torch::Tensor& b) {
  return (a.to(torch::kFloat64) - b).abs().max().item<double>();
}

// Returns max |a - b| / max(1, max |b|).
inline double relative_difference(const torch::Tensor& a, const torch::Tensor& b) {
  const auto exact = b.to(torch::kFloat64);
  return (a.to(torch::kFloat64) - exact).abs().max().item<double>() /
         std::max(1.0, exact.abs().max().item<double>());
}

}  // namespace gld::test
