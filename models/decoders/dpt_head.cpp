#include "models/decoders/dpt_head.h"

#include "gld/base/error.h"
#include "models/layers/initialisation.h"

#include <algorithm>
#include <cmath>
#include <string>

#include <torch/autograd.h>

namespace gld {
namespace {

constexpr int64_t kDepthChannels = 2;  // depth, confidence
constexpr int64_t kRayChannels = 7;    // direction, moment, confidence

using Container = std::shared_ptr<torch::nn::Module>;

Container child(torch::nn::Module& parent, const std::string& name) {
  return parent.register_module(name, std::make_shared<torch::nn::Module>());
}

std::shared_ptr<Convolution> convolution(torch::nn::Module& parent, const std::string& name,
                                         const ConvolutionSizes& sizes, const ParameterPlacement& placement) {
  return parent.register_module(name, std::make_shared<Convolution>(sizes, placement));
}

ConvolutionSizes kernel3(int64_t inputs, int64_t outputs) {
  ConvolutionSizes sizes;
  sizes.in_channels = inputs;
  sizes.out_channels = outputs;
  return sizes;
}

ConvolutionSizes kernel1(int64_t inputs, int64_t outputs) {
  auto sizes = kernel3(inputs, outputs);
  sizes.kernel = 1;
  sizes.padding = 0;
  return sizes;
}

std::vector<std::shared_ptr<FusionBlock>> fusion_stages(torch::nn::Module& parent, const std::string& suffix,
                                                        int64_t channels,
                                                        const ParameterPlacement& placement) {
  std::vector<std::shared_ptr<FusionBlock>> stages;
  for (int stage = 1; stage <= 4; ++stage) {
    FusionBlock::Sizes sizes;
    sizes.channels = channels;
    sizes.inputs = stage == 4 ? FusionInputs::kRunning : FusionInputs::kRunningAndLateral;
    stages.push_back(parent.register_module("refinenet" + std::to_string(stage) + suffix,
                                            std::make_shared<FusionBlock>(sizes, placement)));
  }
  return stages;
}

// Sine and cosine of `positions` (n) at channels / 2 frequencies of base 100: (channels, n).
torch::Tensor sinusoids(const torch::Tensor& positions, int64_t channels) {
  const auto exponents = torch::arange(channels / 2, torch::kFloat32) / (static_cast<double>(channels) / 2);
  const auto frequencies = torch::pow(100.0, exponents).reciprocal();
  const auto angles = frequencies.unsqueeze(1) * positions.unsqueeze(0);
  return torch::cat({angles.sin(), angles.cos()});
}

// Pixel centres of `count` pixels across +-span.
torch::Tensor centres(double span, int64_t count) {
  const double outermost = span * static_cast<double>(count - 1) / static_cast<double>(count);
  return torch::linspace(-outermost, outermost, count, torch::kFloat32);
}

torch::Tensor bounded_exponential(const torch::Tensor& logits) {
  return logits.clamp(-DptHead::kLargestLogit, DptHead::kLargestLogit).exp();
}

}  // namespace

void DptHeadOptions::visit(FieldVisitor& visitor) {
  visitor.integer({"dim_in", "channels of a level"}, dim_in, {1, 1 << 16});
  visitor.integer({"features", "channels of the fused maps, divisible by 8"}, features, {8, 1 << 14});
  visitor.integers({"out_channels", "channels of the four levels' projections, divisible by 4"}, out_channels,
                   {4, 1 << 14});
  visitor.integer({"patch_size", "side of a patch in pixels"}, patch_size, {1, 1024});
  visitor.boolean({"pos_embed", "add the position of each pixel to the maps"}, pos_embed);
  visitor.integer({"down_ratio", "image side over depth map side"}, down_ratio, {1, 64});
  visitor.integer({"aux_pyramid_levels", "pre-heads stored for rays; only the last is used"},
                  aux_pyramid_levels, {1, 4});
  visitor.integer({"aux_out1_conv_num", "convolutions of each pre-head for rays: 1, 3 or 5"},
                  aux_out1_conv_num, {1, 5});
}

void DptHeadOptions::check() const {
  const bool divisible =
      std::all_of(out_channels.begin(), out_channels.end(), [](int64_t c) { return c % 4 == 0; });
  if (out_channels.size() != 4 || !divisible) {
    fail({"out_channels", "four numbers divisible by 4", c10::str(c10::IntArrayRef(out_channels)),
          "give the channels of the four levels' projections"});
  }
  if (features % 8 != 0) {
    fail({"features", "a number divisible by 8", std::to_string(features), "change features"});
  }
  if (aux_out1_conv_num % 2 == 0) {
    fail({"aux_out1_conv_num", "1, 3 or 5", std::to_string(aux_out1_conv_num), "change aux_out1_conv_num"});
  }
}

DptHead::DptHead(const DptHeadOptions& options, const ParameterPlacement& placement) : options_(options) {
  options_.check();
  const auto& channels = options_.out_channels;
  const int64_t features = options_.features;

  norm_ = register_module("norm", std::make_shared<LayerNorm>(options_.dim_in, 1e-5, placement));
  const auto projects = child(*this, "projects");
  for (size_t i = 0; i < 4; ++i) {
    projects_.push_back(
        convolution(*projects, std::to_string(i), kernel1(options_.dim_in, channels[i]), placement));
  }
  const auto resize = child(*this, "resize_layers");
  enlarge4_ = resize->register_module(
      "0", std::make_shared<BlockUpsampling>(BlockUpsampling::Sizes{channels[0], 4}, placement));
  enlarge2_ = resize->register_module(
      "1", std::make_shared<BlockUpsampling>(BlockUpsampling::Sizes{channels[1], 2}, placement));
  auto halving = kernel3(channels[3], channels[3]);
  halving.stride = 2;
  reduce2_ = convolution(*resize, "3", halving, placement);

  const auto scratch = child(*this, "scratch");
  for (size_t i = 0; i < 4; ++i) {
    auto sizes = kernel3(channels[i], features);
    sizes.bias = false;
    lateral_.push_back(convolution(*scratch, "layer" + std::to_string(i + 1) + "_rn", sizes, placement));
  }
  depth_stages_ = fusion_stages(*scratch, "", features, placement);
  ray_stages_ = fusion_stages(*scratch, "_aux", features, placement);

  depth_neck_ = convolution(*scratch, "output_conv1", kernel3(features, features / 2), placement);
  const auto depth_output = child(*scratch, "output_conv2");
  depth_hidden_ = convolution(*depth_output, "0", kernel3(features / 2, kHiddenChannels), placement);
  depth_output_ = convolution(*depth_output, "2", kernel1(kHiddenChannels, kDepthChannels), placement);

  // The checkpoint holds a pre-head for every pyramid level; the last one's is the one that runs.
  const auto necks = child(*scratch, "output_conv1_aux");
  const auto outputs = child(*scratch, "output_conv2_aux");
  for (int64_t level = 0; level < options_.aux_pyramid_levels; ++level) {
    const auto neck = child(*necks, std::to_string(level));
    ray_neck_.clear();
    for (int64_t i = 0; i < options_.aux_out1_conv_num; ++i) {
      const auto sizes = i % 2 == 0 ? kernel3(features, features / 2) : kernel3(features / 2, features);
      ray_neck_.push_back(convolution(*neck, std::to_string(i), sizes, placement));
    }
    const auto output = child(*outputs, std::to_string(level));
    ray_hidden_ = convolution(*output, "0", kernel3(features / 2, kHiddenChannels), placement);
    ray_norm_ = output->register_module("2", std::make_shared<LayerNorm>(kHiddenChannels, 1e-5, placement));
    ray_output_ = convolution(*output, "5", kernel1(kHiddenChannels, kRayChannels), placement);
  }
}

torch::Tensor DptHead::with_positions(const torch::Tensor& maps, const LatentGrid& grid) const {
  if (!options_.pos_embed) return maps;
  // Coordinates span the unit circle with the image's aspect; the first half of the channels encodes the
  // column, the second the row. Each half is constant along one axis, so it is added by broadcasting.
  const double aspect = static_cast<double>(grid.width) / static_cast<double>(grid.height);
  const double diagonal = std::sqrt(aspect * aspect + 1);
  const int64_t half = maps.size(1) / 2;
  const auto place = [&](const torch::Tensor& table) {
    return (table * 0.1).to(maps.device(), maps.scalar_type());
  };
  const auto columns = place(sinusoids(centres(aspect / diagonal, maps.size(3)), half)).unsqueeze(1);
  const auto rows = place(sinusoids(centres(1 / diagonal, maps.size(2)), half)).unsqueeze(2);
  return torch::cat({maps.narrow(1, 0, half) + columns, maps.narrow(1, half, half) + rows}, 1);
}

DptHead::Pyramid DptHead::pyramid(const std::vector<torch::Tensor>& levels, const LatentGrid& grid) const {
  Pyramid result;
  for (size_t i = 0; i < 4; ++i) {
    const auto tokens = norm_->forward(levels[i]);
    const auto maps =
        tokens.transpose(1, 2).reshape({tokens.size(0), options_.dim_in, grid.height, grid.width});
    auto scaled = with_positions(projects_[i]->forward(maps), grid);
    if (i == 0) scaled = enlarge4_->forward(scaled);
    if (i == 1) scaled = enlarge2_->forward(scaled);
    if (i == 3) scaled = reduce2_->forward(scaled);
    result.maps.push_back(lateral_[i]->forward(scaled));
  }
  return result;
}

torch::Tensor DptHead::fuse(const Pyramid& pyramid,
                            const std::vector<std::shared_ptr<FusionBlock>>& stages) const {
  const auto& maps = pyramid.maps;
  const auto size_of = [&](size_t i) { return FusionBlock::MapSize{maps[i].size(2), maps[i].size(3)}; };
  auto running = stages[3]->forward(maps[3], {}, size_of(2));
  running = stages[2]->forward(running, maps[2], size_of(1));
  running = stages[1]->forward(running, maps[1], size_of(0));
  return stages[0]->forward(running, maps[0], {2 * maps[0].size(2), 2 * maps[0].size(3)});
}

torch::Tensor DptHead::depth_logits(const Pyramid& pyramid, const LatentGrid& grid) const {
  const auto fused = depth_neck_->forward(fuse(pyramid, depth_stages_));
  const int64_t height = grid.height * options_.patch_size / options_.down_ratio;
  const int64_t width = grid.width * options_.patch_size / options_.down_ratio;
  const auto maps =
      with_positions(torch::upsample_bilinear2d(fused, {height, width}, /*align_corners=*/true), grid);
  return depth_output_->forward(torch::relu(depth_hidden_->forward(maps)));
}

torch::Tensor DptHead::ray_logits(const Pyramid& pyramid, const LatentGrid& grid) const {
  auto maps = fuse(pyramid, ray_stages_);
  for (const auto& layer : ray_neck_) maps = layer->forward(maps);
  const auto hidden = ray_hidden_->forward(with_positions(maps, grid));
  const auto normed = ray_norm_->forward(hidden.permute({0, 2, 3, 1})).permute({0, 3, 1, 2});
  return ray_output_->forward(torch::relu(normed)).permute({0, 2, 3, 1});
}

GeometryOutput DptHead::forward(const std::vector<torch::Tensor>& levels, const LatentGrid& grid,
                                GeometryMaps maps) const {
  const std::vector<int64_t> expected = {grid.views, grid.tokens_per_view(), options_.dim_in};
  if (levels.size() != 4 || grid.views <= 0 || grid.tokens_per_view() <= 0) {
    fail({"DPT head", "four levels of at least one view", std::to_string(levels.size()) + " levels",
          "give levels 0 to 3"});
  }
  for (const auto& level : levels) {
    if (level.sizes() != expected) {
      fail({"DPT head", "levels of shape " + c10::str(c10::IntArrayRef(expected)), c10::str(level.sizes()),
            "give the decodable patch tokens of every view"});
    }
  }
  const int64_t pixels = grid.tokens_per_view() * options_.patch_size * options_.patch_size;
  const int64_t chunk = std::max<int64_t>(1, kPixelsPerChunk / pixels);
  std::vector<torch::Tensor> depth, depth_confidence, rays, ray_confidence;
  for (int64_t first = 0; first < grid.views; first += chunk) {
    const int64_t count = std::min(chunk, grid.views - first);
    std::vector<torch::Tensor> part;
    part.reserve(levels.size());
    for (const auto& level : levels) part.push_back(level.narrow(0, first, count));
    const auto maps_of_part = pyramid(part, grid);
    if (maps != GeometryMaps::kRays) {
      const auto values = bounded_exponential(depth_logits(maps_of_part, grid));
      depth.push_back(values.select(1, 0));
      depth_confidence.push_back(values.select(1, 1) + 1);
    }
    if (maps != GeometryMaps::kDepth) {
      const auto logits = ray_logits(maps_of_part, grid);
      rays.push_back(logits.narrow(-1, 0, kRayChannels - 1));
      ray_confidence.push_back(bounded_exponential(logits.select(-1, kRayChannels - 1)) + 1);
    }
  }
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

void DptHead::initialise(const torch::Generator& generator) {
  initialise_parameters(*this, MatrixInitialisation::kFanInUniform, generator);
}

}  // namespace gld
