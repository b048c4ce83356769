#include "models/decoders/camera_decoder.h"
#include "models/decoders/dpt_head.h"
#include "models/decoders/vggt_heads.h"
#include "models/weights/weight_loading.h"
#include "verify/reference_runners.h"

#include <string>
#include <vector>

namespace gld {
namespace {

// The module's configuration and the size of the case's images.
struct DptHeadCaseOptions : DptHeadOptions {
  int64_t height = 504;
  int64_t width = 504;

  void visit(FieldVisitor& visitor) override {
    DptHeadOptions::visit(visitor);
    visitor.integer({"height", "image height in pixels"}, height, {1, 1 << 16});
    visitor.integer({"width", "image width in pixels"}, width, {1, 1 << 16});
  }
};

// One of VGGT's DPT heads, for tokens with leading ones in front.
struct VggtDptCaseOptions : OptionsGroup {
  DptSizes sizes;
  VggtDptOutput output = VggtDptOutput::kDepth;
  int64_t num_special_tokens = 5;
  int64_t height = 504;
  int64_t width = 504;

  void visit(FieldVisitor& visitor) override {
    int vggt = 0;
    visitor.choice({"type", "family of the head"}, vggt, {"vggt"});
    sizes.visit(visitor);
    visit_choice(visitor, {"output", "what it predicts"}, output, {"depth", "points"});
    visitor.integer({"num_special_tokens", "tokens in front of the patches"}, num_special_tokens, {0, 1024});
    visitor.integer({"height", "image height in pixels"}, height, {1, 1 << 16});
    visitor.integer({"width", "image width in pixels"}, width, {1, 1 << 16});
  }
  void check() const override { sizes.check(); }
};

NamedTensors run_vggt_dpt_case(const ReferenceCase& reference) {
  VggtDptCaseOptions options;
  reference.read_config(options);
  const bool depth = options.output == VggtDptOutput::kDepth;
  VggtDptHead head(options.sizes, options.output, reference.placement());
  WeightSelection selection;
  selection.prefix = depth ? "depth_head." : "point_head.";
  load_strict(head, reference.weight_file(), selection);

  LatentGrid grid;
  grid.height = options.height / options.sizes.patch_size;
  grid.width = options.width / options.sizes.patch_size;
  const int64_t tokens = options.num_special_tokens + grid.tokens_per_view();
  std::vector<torch::Tensor> levels;
  levels.reserve(4);
  for (int level = 0; level < 4; ++level) {
    levels.push_back(
        reference.module_input("level" + std::to_string(level), {-1, tokens, options.sizes.dim_in})
            .slice(1, options.num_special_tokens));
  }
  grid.views = levels[0].size(0);
  const auto maps = head.forward(levels, grid);
  if (depth) return {{"depth", maps.values.unsqueeze(-1)}, {"depth_conf", maps.confidence}};
  return {{"points", maps.values}, {"points_conf", maps.confidence}};
}

struct CameraHeadCaseOptions : OptionsGroup {
  VggtCameraSizes sizes;
  int64_t height = 0;
  int64_t width = 0;

  void visit(FieldVisitor& visitor) override {
    visitor.integer({"dim_in", "channels of the last level"}, sizes.dim_in, {1, 1 << 16});
    visitor.integer({"trunk_depth", "blocks over the views"}, sizes.trunk_depth, {1, 1024});
    visitor.integer({"num_heads", "attention heads"}, sizes.num_heads, {1, 1024});
    visitor.real({"mlp_ratio", "width of the feed-forward part over dim_in"}, sizes.mlp_ratio, {0.01, 64});
    visitor.integer({"iterations", "times that poses are refined"}, sizes.iterations, {1, 64});
    visitor.integer({"height", "image height in pixels"}, height, {1, 1 << 16});
    visitor.integer({"width", "image width in pixels"}, width, {1, 1 << 16});
  }
};

struct CameraDecoderCaseOptions : OptionsGroup {
  int64_t dim_in = 1536;
  int64_t height = 504;
  int64_t width = 504;

  void visit(FieldVisitor& visitor) override {
    visitor.integer({"dim_in", "channels of the last level"}, dim_in, {1, 1 << 16});
    visitor.integer({"height", "image height in pixels"}, height, {1, 1 << 16});
    visitor.integer({"width", "image width in pixels"}, width, {1, 1 << 16});
  }
};

}  // namespace

NamedTensors run_camera_decoder_case(const ReferenceCase& reference) {
  CameraDecoderCaseOptions options;
  reference.read_config(options);
  CameraDecoder decoder(options.dim_in, reference.placement());
  WeightSelection selection;
  selection.prefix = "model.cam_dec.";
  load_strict(decoder, reference.weight_file(), selection);
  const auto encodings = decoder.forward(reference.module_input("camera_tokens", {-1, options.dim_in}));
  std::vector<torch::Tensor> poses, intrinsics;
  for (const Camera& camera : decoded_cameras(encodings, {options.width, options.height})) {
    const Eigen::Matrix<double, 3, 4, Eigen::RowMajor> pose =
        camera.camera_from_world().matrix().topRows<3>();
    const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> pixels = camera.intrinsics;
    poses.push_back(torch::tensor(std::vector<double>(pose.data(), pose.data() + pose.size())).view({3, 4}));
    intrinsics.push_back(
        torch::tensor(std::vector<double>(pixels.data(), pixels.data() + pixels.size())).view({3, 3}));
  }
  return {{"pose_encoding", encodings},
          {"camera_from_world", torch::stack(poses)},
          {"intrinsics", torch::stack(intrinsics)}};
}

NamedTensors run_camera_head_case(const ReferenceCase& reference) {
  CameraHeadCaseOptions options;
  reference.read_config(options);
  VggtCameraHead head(options.sizes, reference.placement());
  WeightSelection selection;
  selection.prefix = "camera_head.";
  load_strict(head, reference.weight_file(), selection);
  const auto tokens = reference.module_input("level3", {-1, -1, options.sizes.dim_in});
  const auto cameras = head.forward(tokens.select(1, 0));
  return {{"pose_encoding", cameras.encoding},
          {"camera_from_world", cameras.camera_from_world()},
          {"intrinsics", cameras.intrinsics(options.height, options.width)}};
}

NamedTensors run_dpt_head_case(const ReferenceCase& reference) {
  if (reference.config.value("type", "da3") == "vggt") return run_vggt_dpt_case(reference);
  DptHeadCaseOptions options;
  reference.read_config(options);
  DptHead head(options, reference.placement());
  WeightSelection selection;
  selection.prefix = DptHead::kPrefix;
  load_strict(head, reference.weight_file(), selection);

  LatentGrid grid;
  grid.height = options.height / options.patch_size;
  grid.width = options.width / options.patch_size;
  std::vector<torch::Tensor> levels;
  levels.reserve(4);
  for (int level = 0; level < 4; ++level) {
    levels.push_back(reference.module_input("level" + std::to_string(level),
                                            {-1, grid.tokens_per_view(), options.dim_in}));
  }
  grid.views = levels[0].size(0);
  const auto maps = head.forward(levels, grid, GeometryMaps::kDepthAndRays);
  return {{"depth", maps.depth},
          {"depth_conf", maps.depth_confidence},
          {"ray", maps.rays},
          {"ray_conf", maps.ray_confidence}};
}

}  // namespace gld
