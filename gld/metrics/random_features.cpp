#include "gld/metrics/random_features.h"

#include "gld/base/error.h"
#include "gld/base/philox.h"
#include "gld/metrics/metric.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include <torch/autograd.h>

namespace gld {
namespace {

constexpr uint64_t kSeed = 1;  // any would do; it must not change

struct Layer {
  torch::Tensor weight;  // (out, in, 3, 3)
  torch::Tensor bias;    // (out)
  int64_t stride = 1;
};

// Normal weights of variance 2 / fan in, which keeps the size of activations from layer to layer (He et al. 2015).
// Without biases the features of a picture of half the contrast would be the same but for their length.
const std::vector<Layer>& layers() {
  static const std::vector<Layer> made = [] {
    const std::vector<int64_t> channels{3, 32, 64, 128, 128};
    std::vector<Layer> list;
    for (size_t i = 0; i + 1 < channels.size(); ++i) {
      Layer layer;
      layer.weight = torch::empty({channels[i + 1], channels[i], 3, 3});
      NormalRun run;
      run.key = philox_key(kSeed, "random features");
      run.index = i;
      fill_normal(run, layer.weight.data_ptr<float>(), layer.weight.numel());
      layer.weight.mul_(std::sqrt(2.0 / static_cast<double>(9 * channels[i])));
      layer.bias = torch::empty({channels[i + 1]});
      run.index = 100 + i;
      fill_normal(run, layer.bias.data_ptr<float>(), layer.bias.numel());
      layer.bias.mul_(0.5);
      layer.stride = i == 0 ? 1 : 2;
      list.push_back(layer);
    }
    return list;
  }();
  return made;
}

void require_images(const torch::Tensor& images) {
  if (images.dim() != 4 || images.size(1) != 3 ||
      std::min(images.size(2), images.size(3)) < kSmallestRandomFeatureSide) {
    fail({"random features", "RGB images (batch, 3, height, width) with sides of at least 8 pixels",
          c10::str(images.sizes()), "take larger images"});
  }
}

}  // namespace

std::vector<torch::Tensor> random_feature_maps(const torch::Tensor& images) {
  require_images(images);
  const torch::NoGradGuard no_gradients;
  std::vector<torch::Tensor> maps;
  torch::Tensor x = images.to(torch::kCPU, torch::kFloat32).clamp(0, 1) * 2 - 1;
  for (const Layer& layer : layers()) {
    x = torch::relu(torch::conv2d(x, layer.weight, layer.bias, layer.stride, /*padding=*/1));
    maps.push_back(x / (x.norm(2, 1, /*keepdim=*/true) + 1e-10));
  }
  return maps;
}

torch::Tensor random_feature_distance(const torch::Tensor& images, const torch::Tensor& others) {
  if (images.dim() != 4 || images.size(1) != 3 || images.sizes() != others.sizes() ||
      std::min(images.size(2), images.size(3)) < kSmallestRandomFeatureSide) {
    fail({"random features", "two batches of RGB images of one shape with sides of at least 8 pixels",
          c10::str(images.sizes()) + " and " + c10::str(others.sizes()), "compare larger images"});
  }
  const torch::NoGradGuard no_gradients;
  const auto of_images = random_feature_maps(images), of_others = random_feature_maps(others);
  auto sum = torch::zeros({images.size(0)}, torch::kFloat64);
  for (size_t layer = 0; layer < of_images.size(); ++layer) {
    sum += (of_images[layer] - of_others[layer]).square().sum(1).mean({1, 2}).to(torch::kFloat64);
  }
  return sum / static_cast<double>(of_images.size());
}

namespace {

Metric random_features_metric() {
  return {"random_features", "", Better::kLower, {MetricNeed::kImages}, [](const MetricInputs& inputs) {
            if (std::min(inputs.images.size(2), inputs.images.size(3)) < kSmallestRandomFeatureSide) {
              return absent_metric("random features take images of at least 8 pixels");
            }
            return metric_of_views(random_feature_distance(inputs.true_images, inputs.images),
                                   "the distance is not a number");
          }};
}

}  // namespace

std::vector<Metric> random_feature_metrics() { return {random_features_metric()}; }

}  // namespace gld
