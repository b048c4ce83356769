#pragma once

#include "gld/cameras/camera.h"
#include "models/decoders/dpt_fusion.h"
#include "models/decoders/geometry_head.h"
#include "models/layers/child_module.h"
#include "models/layers/convolution.h"
#include "models/layers/layers.h"

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

struct DptSizes {
  int64_t dim_in = 0;                 // channels of a level
  int64_t features = 0;               // channels of the fused maps
  std::vector<int64_t> out_channels;  // of the four levels' projections
  int64_t patch_size = 14;            // pixels
  bool pos_embed = true;
  int64_t down_ratio = 1;  // depth maps have 1/down_ratio of the image's sides

  void visit(FieldVisitor& visitor);
  void check() const;
};

// What the DPT heads of DA3 and VGGT have in common (Ranftl et al. 2021, section 3): a pyramid of maps of the four
// levels, fused from coarse to fine, and a decoder of full size. It is registered on the head that owns it, under the
// published names.
class DptTrunk {
 public:
  // exp(+-80) is inside float32's normal range, with room for products with coordinates; no trained head
  // comes near it.
  static constexpr double kLargestLogit = 80;
  static constexpr int64_t kHiddenChannels = 32;  // of the last convolution of decoders
  // Views are processed together up to this many pixels, whose depth decoder holds about 300 MB of maps.
  static constexpr int64_t kPixelsPerChunk = 504 * 504;

  DptTrunk(torch::nn::Module& head, const DptSizes& sizes, const ParameterPlacement& placement);

  const std::shared_ptr<torch::nn::Module>& scratch() const { return scratch_; }

  struct Pyramid {
    std::vector<torch::Tensor> maps;  // finest first; (views, features, rows, columns)
  };
  Pyramid pyramid(const std::vector<torch::Tensor>& levels, const LatentGrid& grid) const;
  static torch::Tensor fuse(const Pyramid& pyramid, const std::vector<std::shared_ptr<FusionBlock>>& stages);
  // Makes of fused maps maps of the output's size, with positions.
  torch::Tensor enlarged(const torch::Tensor& fused, const LatentGrid& grid) const;
  torch::Tensor with_positions(const torch::Tensor& maps, const LatentGrid& grid) const;

  // Throws Error unless there are four levels of these views.
  void check_levels(const std::vector<torch::Tensor>& levels, const LatentGrid& grid) const;
  // Calls with the pyramid of one chunk of views after the other.
  void for_each_chunk(const std::vector<torch::Tensor>& levels, const LatentGrid& grid,
                      const std::function<void(const Pyramid&)>& use) const;

  // Returns "refinenet1" to "refinenet4" with that suffix, registered on the scratch module.
  std::vector<std::shared_ptr<FusionBlock>> fusion_stages(const std::string& suffix, FusionResidual residual,
                                                          const ParameterPlacement& placement) const;

 private:
  DptSizes sizes_;
  std::shared_ptr<torch::nn::Module> scratch_;
  std::shared_ptr<LayerNorm> norm_;
  std::vector<std::shared_ptr<Convolution>> projects_;
  std::shared_ptr<BlockUpsampling> enlarge4_, enlarge2_;
  std::shared_ptr<Convolution> reduce2_;
  std::vector<std::shared_ptr<Convolution>> lateral_;  // layer1_rn .. layer4_rn
};

// Registers a part of a head.
std::shared_ptr<Convolution> child_convolution(torch::nn::Module& parent, const std::string& name,
                                               const ConvolutionSizes& sizes,
                                               const ParameterPlacement& placement);

// Returns exp, finite for any finite logits.
torch::Tensor bounded_exponential(const torch::Tensor& logits);

// These add the operations of one pass: the pyramid and the fusion by `decoders` decoders; one decoder of full size.
void add_dpt_pyramid(Cost& cost, const DptSizes& sizes, const LatentGrid& grid, double decoders);
void add_dpt_output(Cost& cost, const DptSizes& sizes, const LatentGrid& grid);
// These count the activations of a chunk of views, and of all views the maps of so many channels a full-size pixel and
// a ray.
struct DptMapChannels {
  double full_size = 0;
  double rays = 0;
};
int64_t dpt_working_bytes(const DptSizes& sizes, const LatentGrid& grid, const DptMapChannels& channels);

}  // namespace gld
