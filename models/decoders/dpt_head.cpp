#include "models/decoders/dpt_head.h"

#include "gld/base/error.h"
#include "models/layers/initialisation.h"

#include <torch/autograd.h>

namespace gld {
namespace {

constexpr int64_t kDepthChannels = 2;  // depth, confidence
constexpr int64_t kRayChannels = 7;    // direction, origin, confidence

}  // namespace

DptHeadOptions::DptHeadOptions() {
  dim_in = 1536;
  features = 128;
  out_channels = {96, 192, 384, 768};
}

void DptHeadOptions::visit(FieldVisitor& visitor) {
  DptSizes::visit(visitor);
  visitor.integer({"aux_pyramid_levels", "pre-heads stored for rays; only the last is used"},
                  aux_pyramid_levels, {1, 4});
  visitor.integer({"aux_out1_conv_num", "convolutions of each pre-head for rays: 1, 3 or 5"},
                  aux_out1_conv_num, {1, 5});
  visitor.boolean({"camera_decoder", "the model has a decoder for cameras beside its rays"}, camera_decoder);
}

void DptHeadOptions::check() const {
  DptSizes::check();
  if (aux_out1_conv_num % 2 == 0) {
    fail({"aux_out1_conv_num", "1, 3 or 5", std::to_string(aux_out1_conv_num), "change aux_out1_conv_num"});
  }
}

std::unique_ptr<GeometryHeadArchitecture> DptHeadOptions::copy() const {
  return std::make_unique<DptHeadOptions>(*this);
}

std::shared_ptr<GeometryHead> DptHeadOptions::make(const ParameterPlacement& placement) const {
  return std::make_shared<DptHead>(*this, placement);
}

std::string DptHeadOptions::published_prefix() const { return DptHead::kPrefix; }

Cost DptHeadOptions::cost(const LatentGrid& grid, GeometryMaps maps) const {
  const auto tokens = static_cast<double>(grid.views * grid.tokens_per_view());
  const auto channels = static_cast<double>(features);
  Cost cost;
  add_dpt_pyramid(cost, *this, grid, maps == GeometryMaps::kDepthAndRays ? 2 : 1);
  if (maps != GeometryMaps::kRays) add_dpt_output(cost, *this, grid);
  if (maps != GeometryMaps::kDepth) {
    add_convolution(cost, tokens * 64, channels, channels * static_cast<double>(aux_out1_conv_num) / 2, 3);
    add_convolution(cost, tokens * 64, channels / 2, DptTrunk::kHiddenChannels, 3);
  }
  if (maps != GeometryMaps::kDepth && camera_decoder) {
    const auto width = static_cast<double>(dim_in);
    cost.linear_flop += product_flop(static_cast<double>(grid.views), width, 2 * width + 9);
  }
  DptMapChannels outputs;
  outputs.full_size = maps != GeometryMaps::kRays ? kDepthChannels : 0;
  outputs.rays = maps != GeometryMaps::kDepth ? kRayChannels : 0;
  cost.working_bytes = dpt_working_bytes(*this, grid, outputs);
  return cost;
}

DptHead::DptHead(const DptHeadOptions& options, const ParameterPlacement& placement)
    : options_((options.check(), options)), trunk_(*this, options_, placement) {
  const int64_t features = options_.features;
  torch::nn::Module& scratch = *trunk_.scratch();
  depth_stages_ = trunk_.fusion_stages("", FusionResidual::kRaw, placement);
  ray_stages_ = trunk_.fusion_stages("_aux", FusionResidual::kRaw, placement);

  depth_neck_ =
      child_convolution(scratch, "output_conv1", same_size_convolution(features, features / 2, 3), placement);
  const auto depth_output = child_module(scratch, "output_conv2");
  depth_hidden_ = child_convolution(
      *depth_output, "0", same_size_convolution(features / 2, DptTrunk::kHiddenChannels, 3), placement);
  depth_output_ = child_convolution(
      *depth_output, "2", same_size_convolution(DptTrunk::kHiddenChannels, kDepthChannels, 1), placement);

  // The checkpoint holds a pre-head for every pyramid level; the last one's is the one that runs.
  const auto necks = child_module(scratch, "output_conv1_aux");
  const auto outputs = child_module(scratch, "output_conv2_aux");
  for (int64_t level = 0; level < options_.aux_pyramid_levels; ++level) {
    const auto neck = child_module(*necks, std::to_string(level));
    ray_neck_.clear();
    for (int64_t i = 0; i < options_.aux_out1_conv_num; ++i) {
      const auto sizes = i % 2 == 0 ? same_size_convolution(features, features / 2, 3)
                                    : same_size_convolution(features / 2, features, 3);
      ray_neck_.push_back(child_convolution(*neck, std::to_string(i), sizes, placement));
    }
    const auto output = child_module(*outputs, std::to_string(level));
    ray_hidden_ = child_convolution(
        *output, "0", same_size_convolution(features / 2, DptTrunk::kHiddenChannels, 3), placement);
    ray_norm_ =
        output->register_module("2", std::make_shared<LayerNorm>(DptTrunk::kHiddenChannels, 1e-5, placement));
    ray_output_ = child_convolution(
        *output, "5", same_size_convolution(DptTrunk::kHiddenChannels, kRayChannels, 1), placement);
  }
  if (options_.camera_decoder) {
    camera_decoder_ = register_module("cam_dec", std::make_shared<CameraDecoder>(options_.dim_in, placement));
  }
}

torch::Tensor DptHead::depth_logits(const DptTrunk::Pyramid& pyramid, const LatentGrid& grid) const {
  const auto fused = depth_neck_->forward(DptTrunk::fuse(pyramid, depth_stages_));
  return depth_output_->forward(torch::relu(depth_hidden_->forward(trunk_.enlarged(fused, grid))));
}

torch::Tensor DptHead::ray_logits(const DptTrunk::Pyramid& pyramid, const LatentGrid& grid) const {
  auto maps = DptTrunk::fuse(pyramid, ray_stages_);
  for (const auto& layer : ray_neck_) maps = layer->forward(maps);
  const auto hidden = ray_hidden_->forward(trunk_.with_positions(maps, grid));
  const auto normed = ray_norm_->forward(hidden.permute({0, 2, 3, 1})).permute({0, 3, 1, 2});
  return ray_output_->forward(torch::relu(normed)).permute({0, 2, 3, 1});
}

GeometryOutput DptHead::forward(const std::vector<torch::Tensor>& levels, const LatentGrid& grid,
                                GeometryMaps maps) const {
  trunk_.check_levels(levels, grid);
  std::vector<torch::Tensor> depth, depth_confidence, rays, ray_confidence;
  trunk_.for_each_chunk(levels, grid, [&](const DptTrunk::Pyramid& pyramid) {
    if (maps != GeometryMaps::kRays) {
      const auto values = bounded_exponential(depth_logits(pyramid, grid));
      depth.push_back(values.select(1, 0));
      depth_confidence.push_back(values.select(1, 1) + 1);
    }
    if (maps != GeometryMaps::kDepth) {
      const auto logits = ray_logits(pyramid, grid);
      rays.push_back(logits.narrow(-1, 0, kRayChannels - 1));
      ray_confidence.push_back(bounded_exponential(logits.select(-1, kRayChannels - 1)) + 1);
    }
  });
  GeometryOutput output;
  if (maps != GeometryMaps::kRays) {
    output.depth = torch::cat(depth);
    output.depth_confidence = torch::cat(depth_confidence);
  }
  if (maps != GeometryMaps::kDepth) {
    output.rays = torch::cat(rays).contiguous();
    output.ray_confidence = torch::cat(ray_confidence);
  }
  return output;
}

GeometryOutput DptHead::forward(const GeometryInputs& inputs, const LatentGrid& grid,
                                GeometryMaps maps) const {
  GeometryOutput output = forward(inputs.levels, grid, maps);
  if (!camera_decoder_ || maps == GeometryMaps::kDepth) return output;
  if (!inputs.leading.defined() || inputs.leading.size(0) < grid.views) {
    fail({"camera decoder", "the last level's leading tokens of all views", "none of some views",
          "propagate the levels with their leading tokens"});
  }
  // Each view's camera comes from its own token, so that the tokens of views without maps are not needed.
  const auto tokens = inputs.leading.select(1, 0).slice(0, inputs.leading.size(0) - grid.views);
  output.camera_encodings = camera_decoder_->forward(tokens);
  return output;
}

void DptHead::initialise(const torch::Generator& generator) {
  initialise_parameters(*this, MatrixInitialisation::kFanInUniform, generator);
  if (camera_decoder_) camera_decoder_->initialise_output();
}

}  // namespace gld
