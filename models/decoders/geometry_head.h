#pragma once

#include "gld/base/options.h"
#include "gld/cameras/camera.h"
#include "models/decoders/single_view_unit.h"
#include "models/layers/layers.h"
#include "models/layers/operation_cost.h"

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// Which of its maps the head computes.
enum class GeometryMaps { kDepth, kRays, kDepthAndRays };

// Maps that were not asked for are undefined.
struct GeometryOutput {
  torch::Tensor depth;             // (views, height, width), > 0, in units of the backbone's scene scale
  torch::Tensor depth_confidence;  // (views, height, width), >= 1
  torch::Tensor
      rays;  // (views, 8 grid height, 8 grid width, 6): direction and origin (gld/photogrammetry/view_maps.h)
  torch::Tensor ray_confidence;  // (views, 8 grid height, 8 grid width), >= 1
  // Heads that predict points apart from depth and cameras give these, with depth; they are undefined of others. They
  // are in the frame of the rays.
  torch::Tensor points;            // (views, height, width, 3)
  torch::Tensor point_confidence;  // (views, height, width), >= 1
  // Heads with a decoder for cameras give these, with rays; they are undefined of others. They are (views, 9), each a
  // PoseEncoding (gld/cameras/pose_encoding.h) in the frame and unit of the rays, which it does not come from:
  // decoded_cameras() in camera_decoder.h makes cameras of them.
  torch::Tensor camera_encodings;
  std::optional<SingleView> single_view;  // where one view was seen by a head that guesses its unit
};

struct GeometryInputs {
  // All decodable levels of the views whose maps are wanted: (views, tokens, channels) each, patch tokens only.
  std::vector<torch::Tensor> levels;
  // The last level's leading tokens of all views of the scene, (views, leading tokens, channels) raw, of which the last
  // ones are those of `levels`. Undefined for heads that take none.
  torch::Tensor leading;
};

// Reads depth, rays and what else a backbone's head reads off its levels.
class GeometryHead : public torch::nn::Module {
 public:
  virtual GeometryOutput forward(const GeometryInputs& inputs, const LatentGrid& grid,
                                 GeometryMaps maps) const = 0;
  // Draws random weights to train from.
  virtual void initialise(const torch::Generator& generator) = 0;

  // Returns what forward() gives, with single_view.
  GeometryOutput look(const GeometryInputs& inputs, const LatentGrid& grid, GeometryMaps maps) const;
  // What guesses its unit where it sees one view alone; null for a head without. It is no part of its weights.
  const SingleViewUnit* single_view_unit() const { return single_view_unit_.get(); }
  void guess_unit_by(std::shared_ptr<const SingleViewUnit> unit) { single_view_unit_ = std::move(unit); }

 private:
  std::shared_ptr<const SingleViewUnit> single_view_unit_;
};

// The sizes of a head. Each family has one, in its own file; geometry_head_registry.h lists them.
class GeometryHeadArchitecture : public OptionsGroup {
 public:
  ~GeometryHeadArchitecture() override = default;

  virtual std::string kind() const = 0;
  virtual std::unique_ptr<GeometryHeadArchitecture> copy() const = 0;
  virtual std::shared_ptr<GeometryHead> make(const ParameterPlacement& placement) const = 0;
  // Returns the beginning of the tensors' names in the published file.
  virtual std::string published_prefix() const = 0;
  // Returns the parts of the module that have another beginning in the published file: {there, in the module}.
  virtual std::vector<std::pair<std::string, std::string>> published_elsewhere() const { return {}; }
  virtual int64_t level_channels() const = 0;  // C
  virtual int64_t patch_side() const = 0;      // pixels
  // Returns how many leading tokens the backbone has that it was made for; -1 for any.
  virtual int64_t leading_tokens() const { return -1; }
  // Returns whether it predicts rays, and with them cameras: depth without rays has no place in a scene.
  virtual bool predicts_rays() const { return true; }
  // Returns whether depth comes with GeometryOutput::points.
  virtual bool predicts_points() const { return false; }
  // Returns whether GeometryOutput::camera_encodings come with rays.
  virtual bool decodes_cameras() const { return false; }
  virtual Cost cost(const LatentGrid& grid, GeometryMaps maps) const = 0;
};

}  // namespace gld
