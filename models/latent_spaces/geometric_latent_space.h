#pragma once

#include "models/backbones/backbone.h"
#include "models/latent_spaces/latent_space.h"

#include <memory>

namespace gld {

// The levels of a frozen backbone (docs/DESIGN.md section 4, "Propagation"): the boundary level goes through the
// remaining blocks, which gives the levels behind it; backbones that propagate none have the deepest level as their
// boundary.
class GeometricLatentSpace : public LatentSpace {
 public:
  // boundary: level that propagation starts from.
  GeometricLatentSpace(std::shared_ptr<const Backbone> backbone, int64_t boundary);

  int64_t levels() const override { return backbone_->architecture().levels(); }
  int64_t leading_tokens() const override { return backbone_->architecture().leading_tokens(); }
  LatentGrid grid_of(int64_t views, int64_t image_height, int64_t image_width) const override;
  std::vector<torch::Tensor> encode(const torch::Tensor& images, int64_t deepest) const override;
  SourceLatents encode_sources(const torch::Tensor& images, const SourceEncoding& wanted) const override;
  torch::Tensor decodable(const torch::Tensor& raw_level) const override;
  CompletedLevels complete(const std::map<int64_t, torch::Tensor>& generated, const torch::Tensor& carried,
                           const LatentGrid& grid) const override;

 private:
  std::shared_ptr<const Backbone> backbone_;
  int64_t boundary_;
};

}  // namespace gld
