#include "train/objectives/diff_augment.h"

#include <cmath>

namespace gld {
namespace {

class Draws {
 public:
  Draws(const torch::Tensor& images, torch::Generator& generator) : images_(images), generator_(generator) {}

  bool happens(double probability) {
    return torch::rand({1}, generator_, torch::kFloat64).item<double>() <= probability;
  }
  // Returns (batch, 1, 1, 1), uniform in [0, 1).
  torch::Tensor uniform() {
    return torch::rand({images_.size(0), 1, 1, 1}, generator_, torch::kFloat32).to(images_.device());
  }
  // Returns a whole number a sample, uniform in [lowest, highest]: (batch).
  torch::Tensor whole(int64_t lowest, int64_t highest) {
    return torch::randint(lowest, highest + 1, {images_.size(0)}, generator_, torch::kInt64)
        .to(images_.device());
  }

 private:
  const torch::Tensor& images_;
  torch::Generator& generator_;
};

// Shifts each image by its own number of pixels along dim; what comes in is zero.
torch::Tensor shifted(const torch::Tensor& images, const torch::Tensor& amount, int64_t dim) {
  const int64_t length = images.size(dim);
  const auto shape = dim == 2 ? std::vector<int64_t>{1, 1, length, 1} : std::vector<int64_t>{1, 1, 1, length};
  const auto index = torch::arange(length, amount.options()).view(shape) + amount.view({-1, 1, 1, 1});
  const auto inside = index.ge(0).logical_and(index.lt(length));
  return images.gather(dim, index.clamp(0, length - 1).expand(images.sizes())) * inside.to(images.dtype());
}

torch::Tensor colour_changed(const torch::Tensor& images, Draws& draws) {
  auto x = images + (draws.uniform() - 0.5);
  const auto grey = x.mean(1, /*keepdim=*/true);
  x = (x - grey) * (2.0 * draws.uniform()) + grey;
  const auto mean = x.mean({1, 2, 3}, /*keepdim=*/true);
  return (x - mean) * (draws.uniform() + 0.5) + mean;
}

// Returns 1 outside a square band around each image's own position along dim.
torch::Tensor band(const torch::Tensor& images, int64_t size, Draws& draws, int64_t dim) {
  const int64_t length = images.size(dim);
  const auto start = draws.whole(0, length - size % 2).view({-1, 1, 1, 1}) - size / 2;
  const auto shape = dim == 2 ? std::vector<int64_t>{1, 1, length, 1} : std::vector<int64_t>{1, 1, 1, length};
  const auto position = torch::arange(length, start.options()).view(shape);
  return position.ge(start).logical_and(position.lt(start + size));
}

}  // namespace

void DiffAugmentOptions::visit(FieldVisitor& visitor) {
  visitor.real({"probability", "probability of each kind of augmentation"}, probability, {0.0, 1.0});
  visitor.real({"cutout", "side of the cut-out square over the image's side; 0 cuts nothing"}, cutout,
               {0.0, 1.0});
}

torch::Tensor diff_augment(const torch::Tensor& images, const DiffAugmentOptions& options,
                           torch::Generator& generator) {
  constexpr double kLargestShift = 0.125;
  Draws draws(images, generator);
  const bool shift = draws.happens(options.probability);
  const bool colour = draws.happens(options.probability);
  const bool cut = draws.happens(options.probability) && options.cutout > 0.0;
  torch::Tensor x = images;
  if (shift) {
    for (const int64_t dim : {2, 3}) {
      const auto largest = std::lround(static_cast<double>(x.size(dim)) * kLargestShift);
      x = shifted(x, draws.whole(-largest, largest), dim);
    }
  }
  if (colour) x = colour_changed(x, draws);
  if (cut) {
    const auto rows = std::lround(static_cast<double>(x.size(2)) * options.cutout);
    const auto columns = std::lround(static_cast<double>(x.size(3)) * options.cutout);
    const auto inside = band(x, rows, draws, 2).logical_and(band(x, columns, draws, 3));
    x = x * inside.logical_not().to(x.dtype());
  }
  return x;
}

}  // namespace gld
