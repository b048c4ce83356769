#include "models/latent_spaces/geometric_latent_space.h"

#include "gld/base/error.h"

#include <algorithm>
#include <utility>

namespace gld {
namespace {

// Rows of Backbone::carried_tokens -> (views, leading tokens, C): the last row is that of all further views.
torch::Tensor carried_to_views(const torch::Tensor& carried, int64_t views) {
  const int64_t own = std::min(carried.size(0) - 1, views);
  const auto others = carried.slice(0, -1).expand({views - own, carried.size(1), carried.size(2)});
  return torch::cat({carried.narrow(0, 0, own), others});
}

}  // namespace

GeometricLatentSpace::GeometricLatentSpace(std::shared_ptr<const Backbone> backbone, int64_t boundary)
    : backbone_(std::move(backbone)), boundary_(boundary) {
  if (boundary_ < 0 || boundary_ >= levels()) {
    fail({"boundary_level", "a level below " + std::to_string(levels()), std::to_string(boundary_),
          "choose one of the backbone's levels"});
  }
}

LatentGrid GeometricLatentSpace::grid_of(int64_t views, int64_t image_height, int64_t image_width) const {
  return backbone_->architecture().grid_of(views, image_height, image_width);
}

std::vector<torch::Tensor> GeometricLatentSpace::encode(const torch::Tensor& images, int64_t deepest) const {
  return backbone_->encode(images, deepest);
}

SourceLatents GeometricLatentSpace::encode_sources(const torch::Tensor& images,
                                                   const SourceEncoding& wanted) const {
  SourceLatents sources;
  sources.grid = grid_of(images.size(0), images.size(2), images.size(3));
  sources.levels = backbone_->encode(images, wanted.deepest);
  if (!wanted.carried) return sources;
  // The encoding of all source views says it already.
  const bool alone =
      wanted.deepest >= boundary_ && !backbone_->architecture().encodes_carried_tokens(images.size(0));
  sources.carried = alone ? sources.levels[static_cast<size_t>(boundary_)]
                                .slice(0, 0, 1)
                                .narrow(1, 0, leading_tokens())
                                .contiguous()
                          : backbone_->carried_tokens(images.slice(0, 0, 1), boundary_);
  return sources;
}

torch::Tensor GeometricLatentSpace::decodable(const torch::Tensor& raw_level) const {
  return backbone_->decodable(raw_level).patches;
}

CompletedLevels GeometricLatentSpace::complete(const std::map<int64_t, torch::Tensor>& generated,
                                               const torch::Tensor& carried, const LatentGrid& grid) const {
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
    start.tokens = special ? tokens : torch::cat({carried_to_views(carried, grid.views), tokens}, 1);
    // Propagation attends over all views, so all take part whatever is decoded.
    const auto propagated = backbone_->propagate(start);
    for (size_t i = 0; i < propagated.size(); ++i) {
      result.patches.at(static_cast<size_t>(level) + i) = propagated[i].patches;
    }
    result.leading = propagated.back().leading;
  }
  return result;
}

}  // namespace gld
