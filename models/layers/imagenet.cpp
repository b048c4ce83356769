#include "models/layers/imagenet.h"

#include "gld/base/error.h"

#include <vector>

namespace gld {
namespace {

struct ChannelStatistics {
  torch::Tensor mean;
  torch::Tensor deviation;
};

ChannelStatistics statistics_like(const torch::Tensor& images) {
  if (images.dim() != 4 || images.size(1) != 3 || !images.is_floating_point()) {
    fail({"ImageNet normalisation", "floating-point RGB images (views, 3, height, width)",
          "a tensor of shape " + c10::str(images.sizes()), "convert the images to RGB in [0, 1]"});
  }
  const auto place = [&](const std::vector<double>& values) {
    return torch::tensor(values, torch::kFloat64)
        .to(images.device(), images.scalar_type())
        .view({1, 3, 1, 1});
  };
  return {place({0.485, 0.456, 0.406}), place({0.229, 0.224, 0.225})};
}

}  // namespace

torch::Tensor imagenet_normalise(const torch::Tensor& images) {
  const auto statistics = statistics_like(images);
  return (images - statistics.mean) / statistics.deviation;
}

torch::Tensor imagenet_denormalise(const torch::Tensor& images) {
  const auto statistics = statistics_like(images);
  return images * statistics.deviation + statistics.mean;
}

}  // namespace gld
