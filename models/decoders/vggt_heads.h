#pragma once

#include "models/decoders/dpt_trunk.h"
#include "models/decoders/geometry_head.h"
#include "models/layers/vit_block.h"

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// What a DPT head of VGGT predicts for each pixel, a confidence beside it: a depth, exp of its logit, or a point, of
// which each coordinate is sign(y) (exp|y| - 1).
enum class VggtDptOutput { kDepth, kPoints };

// A DPT head of VGGT: DA3's depth half, except that the fusion's residuals are added to rectified maps, because the
// published activations work in place (vggt/heads/dpt_head.py).
class VggtDptHead : public torch::nn::Module {
 public:
  VggtDptHead(const DptSizes& sizes, VggtDptOutput output, const ParameterPlacement& placement);

  struct Maps {
    torch::Tensor values;      // (views, height, width) depth, or (views, height, width, 3) points
    torch::Tensor confidence;  // (views, height, width), >= 1
  };
  // levels are four, raw, (views, tokens, dim_in), patch tokens only.
  Maps forward(const std::vector<torch::Tensor>& levels, const LatentGrid& grid) const;

 private:
  VggtDptOutput output_;
  DptTrunk trunk_;
  std::vector<std::shared_ptr<FusionBlock>> stages_;
  std::shared_ptr<Convolution> neck_, hidden_, last_;
};

struct VggtCameraSizes {
  int64_t dim_in = 2048;
  int64_t trunk_depth = 4;  // blocks over the views
  int64_t num_heads = 16;
  double mlp_ratio = 4;
  int64_t iterations = 4;
};

// Cameras as VGGT encodes them. The world is the first view's camera.
struct VggtCameras {
  // (views, 9): translation and quaternion (x, y, z, w) of camera_from_world, vertical and horizontal field of view.
  torch::Tensor encoding;

  torch::Tensor camera_from_world() const;  // (views, 3, 4)
  // Returns (views, 3, 3) in pixels of images of that size, the principal point in the middle.
  torch::Tensor intrinsics(int64_t height, int64_t width) const;
  // Returns (views, rows, columns, 6): direction K^-1 [u, v, 1] turned to the world, and the camera's centre, of rays
  // through the middles of the cells that cover the image evenly. They are finite for any finite encoding: fields of
  // view are kept below pi.
  torch::Tensor rays(int64_t rows, int64_t columns) const;
};

// VGGT's camera head: the camera tokens of all views of a scene attend to each other, and a pose is refined a few times
// (vggt/heads/camera_head.py).
class VggtCameraHead : public torch::nn::Module {
 public:
  VggtCameraHead(const VggtCameraSizes& sizes, const ParameterPlacement& placement);

  // camera_tokens are (views, dim_in) of the last level, raw, of all views of the scene.
  VggtCameras forward(const torch::Tensor& camera_tokens) const;
  void initialise(const torch::Generator& generator);

 private:
  VggtCameraSizes sizes_;
  std::vector<std::shared_ptr<VitBlock>> trunk_;
  std::shared_ptr<LayerNorm> token_norm_, trunk_norm_;
  std::shared_ptr<Linear> embedding_, modulation_, hidden_, delta_;
  torch::Tensor empty_pose_;  // (1, 1, 9)
};

// Defaults are VGGT-1B's heads; the head of point tracks is no part of GLD.
struct VggtHeadsOptions : GeometryHeadArchitecture, DptSizes {
  int64_t num_special_tokens = 5;  // of a view: camera and registers
  bool point_head = true;          // whether the bundle has it
  bool camera_head = true;
  VggtCameraSizes camera;

  VggtHeadsOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;

  std::string kind() const override { return "vggt"; }
  std::unique_ptr<GeometryHeadArchitecture> copy() const override;
  std::shared_ptr<GeometryHead> make(const ParameterPlacement& placement) const override;
  std::string published_prefix() const override { return ""; }
  int64_t level_channels() const override { return dim_in; }
  int64_t patch_side() const override { return patch_size; }
  int64_t leading_tokens() const override { return num_special_tokens; }
  bool predicts_rays() const override { return camera_head; }
  bool predicts_points() const override { return point_head; }
  Cost cost(const LatentGrid& grid, GeometryMaps maps) const override;
};

// VGGT's depth, point and camera heads. Rays are those of the camera head's cameras, equally sure (2) everywhere, so
// that whatever takes DA3's rays takes these.
class VggtHeads : public GeometryHead {
 public:
  static constexpr double kRayConfidence = 2;

  VggtHeads(const VggtHeadsOptions& options, const ParameterPlacement& placement);

  GeometryOutput forward(const GeometryInputs& inputs, const LatentGrid& grid,
                         GeometryMaps maps) const override;
  void initialise(const torch::Generator& generator) override;

 private:
  VggtHeadsOptions options_;
  std::shared_ptr<VggtDptHead> depth_head_, point_head_;  // null where the model has none
  std::shared_ptr<VggtCameraHead> camera_head_;
};

}  // namespace gld
