#pragma once

#include "gld/base/options.h"
#include "gld/files/weight_file.h"
#include "models/layers/layers.h"

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

enum class LpipsNet { kSqueeze, kVgg, kAlex };

struct LpipsOptions : OptionsGroup {
  LpipsNet net = LpipsNet::kVgg;
  std::string version = "0.1";  // of the published linear heads

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

class LpipsFeatures;

// Learned perceptual image patch similarity (Zhang et al. 2018, "The Unreasonable Effectiveness of Deep
// Features as a Perceptual Metric", eq. 1): squared differences of channel-normalised features, weighted by
// learned non-negative heads, averaged over the image and summed over layers. Parameters: "features.*" as in
// torchvision's classification network, "linK.model.1.weight" (1, channels, 1, 1) as in the published heads.
class Lpips : public torch::nn::Module {
 public:
  Lpips(const LpipsOptions& options, const ParameterPlacement& placement);

  // image, prediction: (batch, 3, height, width), RGB in [0, 1] -> (batch). It is differentiable, also where a
  // feature vector is zero.
  torch::Tensor forward(const torch::Tensor& image, const torch::Tensor& prediction) const;

  // Returns the normalised features of each layer: (batch, channels_k, height_k, width_k). Those of a fixed image can
  // be computed once.
  std::vector<torch::Tensor> features(const torch::Tensor& image) const;
  // Returns the distance of two such lists: (batch).
  torch::Tensor distance(const std::vector<torch::Tensor>& a, const std::vector<torch::Tensor>& b) const;

  // Smaller images leave nothing of the last layer.
  int64_t minimum_side() const;

 private:
  LpipsOptions options_;
  std::shared_ptr<LpipsFeatures> features_;
  std::vector<torch::Tensor> heads_;  // (1, channels_k, 1, 1)
};

// Loads torchvision's classification network (its classifier is left out) and the published heads from their
// own files.
void load_lpips(Lpips& lpips, const WeightFile& backbone, const WeightFile& heads);

}  // namespace gld
