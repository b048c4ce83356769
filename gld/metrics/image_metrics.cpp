#include "gld/metrics/image_metrics.h"

#include "gld/base/error.h"
#include "gld/metrics/metric.h"

#include <cmath>
#include <string>

namespace gld {
namespace {

constexpr int64_t kRadius = 5;
constexpr int64_t kWindow = 2 * kRadius + 1;
constexpr double kWindowDeviation = 1.5;

void require_same_images(const torch::Tensor& image, const torch::Tensor& prediction,
                         const std::string& metric) {
  if (image.dim() != 4 || image.sizes() != prediction.sizes() || image.numel() == 0) {
    fail({metric, "two image batches (views, channels, height, width) of one shape",
          c10::str(image.sizes()) + " and " + c10::str(prediction.sizes()),
          "compare images of the same size"});
  }
}

torch::Tensor gaussian_window(const torch::TensorOptions& options) {
  const auto x = torch::arange(kWindow, options) - static_cast<double>(kRadius);
  const auto weights = torch::exp(x.square() / (-2 * kWindowDeviation * kWindowDeviation));
  return weights / weights.sum();
}

// Returns weighted means over every window inside the image. maps is (n, 1, height, width).
torch::Tensor windowed(const torch::Tensor& maps, const torch::Tensor& window) {
  const auto columns = torch::conv2d(maps, window.view({1, 1, kWindow, 1}));
  return torch::conv2d(columns, window.view({1, 1, 1, kWindow}));
}

}  // namespace

torch::Tensor psnr(const torch::Tensor& image, const torch::Tensor& prediction) {
  require_same_images(image, prediction, "PSNR");
  const auto difference = image.to(torch::kFloat64).clamp(0, 1) - prediction.to(torch::kFloat64).clamp(0, 1);
  return difference.square().mean({1, 2, 3}).log10() * -10;
}

torch::Tensor ssim(const torch::Tensor& image, const torch::Tensor& prediction) {
  require_same_images(image, prediction, "SSIM");
  if (image.size(2) < kWindow || image.size(3) < kWindow) {
    fail({"SSIM", "images of at least " + std::to_string(kWindow) + "x" + std::to_string(kWindow) + " pixels",
          std::to_string(image.size(3)) + "x" + std::to_string(image.size(2)), "compare larger images"});
  }
  const auto as_maps = [](const torch::Tensor& t) {
    return t.to(torch::kFloat64).reshape({t.size(0) * t.size(1), 1, t.size(2), t.size(3)});
  };
  const auto a = as_maps(image), b = as_maps(prediction).clamp(0, 1);
  const auto window = gaussian_window(a.options());
  const auto mean_a = windowed(a, window), mean_b = windowed(b, window);
  // Bessel's correction counts the window's pixels, whatever their weights (scikit-image's convention).
  constexpr double kPixels = static_cast<double>(kWindow * kWindow);
  constexpr double kSample = kPixels / (kPixels - 1);
  const auto variance_a = (windowed(a.square(), window) - mean_a.square()) * kSample;
  const auto variance_b = (windowed(b.square(), window) - mean_b.square()) * kSample;
  const auto covariance = (windowed(a * b, window) - mean_a * mean_b) * kSample;
  constexpr double kC1 = 0.01 * 0.01, kC2 = 0.03 * 0.03;
  const auto similarity = (mean_a * mean_b * 2 + kC1) * (covariance * 2 + kC2) /
                          ((mean_a.square() + mean_b.square() + kC1) * (variance_a + variance_b + kC2));
  return similarity.reshape({image.size(0), -1}).mean(1);
}

namespace {

Metric psnr_metric() {
  return {"psnr", "dB", Better::kHigher, {MetricNeed::kImages}, [](const MetricInputs& inputs) {
            return metric_of_views(psnr(inputs.true_images, inputs.images), "the images are not finite");
          }};
}

// Returns the PSNR over some of the target views' pixels: a view without any has none.
MetricValue psnr_of_pixels(const MetricInputs& inputs, const torch::Tensor& pixels) {
  const auto& truth = inputs.true_images;
  if (truth.size(0) != pixels.size(0)) return absent_metric("the images are not those of the target views");
  const auto squares = (truth.to(torch::kFloat64).clamp(0, 1) - inputs.images.to(torch::kFloat64).clamp(0, 1))
                           .square()
                           .mean(1);
  const auto chosen = pixels.to(torch::kFloat64);
  // 0 / 0, which is not a number, where there is no such pixel.
  return metric_of_views(((squares * chosen).sum({1, 2}) / chosen.sum({1, 2})).log10() * -10,
                         "no target view has such a pixel");
}

Metric psnr_seen_metric() {
  return {"psnr_seen",
          "dB",
          Better::kHigher,
          {MetricNeed::kImages, MetricNeed::kShownPixels},
          [](const MetricInputs& inputs) { return psnr_of_pixels(inputs, inputs.shown); }};
}

Metric psnr_unseen_metric() {
  return {"psnr_unseen",
          "dB",
          Better::kHigher,
          {MetricNeed::kImages, MetricNeed::kShownPixels},
          [](const MetricInputs& inputs) { return psnr_of_pixels(inputs, inputs.shown.logical_not()); }};
}

Metric ssim_metric() {
  return {"ssim", "", Better::kHigher, {MetricNeed::kImages}, [](const MetricInputs& inputs) {
            const auto& truth = inputs.true_images;
            if (truth.size(2) < kWindow || truth.size(3) < kWindow) {
              return absent_metric("the images are smaller than its window of " + std::to_string(kWindow) +
                                   " pixels");
            }
            return metric_of_views(ssim(truth, inputs.images), "the images are not finite");
          }};
}

}  // namespace

std::vector<Metric> pixel_metrics() {
  return {psnr_metric(), psnr_seen_metric(), psnr_unseen_metric(), ssim_metric()};
}

}  // namespace gld
