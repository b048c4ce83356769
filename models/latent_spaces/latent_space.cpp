#include "models/latent_spaces/latent_space.h"

#include "gld/base/error.h"

#include <algorithm>
#include <utility>

namespace gld {
namespace {

// Makes of the rows of Backbone::leading_for_propagation (views, leading tokens, C): the last row is that of all
// further views.
torch::Tensor leading_of_views(const torch::Tensor& rows, int64_t views) {
  const int64_t own = std::min(rows.size(0) - 1, views);
  const auto others = rows.slice(0, -1).expand({views - own, rows.size(1), rows.size(2)});
  return torch::cat({rows.narrow(0, 0, own), others});
}

}  // namespace

LatentSpace::LatentSpace(std::shared_ptr<const Backbone> backbone, int64_t boundary)
    : backbone_(std::move(backbone)), boundary_(boundary) {
  if (boundary_ < 0 || boundary_ >= levels()) {
    fail({"boundary_level", "a level below " + std::to_string(levels()), std::to_string(boundary_),
          "choose one of the backbone's levels"});
  }
}

LatentGrid LatentSpace::grid_of(int64_t views, int64_t image_height, int64_t image_width) const {
  return backbone_->architecture().grid_of(views, image_height, image_width);
}

std::vector<torch::Tensor> LatentSpace::encode(const torch::Tensor& images, int64_t deepest) const {
  return backbone_->encode(images, deepest);
}

torch::Tensor LatentSpace::leading_for_propagation(const torch::Tensor& source_images,
                                                   const std::vector<torch::Tensor>& encoded) const {
  const auto boundary = static_cast<size_t>(boundary_);
  const bool alone =
      encoded.size() > boundary && !backbone_->architecture().encodes_leading(source_images.size(0));
  return alone ? encoded[boundary].slice(0, 0, 1).narrow(1, 0, leading_tokens()).contiguous()
               : backbone_->leading_for_propagation(source_images.slice(0, 0, 1), boundary_);
}

torch::Tensor LatentSpace::decodable(const torch::Tensor& raw_level) const {
  return backbone_->decodable(raw_level).patches;
}

CompletedLevels LatentSpace::complete(const std::map<int64_t, torch::Tensor>& generated,
                                      const torch::Tensor& leading, const LatentGrid& grid) const {
  CompletedLevels result;
  result.patches.resize(static_cast<size_t>(levels()));
  for (const auto& [level, tokens] : generated) {
    const bool special = tokens.size(1) > grid.tokens_per_view();
    if (level != boundary_) {
      result.patches.at(static_cast<size_t>(level)) =
          backbone_->normalise_for_decoding(special ? backbone_->patches_of(tokens) : tokens);
      continue;
    }
    PropagationStart start;
    start.level = level;
    start.grid = grid;
    start.tokens = special ? tokens : torch::cat({leading_of_views(leading, grid.views), tokens}, 1);
    // Propagation attends over all views, so all take part whatever is decoded.
    const auto propagated = backbone_->propagate(start);
    for (size_t i = 0; i < propagated.size(); ++i) {
      result.patches.at(static_cast<size_t>(level) + i) = propagated[i].patches;
    }
    result.leading = propagated.back().leading;
  }
  return result;
}

torch::Tensor generated_tokens(const torch::Tensor& raw_level, int64_t leading_tokens,
                               int64_t special_tokens) {
  if (special_tokens == 0) return raw_level.slice(1, leading_tokens).contiguous();
  if (special_tokens != leading_tokens) {
    fail({"num_special_tokens",
          "0, or " + std::to_string(leading_tokens) + ", the backbone's tokens in front of the patches",
          std::to_string(special_tokens), "change it in model.yaml"});
  }
  return raw_level;
}

}  // namespace gld
