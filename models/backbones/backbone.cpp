#include "models/backbones/backbone.h"

#include "gld/base/error.h"

namespace gld {

LatentGrid BackboneArchitecture::grid_of(int64_t views, int64_t image_height, int64_t image_width) const {
  const int64_t p = patch_side();
  if (image_height < p || image_width < p || image_height % p != 0 || image_width % p != 0) {
    fail({"backbone", "image sides that are positive multiples of " + std::to_string(p) + " pixels",
          std::to_string(image_width) + "x" + std::to_string(image_height), "resize or crop the images"});
  }
  return {views, image_height / p, image_width / p};
}

torch::Tensor Backbone::carried_tokens(const torch::Tensor& first_source, int64_t level) const {
  const auto levels = encode(first_source, level);
  return levels.at(static_cast<size_t>(level)).narrow(1, 0, architecture().leading_tokens()).contiguous();
}

torch::Tensor Backbone::patches_of(const torch::Tensor& level) const {
  return level.slice(1, architecture().leading_tokens());
}

DecodableLevel Backbone::decodable(const torch::Tensor& level) const {
  DecodableLevel result;
  result.patches = normalise_for_decoding(patches_of(level));
  result.leading = level.narrow(1, 0, architecture().leading_tokens()).contiguous();
  return result;
}

}  // namespace gld
