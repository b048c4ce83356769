#pragma once

#include "gld/attention/attention.h"
#include "gld/base/options.h"
#include "gld/cameras/camera.h"
#include "models/layers/layers.h"
#include "models/layers/operation_cost.h"

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

class Backbone;

// The sizes of a backbone, and what the rest of the program asks about them. Each family has one, with
// its own fields, in its own file; backbone_registry.h lists them.
class BackboneArchitecture : public OptionsGroup {
 public:
  ~BackboneArchitecture() override = default;

  // Returns the name that model.yaml and backbone_registry.h have for it.
  virtual std::string kind() const = 0;
  virtual std::unique_ptr<BackboneArchitecture> copy() const = 0;
  virtual std::shared_ptr<Backbone> make(const ParameterPlacement& placement) const = 0;
  // Returns the beginning of the tensors' names in the published file.
  virtual std::string published_prefix() const = 0;
  // Returns the parts of the module that have another beginning in the published file: {there, in the module}.
  virtual std::vector<std::pair<std::string, std::string>> published_elsewhere() const { return {}; }

  virtual int64_t patch_side() const = 0;  // pixels
  virtual int64_t levels() const = 0;      // how many the decoders take
  virtual int64_t latent_pixels() const {
    return 1;
  }                                            // of a token along each side, where it holds some of a latent
  virtual int64_t level_channels() const = 0;  // C
  // Returns how many tokens stand in front of the patch tokens of a level: class, camera and register tokens.
  virtual int64_t leading_tokens() const = 0;
  // Returns the rows of Backbone::leading_for_propagation: 1 where all views get the same leading tokens, 2 where the
  // first view's are others.
  virtual int64_t leading_rows() const { return 1; }
  // Returns whether Backbone::leading_for_propagation runs the backbone once more, for so many source views: a source
  // alone has been encoded alone already, and a backbone without leading tokens has none to give.
  bool encodes_leading(int64_t num_sources) const {
    return propagates() && leading_tokens() > 0 && (num_sources > 1 || leading_rows() > 1);
  }
  // Returns whether Backbone::propagate makes deeper levels of a level.
  virtual bool propagates() const { return true; }

  virtual int64_t blocks() const = 0;
  // Returns whether that block's attention is over the tokens of all views and not of one alone.
  virtual bool attends_over_views(int64_t block) const = 0;

  // Returns whether Backbone::encode_with_cameras can be told the views' cameras.
  virtual bool takes_cameras() const { return false; }

  // Returns the cost of Backbone::encode up to that level, and of Backbone::propagate from it, for all views of the
  // grid.
  virtual Cost encoding_cost(const LatentGrid& grid, int64_t last_level) const = 0;
  virtual Cost propagation_cost(const LatentGrid& grid, int64_t level) const = 0;

  // Returns whether it makes images of its level by itself, as an autoencoder's other half does in the place of an RGB
  // decoder.
  virtual bool decodes_images() const { return false; }
  virtual Cost decoding_cost(const LatentGrid& /*grid*/) const { return {}; }

  // Returns the grid of an image; throws Error unless both sides are whole patches.
  LatentGrid grid_of(int64_t views, int64_t image_height, int64_t image_width) const;
};

// A level after the final normalisation, as decoders take it.
struct DecodableLevel {
  torch::Tensor leading;  // (views, leading tokens, C), raw
  torch::Tensor patches;  // (views, tokens, C)
};

// Makes maps (views, channels, rows, columns) on the CPU of tokens (views, tokens, channels) of that grid.
torch::Tensor token_maps(const torch::Tensor& tokens, const LatentGrid& grid);

// Images through both halves of an autoencoder, with gradients.
struct Autoencoding {
  torch::Tensor images;      // (views, 3, height, width), RGB in about [0, 1]
  torch::Tensor divergence;  // a scalar: how far latents are from standard normal ones
};

struct PropagationStart {
  int64_t level = 1;
  torch::Tensor tokens;  // (views, leading tokens + tokens, C) raw, leading tokens first
  LatentGrid grid;
};

// Latents are those of this: a frozen geometric foundation model (DA3, docs/DESIGN.md section 4, "Backbone"), another
// network of image features, or an autoencoder; all register themselves. Outside models/backbones only the table of
// published files names one of them (models/bundle/published_backbones.h). View 0 is the reference view; views are
// never reordered.
class Backbone : public torch::nn::Module {
 public:
  virtual const BackboneArchitecture& architecture() const = 0;

  // images are (views, 3, height, width), RGB in [0, 1], sides whole patches. Returns levels 0..last_level, each
  // (views, leading tokens + tokens, C), raw; blocks behind last_level's are not run.
  std::vector<torch::Tensor> encode(const torch::Tensor& images, int64_t last_level) const {
    return encode(images, last_level, nullptr);
  }
  // taps is what training wants of the attention of blocks that attend over all views; it is null for nothing.
  virtual std::vector<torch::Tensor> encode(const torch::Tensor& images, int64_t last_level,
                                            std::vector<AttentionTap>* taps) const = 0;

  // Does the same for views whose cameras are known, one for each image, in any world and unit (DESIGN.md section 4,
  // "Known cameras"); their sizes are those that their intrinsics are for. Throws Error unless
  // architecture().takes_cameras().
  std::vector<torch::Tensor> encode_with_cameras(const torch::Tensor& images, int64_t last_level,
                                                 const std::vector<Camera>& cameras) const {
    return encode_with_cameras(images, last_level, cameras, nullptr);
  }
  virtual std::vector<torch::Tensor> encode_with_cameras(const torch::Tensor& images, int64_t last_level,
                                                         const std::vector<Camera>& cameras,
                                                         std::vector<AttentionTap>* taps) const;

  // Returns the leading tokens that propagation from that level gives to the views, (leading_rows, leading tokens, C)
  // raw, the last row for all views that have none of their own: new views have no image to take them from, so they get
  // those of `first_source` (1, 3, height, width), RGB in [0, 1]; with one row, encoded alone.
  virtual torch::Tensor leading_for_propagation(const torch::Tensor& first_source, int64_t level) const;

  // Runs the blocks behind start.level. Returns levels start.level (as given) to the last.
  virtual std::vector<DecodableLevel> propagate(const PropagationStart& start) const = 0;

  // Makes of (views, tokens, C) raw what the geometry head and the RGB decoder take.
  virtual torch::Tensor normalise_for_decoding(const torch::Tensor& patches) const = 0;

  // Of architectures with decodes_images() it decodes (views, tokens, C), decodable, to images (views, 3, height,
  // width), RGB in about [0, 1], not clamped. It throws Error for others.
  virtual torch::Tensor decode(const torch::Tensor& patches, const LatentGrid& grid) const;

  // Does the same for training: latents may be drawn with the generator. Throws Error for others.
  virtual Autoencoding autoencode(const torch::Tensor& images, const torch::Generator& generator) const;

  // Splits a raw level into leading tokens and decodable patches.
  DecodableLevel decodable(const torch::Tensor& level) const;
  // Returns the patch tokens of a raw level.
  torch::Tensor patches_of(const torch::Tensor& level) const;
  // Returns the deepest level of each image, encoded alone, so that nothing that views tell each other goes in: maps
  // (views, C, rows, columns) on the CPU. images are as encode() takes them.
  torch::Tensor features_of_each(const torch::Tensor& images) const;

  // Draws random weights to train from.
  virtual void initialise(const torch::Generator& generator) = 0;

 protected:
  // These throw the errors of who calls.
  void require_level(int64_t level) const;
  void require_images(const torch::Tensor& images) const;
  void require_propagation_tokens(const PropagationStart& start) const;
};

}  // namespace gld
