#pragma once

#include "gld/base/options.h"
#include "gld/cameras/camera.h"
#include "models/decoders/dpt_fusion.h"
#include "models/layers/convolution.h"
#include "models/layers/layers.h"

#include <cstdint>
#include <memory>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// Defaults are DA3-Base's head.
struct DptHeadOptions : OptionsGroup {
  int64_t dim_in = 1536;                                    // channels of a level
  int64_t features = 128;                                   // channels of the fused maps
  std::vector<int64_t> out_channels = {96, 192, 384, 768};  // of the four levels' projections
  int64_t patch_size = 14;                                  // pixels
  bool pos_embed = true;
  int64_t down_ratio = 1;          // depth maps have 1/down_ratio of the image's sides
  int64_t aux_pyramid_levels = 4;  // pre-heads stored for rays; only the last is used
  int64_t aux_out1_conv_num = 5;   // convolutions of each pre-head: 1, 3 or 5

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Which of its maps the head computes.
enum class GeometryMaps { kDepth, kRays, kDepthAndRays };

// Maps that were not asked for are undefined. Depth and confidences come from exponentials whose logits are
// clamped to +-DptHead::kLargestLogit, so they are finite and depth is positive for any finite features.
struct GeometryOutput {
  torch::Tensor depth;             // (views, height, width), > 0, in units of the backbone's scene scale
  torch::Tensor depth_confidence;  // (views, height, width), >= 1
  torch::Tensor
      rays;  // (views, 8 grid height, 8 grid width, 6): direction and origin (gld/cameras/view_maps.h)
  torch::Tensor ray_confidence;  // (views, 8 grid height, 8 grid width), >= 1
};

// Depth Anything 3's dual DPT head: one pyramid of the four levels, one decoder for depth and one for rays
// (depth_anything_3/model/dualdpt.py of the published code). Parameters have the published names behind
// kPrefix.
class DptHead : public torch::nn::Module {
 public:
  static constexpr const char* kPrefix = "model.head.";
  // exp(+-80) is inside float32's normal range, with room for products with coordinates; no trained head
  // comes near it.
  static constexpr double kLargestLogit = 80;
  static constexpr int64_t kHiddenChannels = 32;  // of the last convolution of both decoders
  // Views are processed together up to this many pixels, whose depth decoder holds about 300 MB of maps.
  static constexpr int64_t kPixelsPerChunk = 504 * 504;

  DptHead(const DptHeadOptions& options, const ParameterPlacement& placement);

  const DptHeadOptions& options() const { return options_; }

  // levels: the four decodable levels, (views, tokens, dim_in) each, patch tokens only. Views are processed
  // in chunks of about one 504x504 image, so that only the maps it returns grow with them.
  GeometryOutput forward(const std::vector<torch::Tensor>& levels, const LatentGrid& grid,
                         GeometryMaps maps) const;

  // Random weights to train from.
  void initialise(const torch::Generator& generator);

 private:
  struct Pyramid {
    std::vector<torch::Tensor> maps;  // finest first; (views, features, rows, columns)
  };
  Pyramid pyramid(const std::vector<torch::Tensor>& levels, const LatentGrid& grid) const;
  torch::Tensor fuse(const Pyramid& pyramid, const std::vector<std::shared_ptr<FusionBlock>>& stages) const;
  torch::Tensor depth_logits(const Pyramid& pyramid, const LatentGrid& grid) const;
  torch::Tensor ray_logits(const Pyramid& pyramid, const LatentGrid& grid) const;
  torch::Tensor with_positions(const torch::Tensor& maps, const LatentGrid& grid) const;

  DptHeadOptions options_;
  std::shared_ptr<LayerNorm> norm_;
  std::vector<std::shared_ptr<Convolution>> projects_;
  std::shared_ptr<BlockUpsampling> enlarge4_, enlarge2_;
  std::shared_ptr<Convolution> reduce2_;
  std::vector<std::shared_ptr<Convolution>> lateral_;       // layer1_rn .. layer4_rn
  std::vector<std::shared_ptr<FusionBlock>> depth_stages_;  // refinenet1 .. 4
  std::vector<std::shared_ptr<FusionBlock>> ray_stages_;    // refinenet1_aux .. 4_aux
  std::shared_ptr<Convolution> depth_neck_, depth_hidden_, depth_output_;
  std::vector<std::shared_ptr<Convolution>> ray_neck_;  // of the last pyramid level
  std::shared_ptr<Convolution> ray_hidden_, ray_output_;
  std::shared_ptr<LayerNorm> ray_norm_;
};

}  // namespace gld
