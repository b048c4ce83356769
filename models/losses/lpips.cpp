#include "models/losses/lpips.h"

#include "gld/base/error.h"
#include "gld/tensors/weight_tensors.h"
#include "models/losses/lpips_features.h"
#include "models/weights/weight_loading.h"

#include <map>

namespace gld {
namespace {

// Scales channels to unit length. The clamp, far below the published epsilon of 1e-10, changes no value but keeps the
// gradient of the root finite where all channels are zero.
torch::Tensor unit_length(const torch::Tensor& maps) {
  const auto length = maps.square().sum(1, /*keepdim=*/true).clamp_min(1e-30).sqrt();
  return maps / (length + 1e-10);
}

}  // namespace

void LpipsOptions::visit(FieldVisitor& visitor) {
  visit_choice(visitor, {"net", "network that the features come from"}, net, {"squeeze", "vgg", "alex"});
  visitor.text({"version", "version of the published linear heads"}, version);
}

void LpipsOptions::check() const {
  if (version != "0.1") {
    fail({"version", "0.1", version, "use the heads of LPIPS version 0.1"});
  }
}

Lpips::Lpips(const LpipsOptions& options, const ParameterPlacement& placement) : options_(options) {
  options_.check();
  features_ = register_module("features", std::make_shared<LpipsFeatures>(options_.net, placement));
  const auto& channels = features_->channels();
  for (size_t k = 0; k < channels.size(); ++k) {
    auto linear = register_module("lin" + std::to_string(k), std::make_shared<torch::nn::Module>());
    auto model = linear->register_module("model", std::make_shared<torch::nn::Module>());
    auto convolution = model->register_module("1", std::make_shared<torch::nn::Module>());
    heads_.push_back(
        convolution->register_parameter("weight", torch::empty({1, channels[k], 1, 1}, placement.options())));
  }
}

int64_t Lpips::minimum_side() const { return features_->minimum_side(); }

std::vector<torch::Tensor> Lpips::features(const torch::Tensor& image) const {
  const int64_t side = minimum_side();
  if (image.dim() != 4 || image.size(1) != 3 || image.size(2) < side || image.size(3) < side) {
    fail({"LPIPS",
          "RGB images (batch, 3, height, width) with sides of at least " + std::to_string(side) + " pixels",
          "a tensor of shape " + c10::str(image.sizes()), "give larger images"});
  }
  // The published scaling layer works on images in [-1, 1].
  const auto constant = [&](const std::vector<double>& values) {
    return torch::tensor(values, torch::kFloat64).to(image.device(), image.scalar_type()).view({1, 3, 1, 1});
  };
  const auto scaled = (image * 2 - 1 - constant({-0.030, -0.088, -0.188})) / constant({0.458, 0.448, 0.450});
  auto maps = features_->forward(scaled);
  for (auto& map : maps) map = unit_length(map);
  return maps;
}

torch::Tensor Lpips::distance(const std::vector<torch::Tensor>& a,
                              const std::vector<torch::Tensor>& b) const {
  if (a.size() != heads_.size() || b.size() != heads_.size()) {
    fail({"LPIPS", std::to_string(heads_.size()) + " feature maps of each image",
          std::to_string(a.size()) + " and " + std::to_string(b.size()), "compute both with features()"});
  }
  torch::Tensor total;
  for (size_t k = 0; k < heads_.size(); ++k) {
    const auto layer = ((a[k] - b[k]).square() * heads_[k]).sum(1).mean({1, 2});
    total = k == 0 ? layer : total + layer;
  }
  return total;
}

torch::Tensor Lpips::forward(const torch::Tensor& image, const torch::Tensor& prediction) const {
  if (image.sizes() != prediction.sizes()) {
    fail({"LPIPS", "two image batches of one shape",
          c10::str(image.sizes()) + " and " + c10::str(prediction.sizes()),
          "compare images of the same size"});
  }
  return distance(features(image), features(prediction));
}

void load_lpips(Lpips& lpips, const WeightFile& backbone, const WeightFile& heads) {
  std::map<std::string, torch::Tensor> tensors = read_all(heads);
  for (const auto& [name, tensor] : read_all(backbone, "features.")) tensors["features." + name] = tensor;
  load_strict(lpips, tensors, backbone.path().string() + " and " + heads.path().string());
}

}  // namespace gld
