#pragma once

#include "models/layers/layers.h"
#include "models/losses/lpips.h"

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// The convolutional part of torchvision's SqueezeNet 1.1, VGG16 or AlexNet, cut where LPIPS reads features.
// Parameters are named by torchvision's layer numbers ("0.weight", "3.squeeze.weight").
class LpipsFeatures : public torch::nn::Module {
 public:
  LpipsFeatures(LpipsNet net, const ParameterPlacement& placement);

  // (batch, 3, height, width), scaled -> one map a tap.
  std::vector<torch::Tensor> forward(const torch::Tensor& x) const;

  const std::vector<int64_t>& channels() const { return channels_; }  // of the taps
  int64_t minimum_side() const { return minimum_side_; }              // pixels

 private:
  using Step = std::function<torch::Tensor(const torch::Tensor&)>;
  void build_squeeze(const ParameterPlacement& placement);
  void build_vgg(const ParameterPlacement& placement);
  void build_alex(const ParameterPlacement& placement);
  void add_tap(int64_t channels);

  std::vector<Step> steps_;
  std::vector<size_t> taps_;  // number of steps after which a map is read
  std::vector<int64_t> channels_;
  int64_t minimum_side_ = 1;
};

}  // namespace gld
