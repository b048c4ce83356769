#include "gld/metrics/sharpness.h"

#include "gld/base/error.h"
#include "gld/metrics/metric.h"

#include <limits>

namespace gld {

torch::Tensor gradient_energy(const torch::Tensor& images) {
  if (images.dim() != 4 || images.size(2) < 2 || images.size(3) < 2) {
    fail({"sharpness", "images (views, channels, height, width) of at least 2x2 pixels",
          c10::str(images.sizes()), "compare larger images"});
  }
  const auto values = images.to(torch::kFloat64).clamp(0, 1);
  const auto steps = [&](int64_t dimension) {
    return values.diff(/*n=*/1, dimension).square().mean({1, 2, 3});
  };
  return steps(2) + steps(3);
}

torch::Tensor sharpness(const torch::Tensor& image, const torch::Tensor& prediction) {
  const auto truth = gradient_energy(image), made = gradient_energy(prediction);
  return torch::where(truth > 0, made / truth,
                      torch::full_like(truth, std::numeric_limits<double>::quiet_NaN()));
}

namespace {

Metric sharpness_metric() {
  return {"sharpness", "", Better::kNearOne, {MetricNeed::kImages}, [](const MetricInputs& inputs) {
            return metric_of_views(sharpness(inputs.true_images, inputs.images),
                                   "the true images have no edges");
          }};
}

}  // namespace

std::vector<Metric> sharpness_metrics() { return {sharpness_metric()}; }

}  // namespace gld
