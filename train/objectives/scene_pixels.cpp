#include "train/objectives/scene_pixels.h"

#include <algorithm>

namespace gld {

torch::Tensor image_patches(const torch::Tensor& images, int64_t patch) {
  const int64_t views = images.size(0), rows = images.size(2) / patch, columns = images.size(3) / patch;
  return images.reshape({views, 3, rows, patch, columns, patch})
      .permute({0, 2, 4, 3, 5, 1})
      .reshape({views, rows * columns, 3 * patch * patch});
}

torch::Tensor image_of_patches(const torch::Tensor& patches, const LatentGrid& grid, int64_t patch) {
  return patches.reshape({grid.views, grid.height, grid.width, patch, patch, 3})
      .permute({0, 5, 1, 3, 2, 4})
      .reshape({grid.views, 3, grid.height * patch, grid.width * patch});
}

torch::Tensor depth_picture(const torch::Tensor& depth, const torch::Tensor& range) {
  const auto known = range.masked_select(range > 0.0);
  if (known.numel() == 0) return torch::zeros({3, depth.size(0), depth.size(1)});
  const double nearest = 1.0 / known.max().item<double>();
  const double farthest = 1.0 / known.min().item<double>();
  const auto grey = (depth.clamp_min(1e-9).reciprocal() - nearest) / std::max(farthest - nearest, 1e-12);
  return (grey.clamp(0.0, 1.0) * (depth > 0.0).to(grey.dtype())).expand({3, depth.size(0), depth.size(1)});
}

void PartMeans::add(const std::string& name, const torch::Tensor& value) {
  for (Part& part : parts_) {
    if (part.name == name) {
      part.sum = part.sum + value.detach();
      ++part.count;
      return;
    }
  }
  parts_.push_back({name, value.detach(), 1});
}

std::vector<std::pair<std::string, torch::Tensor>> PartMeans::take() const {
  std::vector<std::pair<std::string, torch::Tensor>> means;
  means.reserve(parts_.size());
  for (const Part& part : parts_) means.emplace_back(part.name, part.sum / static_cast<double>(part.count));
  return means;
}

}  // namespace gld
