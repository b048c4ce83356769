#pragma once

#include "gld/base/options.h"
#include "gld/cameras/camera.h"
#include "models/decoders/camera_decoder.h"
#include "models/decoders/dpt_trunk.h"
#include "models/decoders/geometry_head.h"
#include "models/layers/convolution.h"
#include "models/layers/layers.h"

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// Defaults are DA3-Base's head.
struct DptHeadOptions : GeometryHeadArchitecture, DptSizes {
  int64_t aux_pyramid_levels = 4;  // pre-heads stored for rays; only the last is used
  int64_t aux_out1_conv_num = 5;   // convolutions of each pre-head: 1, 3 or 5
  bool camera_decoder = false;     // whether the bundle has it

  DptHeadOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;

  std::string kind() const override { return "da3"; }
  std::unique_ptr<GeometryHeadArchitecture> copy() const override;
  std::shared_ptr<GeometryHead> make(const ParameterPlacement& placement) const override;
  std::string published_prefix() const override;
  std::vector<std::pair<std::string, std::string>> published_elsewhere() const override {
    if (!camera_decoder) return {};
    return {{"model.cam_dec.", "cam_dec."}};
  }
  int64_t level_channels() const override { return dim_in; }
  int64_t patch_side() const override { return patch_size; }
  bool decodes_cameras() const override { return camera_decoder; }
  Cost cost(const LatentGrid& grid, GeometryMaps maps) const override;
};

// Depth Anything 3's dual DPT head: one pyramid of the four levels, one decoder for depth and one for rays
// (depth_anything_3/model/dualdpt.py of the published code). Parameters have the published names behind
// kPrefix. Depth and confidences come from exponentials whose logits are clamped to +-DptTrunk::kLargestLogit, so they
// are finite and depth is positive for any finite features.
class DptHead : public GeometryHead {
 public:
  static constexpr const char* kPrefix = "model.head.";

  DptHead(const DptHeadOptions& options, const ParameterPlacement& placement);

  const DptHeadOptions& options() const { return options_; }

  // levels are the four decodable levels, (views, tokens, dim_in) each, patch tokens only. Views are processed
  // in chunks of about one 504x504 image, so that only the maps it returns grow with them.
  GeometryOutput forward(const std::vector<torch::Tensor>& levels, const LatentGrid& grid,
                         GeometryMaps maps) const;
  // Returns the same and, with rays, the cameras that a camera decoder finds in the leading tokens, of which each view
  // has one.
  GeometryOutput forward(const GeometryInputs& inputs, const LatentGrid& grid,
                         GeometryMaps maps) const override;

  void initialise(const torch::Generator& generator) override;

 private:
  torch::Tensor depth_logits(const DptTrunk::Pyramid& pyramid, const LatentGrid& grid) const;
  torch::Tensor ray_logits(const DptTrunk::Pyramid& pyramid, const LatentGrid& grid) const;

  DptHeadOptions options_;
  DptTrunk trunk_;
  std::vector<std::shared_ptr<FusionBlock>> depth_stages_;  // refinenet1 .. 4
  std::vector<std::shared_ptr<FusionBlock>> ray_stages_;    // refinenet1_aux .. 4_aux
  std::shared_ptr<Convolution> depth_neck_, depth_hidden_, depth_output_;
  std::vector<std::shared_ptr<Convolution>> ray_neck_;  // of the last pyramid level
  std::shared_ptr<Convolution> ray_hidden_, ray_output_;
  std::shared_ptr<LayerNorm> ray_norm_;
  std::shared_ptr<CameraDecoder> camera_decoder_;  // null without one
};

}  // namespace gld
