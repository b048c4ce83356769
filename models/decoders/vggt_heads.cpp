#include "models/decoders/vggt_heads.h"

#include "gld/base/error.h"
#include "models/layers/initialisation.h"

#include <torch/autograd.h>

namespace gld {
namespace {

constexpr int64_t kPoseValues = 9;
// Below pi, where the tangent of half of it ends.
constexpr double kLargestFieldOfView = 3.1;
// Ray maps have as many cells as DA3's.
constexpr int64_t kRaysASide = 8;

int64_t value_channels(VggtDptOutput output) { return output == VggtDptOutput::kDepth ? 1 : 3; }

// Returns the rotations of quaternions (x, y, z, w) of any length, (views, 4) -> (views, 3, 3).
torch::Tensor rotations(const torch::Tensor& quaternions) {
  const auto q = quaternions.unbind(-1);
  const auto &x = q[0], &y = q[1], &z = q[2], &w = q[3];
  const auto s = 2 / (quaternions * quaternions).sum(-1).clamp_min(1e-20);
  return torch::stack({1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w), s * (x * y + z * w),
                       1 - s * (x * x + z * z), s * (y * z - x * w), s * (x * z - y * w), s * (y * z + x * w),
                       1 - s * (x * x + y * y)},
                      -1)
      .view({-1, 3, 3});
}

// Returns the middles of the cells, from -1 to 1 across the image.
torch::Tensor cell_middles(int64_t count, const torch::TensorOptions& options) {
  return (torch::arange(count, options) + 0.5) * (2.0 / static_cast<double>(count)) - 1;
}

}  // namespace

VggtDptHead::VggtDptHead(const DptSizes& sizes, VggtDptOutput output, const ParameterPlacement& placement)
    : output_(output), trunk_(*this, sizes, placement) {
  torch::nn::Module& scratch = *trunk_.scratch();
  stages_ = trunk_.fusion_stages("", FusionResidual::kRectified, placement);
  neck_ = child_convolution(scratch, "output_conv1",
                            same_size_convolution(sizes.features, sizes.features / 2, 3), placement);
  const auto outputs = child_module(scratch, "output_conv2");
  hidden_ = child_convolution(
      *outputs, "0", same_size_convolution(sizes.features / 2, DptTrunk::kHiddenChannels, 3), placement);
  last_ = child_convolution(*outputs, "2",
                            same_size_convolution(DptTrunk::kHiddenChannels, value_channels(output) + 1, 1),
                            placement);
}

VggtDptHead::Maps VggtDptHead::forward(const std::vector<torch::Tensor>& levels,
                                       const LatentGrid& grid) const {
  trunk_.check_levels(levels, grid);
  std::vector<torch::Tensor> values, confidences;
  trunk_.for_each_chunk(levels, grid, [&](const DptTrunk::Pyramid& pyramid) {
    const auto fused = neck_->forward(DptTrunk::fuse(pyramid, stages_));
    const auto logits = last_->forward(torch::relu(hidden_->forward(trunk_.enlarged(fused, grid))));
    const int64_t channels = value_channels(output_);
    if (output_ == VggtDptOutput::kDepth) {
      values.push_back(bounded_exponential(logits.select(1, 0)));
    } else {
      const auto bounded = logits.narrow(1, 0, channels)
                               .permute({0, 2, 3, 1})
                               .clamp(-DptTrunk::kLargestLogit, DptTrunk::kLargestLogit);
      values.push_back(bounded.sign() * bounded.abs().expm1());
    }
    confidences.push_back(bounded_exponential(logits.select(1, channels)) + 1);
  });
  return {torch::cat(values).contiguous(), torch::cat(confidences)};
}

torch::Tensor VggtCameras::camera_from_world() const {
  return torch::cat({rotations(encoding.narrow(-1, 3, 4)), encoding.narrow(-1, 0, 3).unsqueeze(-1)}, -1);
}

torch::Tensor VggtCameras::intrinsics(int64_t height, int64_t width) const {
  const auto h = static_cast<double>(height), w = static_cast<double>(width);
  const auto vertical = encoding.select(-1, 7), horizontal = encoding.select(-1, 8);
  auto result = torch::zeros({encoding.size(0), 3, 3}, encoding.options().requires_grad(false));
  result.select(1, 0).select(1, 0).copy_(w / 2 / torch::tan(horizontal / 2));
  result.select(1, 1).select(1, 1).copy_(h / 2 / torch::tan(vertical / 2));
  result.select(1, 0).select(1, 2).fill_(w / 2);
  result.select(1, 1).select(1, 2).fill_(h / 2);
  result.select(1, 2).select(1, 2).fill_(1);
  return result;
}

torch::Tensor VggtCameras::rays(int64_t rows, int64_t columns) const {
  const int64_t views = encoding.size(0);
  const auto plain = encoding.options().requires_grad(false);
  const auto half = torch::tan(encoding.narrow(-1, 7, 2).clamp(0, kLargestFieldOfView) / 2);
  const auto x = half.select(-1, 1).view({views, 1, 1}) * cell_middles(columns, plain).view({1, 1, columns});
  const auto y = half.select(-1, 0).view({views, 1, 1}) * cell_middles(rows, plain).view({1, rows, 1});
  const std::vector<int64_t> shape = {views, rows, columns};
  const auto in_camera = torch::stack({x.expand(shape), y.expand(shape), torch::ones(shape, plain)}, -1);
  const auto world_from_camera = rotations(encoding.narrow(-1, 3, 4)).transpose(1, 2);
  const auto directions =
      torch::matmul(in_camera.view({views, rows * columns, 3}), world_from_camera.transpose(1, 2))
          .view({views, rows, columns, 3});
  const auto centres = -torch::matmul(world_from_camera, encoding.narrow(-1, 0, 3).unsqueeze(-1));
  return torch::cat({directions, centres.view({views, 1, 1, 3}).expand({views, rows, columns, 3})}, -1);
}

VggtCameraHead::VggtCameraHead(const VggtCameraSizes& sizes, const ParameterPlacement& placement)
    : sizes_(sizes) {
  const int64_t channels = sizes_.dim_in;
  const auto linear = [&](torch::nn::Module& parent, const char* name, int64_t inputs, int64_t outputs) {
    return parent.register_module(name, std::make_shared<Linear>(LinearSizes{inputs, outputs}, placement));
  };
  auto trunk = child_module(*this, "trunk");
  VitBlockSizes block;
  block.embed_dim = channels;
  block.num_heads = sizes_.num_heads;
  block.hidden_dim = static_cast<int64_t>(static_cast<double>(channels) * sizes_.mlp_ratio);
  block.norm_epsilon = 1e-5;
  for (int64_t i = 0; i < sizes_.trunk_depth; ++i) {
    trunk_.push_back(trunk->register_module(std::to_string(i), std::make_shared<VitBlock>(block, placement)));
  }
  token_norm_ = register_module("token_norm", std::make_shared<LayerNorm>(channels, 1e-5, placement));
  trunk_norm_ = register_module("trunk_norm", std::make_shared<LayerNorm>(channels, 1e-5, placement));
  empty_pose_ =
      register_parameter("empty_pose_tokens", torch::empty({1, 1, kPoseValues}, placement.options()));
  embedding_ = linear(*this, "embed_pose", kPoseValues, channels);
  modulation_ = linear(*child_module(*this, "poseLN_modulation"), "1", channels, 3 * channels);
  const auto branch = child_module(*this, "pose_branch");
  hidden_ = linear(*branch, "fc1", channels, channels / 2);
  delta_ = linear(*branch, "fc2", channels / 2, kPoseValues);
}

VggtCameras VggtCameraHead::forward(const torch::Tensor& camera_tokens) const {
  if (camera_tokens.dim() != 2 || camera_tokens.size(0) == 0 || camera_tokens.size(1) != sizes_.dim_in) {
    fail({"camera head", "camera tokens (views, " + std::to_string(sizes_.dim_in) + ")",
          "a tensor of shape " + c10::str(camera_tokens.sizes()), "give those of the last level"});
  }
  const int64_t views = camera_tokens.size(0);
  const auto tokens = token_norm_->forward(camera_tokens).unsqueeze(0);
  const auto plain = torch::layer_norm(tokens, {sizes_.dim_in}, {}, {}, 1e-6);
  torch::Tensor pose;
  for (int64_t i = 0; i < sizes_.iterations; ++i) {
    // What a pose is refined from is held fixed: each refinement learns by itself.
    const auto before = pose.defined() ? pose.detach() : empty_pose_.expand({1, views, kPoseValues});
    const auto parts = modulation_->forward(torch::silu(embedding_->forward(before))).chunk(3, -1);
    auto x = tokens + parts[2] * (plain * (1 + parts[1]) + parts[0]);
    for (const auto& block : trunk_) x = block->forward(x, AttentionScope::kLocal, {});
    const auto delta = delta_->forward(torch::gelu(hidden_->forward(trunk_norm_->forward(x))));
    pose = pose.defined() ? before + delta : delta;
  }
  const auto encoding = pose.squeeze(0);
  return {torch::cat({encoding.narrow(-1, 0, 7), torch::relu(encoding.narrow(-1, 7, 2))}, -1)};
}

void VggtCameraHead::initialise(const torch::Generator& generator) {
  initialise_parameters(*this, MatrixInitialisation::kTruncatedNormal, generator);
  // The refinements together start at no rotation and at fields of view of a radian: a rectified field of view that
  // starts below 0 would never learn.
  const torch::NoGradGuard no_grad;
  const double share = 1 / static_cast<double>(sizes_.iterations);
  delta_->bias.slice(0, 6, 7).fill_(share);
  delta_->bias.slice(0, 7, 9).fill_(share);
}

VggtHeadsOptions::VggtHeadsOptions() {
  dim_in = 2048;
  features = 256;
  out_channels = {256, 512, 1024, 1024};
}

void VggtHeadsOptions::visit(FieldVisitor& visitor) {
  DptSizes::visit(visitor);
  visitor.integer({"num_special_tokens", "camera and register tokens of a view"}, num_special_tokens,
                  {1, 1024});
  visitor.boolean({"point_head", "the model has a head for point maps"}, point_head);
  visitor.boolean({"camera_head", "the model has a head for cameras, which rays and clouds need"},
                  camera_head);
  visitor.integer({"camera_trunk_depth", "blocks of the camera head"}, camera.trunk_depth, {1, 1024});
  visitor.integer({"camera_num_heads", "attention heads of the camera head"}, camera.num_heads, {1, 1024});
  visitor.integer({"camera_iterations", "times that the camera head refines a pose"}, camera.iterations,
                  {1, 64});
}

void VggtHeadsOptions::check() const {
  DptSizes::check();
  if (camera_head && dim_in % camera.num_heads != 0) {
    fail({"camera_num_heads", "a divisor of dim_in " + std::to_string(dim_in),
          std::to_string(camera.num_heads), "change camera_num_heads"});
  }
}

std::unique_ptr<GeometryHeadArchitecture> VggtHeadsOptions::copy() const {
  return std::make_unique<VggtHeadsOptions>(*this);
}

std::shared_ptr<GeometryHead> VggtHeadsOptions::make(const ParameterPlacement& placement) const {
  return std::make_shared<VggtHeads>(*this, placement);
}

Cost VggtHeadsOptions::cost(const LatentGrid& grid, GeometryMaps maps) const {
  Cost cost;
  DptMapChannels outputs;
  const auto add_head = [&](VggtDptOutput output) {
    add_dpt_pyramid(cost, *this, grid, 1);
    add_dpt_output(cost, *this, grid);
    outputs.full_size += static_cast<double>(value_channels(output) + 1);
  };
  if (maps != GeometryMaps::kRays) add_head(VggtDptOutput::kDepth);
  if (maps == GeometryMaps::kDepthAndRays && point_head) add_head(VggtDptOutput::kPoints);
  if (maps != GeometryMaps::kDepth && camera_head) {
    const auto width = static_cast<double>(dim_in);
    const auto rows = static_cast<double>(grid.views);
    for (int64_t i = 0; i < camera.iterations; ++i) {
      cost.linear_flop += product_flop(rows, width, (3 + 0.5) * width);
      for (int64_t block = 0; block < camera.trunk_depth; ++block) {
        cost.linear_flop += product_flop(rows, width, (4 + 2 * camera.mlp_ratio) * width);
        cost.attention_flop += attention_flop(rows, rows, width);
      }
    }
    outputs.rays = 7;
  }
  cost.working_bytes = dpt_working_bytes(*this, grid, outputs);
  return cost;
}

VggtHeads::VggtHeads(const VggtHeadsOptions& options, const ParameterPlacement& placement)
    : options_((options.check(), options)) {
  depth_head_ = register_module("depth_head",
                                std::make_shared<VggtDptHead>(options_, VggtDptOutput::kDepth, placement));
  if (options_.point_head) {
    point_head_ = register_module("point_head",
                                  std::make_shared<VggtDptHead>(options_, VggtDptOutput::kPoints, placement));
  }
  if (options_.camera_head) {
    VggtCameraSizes sizes = options_.camera;
    sizes.dim_in = options_.dim_in;
    camera_head_ = register_module("camera_head", std::make_shared<VggtCameraHead>(sizes, placement));
  }
}

GeometryOutput VggtHeads::forward(const GeometryInputs& inputs, const LatentGrid& grid,
                                  GeometryMaps maps) const {
  GeometryOutput output;
  if (maps != GeometryMaps::kRays) {
    const auto depth = depth_head_->forward(inputs.levels, grid);
    output.depth = depth.values;
    output.depth_confidence = depth.confidence;
  }
  if (maps == GeometryMaps::kDepthAndRays && point_head_) {
    const auto points = point_head_->forward(inputs.levels, grid);
    output.points = points.values;
    output.point_confidence = points.confidence;
  }
  if (maps == GeometryMaps::kDepth) return output;
  if (!camera_head_) {
    fail({"rays", "a model with a camera head", "a VGGT model without one",
          "ask for images and depth alone, or convert a file that has the tensors camera_head.*"});
  }
  if (!inputs.leading.defined() || inputs.leading.size(0) < grid.views) {
    fail({"camera head", "the last level's leading tokens of all views", "none of some views",
          "propagate the levels with their leading tokens"});
  }
  const auto cameras = camera_head_->forward(inputs.leading.select(1, 0));
  const int64_t rows = kRaysASide * grid.height, columns = kRaysASide * grid.width;
  output.rays = cameras.rays(rows, columns).slice(0, inputs.leading.size(0) - grid.views).contiguous();
  output.ray_confidence =
      torch::full({grid.views, rows, columns}, kRayConfidence, output.rays.options().requires_grad(false));
  return output;
}

void VggtHeads::initialise(const torch::Generator& generator) {
  initialise_parameters(*this, MatrixInitialisation::kFanInUniform, generator);
  if (camera_head_) camera_head_->initialise(generator);
}

}  // namespace gld
