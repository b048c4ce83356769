#include "models/losses/perceptual_standin.h"

#include "gld/base/error.h"

#include <algorithm>

namespace gld {
namespace {

constexpr int64_t kWindow = 7;

torch::Tensor box_mean(const torch::Tensor& x) { return torch::avg_pool2d(x, kWindow, 1); }

// Returns (batch): the mean of the SSIM map over channels and pixels.
torch::Tensor similarity(const torch::Tensor& a, const torch::Tensor& b) {
  constexpr double c1 = 0.01 * 0.01, c2 = 0.03 * 0.03;
  const auto mean_a = box_mean(a), mean_b = box_mean(b);
  const auto mean_ab = mean_a * mean_b;
  const auto mean_aa = mean_a.square(), mean_bb = mean_b.square();
  const auto variance_a = box_mean(a.square()) - mean_aa;
  const auto variance_b = box_mean(b.square()) - mean_bb;
  const auto covariance = box_mean(a * b) - mean_ab;
  const auto map = (2.0 * mean_ab + c1) * (2.0 * covariance + c2) /
                   ((mean_aa + mean_bb + c1) * (variance_a + variance_b + c2));
  return map.mean({1, 2, 3});
}

torch::Tensor gradient_difference(const torch::Tensor& a, const torch::Tensor& b) {
  const auto difference = a - b;
  const auto along_rows = difference.diff(1, 3), along_columns = difference.diff(1, 2);
  return along_rows.abs().mean({1, 2, 3}) + along_columns.abs().mean({1, 2, 3});
}

// Returns (batch, channels, height - 7, width - 7): the root mean square of the differences in a window. Where there
// are none the root has no slope; what is added is the square of a third of a step of 8 bits.
torch::Tensor edge_strength(const torch::Tensor& image) {
  constexpr double kNothing = 1.7e-6;
  const auto squares = image.diff(1, 3).slice(2, 0, -1).square() + image.diff(1, 2).slice(3, 0, -1).square();
  return (box_mean(squares) + kNothing).sqrt();
}

torch::Tensor edge_difference(const torch::Tensor& a, const torch::Tensor& b) {
  return (edge_strength(a) - edge_strength(b)).abs().mean({1, 2, 3});
}

}  // namespace

void PerceptualStandinOptions::visit(FieldVisitor& visitor) {
  visitor.integer({"scales", "image scales, each half the one before"}, scales, {1, 8});
  visitor.real({"gradient_weight", "weight of the difference of image gradients"}, gradient_weight,
               {0.0, 1e6});
  visitor.real({"similarity_weight", "weight of (1 - SSIM) / 2"}, similarity_weight, {0.0, 1e6});
  visitor.real({"edge_weight", "weight of the difference of how strong edges are, wherever exactly they run"},
               edge_weight, {0.0, 1e6});
}

torch::Tensor perceptual_standin(const torch::Tensor& image, const torch::Tensor& prediction,
                                 const PerceptualStandinOptions& options) {
  if (image.dim() != 4 || image.sizes() != prediction.sizes() ||
      std::min(image.size(2), image.size(3)) < kWindow) {
    fail({"perceptual loss", "two batches of images of one shape with sides of at least 7 pixels",
          c10::str(image.sizes()) + " and " + c10::str(prediction.sizes()), "check the image size"});
  }
  torch::Tensor a = image, b = prediction;
  torch::Tensor sum = torch::zeros({image.size(0)}, image.options());
  for (int64_t scale = 0; scale < options.scales && std::min(a.size(2), a.size(3)) >= kWindow; ++scale) {
    if (scale > 0) {
      a = torch::avg_pool2d(a, 2);
      b = torch::avg_pool2d(b, 2);
      if (std::min(a.size(2), a.size(3)) < kWindow) break;
    }
    sum = sum + options.gradient_weight * gradient_difference(a, b) +
          options.similarity_weight * 0.5 * (1.0 - similarity(a, b));
    if (options.edge_weight > 0 && std::min(a.size(2), a.size(3)) > kWindow) {
      sum = sum + options.edge_weight * edge_difference(a, b);
    }
  }
  return sum / static_cast<double>(options.scales);
}

}  // namespace gld
