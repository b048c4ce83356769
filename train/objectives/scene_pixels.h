#pragma once

#include "gld/cameras/camera.h"

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <torch/types.h>

namespace gld {

// (views, 3, height, width) -> (views, tokens, 3 * patch^2): each patch's pixels, row by row, channels last, as
// the RGB decoder orders them.
torch::Tensor image_patches(const torch::Tensor& images, int64_t patch);
// Does the inverse.
torch::Tensor image_of_patches(const torch::Tensor& patches, const LatentGrid& grid, int64_t patch);

// Draws a depth map in shades of grey, near is bright: (height, width) -> (3, height, width). The range is that of all
// known depths in `range`.
torch::Tensor depth_picture(const torch::Tensor& depth, const torch::Tensor& range);

// Means of the detached parts of a loss over the scenes that have them, by name, in the order of first appearance.
class PartMeans {
 public:
  void add(const std::string& name, const torch::Tensor& value);
  std::vector<std::pair<std::string, torch::Tensor>> take() const;

 private:
  struct Part {
    std::string name;
    torch::Tensor sum;
    int64_t count = 0;
  };
  std::vector<Part> parts_;
};

}  // namespace gld
