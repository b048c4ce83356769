#include "models/decoders/dpt_trunk.h"

#include "gld/base/error.h"

#include <algorithm>
#include <cmath>

namespace gld {
namespace {

// Returns sine and cosine of `positions` (n) at channels / 2 frequencies of base 100: (channels, n).
torch::Tensor sinusoids(const torch::Tensor& positions, int64_t channels) {
  const auto exponents = torch::arange(channels / 2, torch::kFloat32) / (static_cast<double>(channels) / 2);
  const auto frequencies = torch::pow(100.0, exponents).reciprocal();
  const auto angles = frequencies.unsqueeze(1) * positions.unsqueeze(0);
  return torch::cat({angles.sin(), angles.cos()});
}

// Returns the pixel centres of `count` pixels across +-span.
torch::Tensor centres(double span, int64_t count) {
  const double outermost = span * static_cast<double>(count - 1) / static_cast<double>(count);
  return torch::linspace(-outermost, outermost, count, torch::kFloat32);
}

// Pixels of the four pyramid levels, in tokens: 4x4, 2x2, 1 and 1/4 of the token grid.
constexpr double kPyramidScales[] = {16, 4, 1, 0.25};

}  // namespace

std::shared_ptr<Convolution> child_convolution(torch::nn::Module& parent, const std::string& name,
                                               const ConvolutionSizes& sizes,
                                               const ParameterPlacement& placement) {
  return parent.register_module(name, std::make_shared<Convolution>(sizes, placement));
}

torch::Tensor bounded_exponential(const torch::Tensor& logits) {
  return logits.clamp(-DptTrunk::kLargestLogit, DptTrunk::kLargestLogit).exp();
}

void DptSizes::visit(FieldVisitor& visitor) {
  visitor.integer({"dim_in", "channels of a level"}, dim_in, {1, 1 << 16});
  visitor.integer({"features", "channels of the fused maps, divisible by 8"}, features, {8, 1 << 14});
  visitor.integers({"out_channels", "channels of the four levels' projections, divisible by 4"}, out_channels,
                   {4, 1 << 14});
  visitor.integer({"patch_size", "side of a patch in pixels"}, patch_size, {1, 1024});
  visitor.boolean({"pos_embed", "add the position of each pixel to the maps"}, pos_embed);
  visitor.integer({"down_ratio", "image side over depth map side"}, down_ratio, {1, 64});
}

void DptSizes::check() const {
  const bool divisible =
      std::all_of(out_channels.begin(), out_channels.end(), [](int64_t c) { return c % 4 == 0; });
  if (out_channels.size() != 4 || !divisible) {
    fail({"out_channels", "four numbers divisible by 4", c10::str(c10::IntArrayRef(out_channels)),
          "give the channels of the four levels' projections"});
  }
  if (features % 8 != 0) {
    fail({"features", "a number divisible by 8", std::to_string(features), "change features"});
  }
}

DptTrunk::DptTrunk(torch::nn::Module& head, const DptSizes& sizes, const ParameterPlacement& placement)
    : sizes_(sizes) {
  const auto& channels = sizes_.out_channels;
  norm_ = head.register_module("norm", std::make_shared<LayerNorm>(sizes_.dim_in, 1e-5, placement));
  const auto projects = child_module(head, "projects");
  for (size_t i = 0; i < 4; ++i) {
    projects_.push_back(child_convolution(*projects, std::to_string(i),
                                          same_size_convolution(sizes_.dim_in, channels[i], 1), placement));
  }
  const auto resize = child_module(head, "resize_layers");
  enlarge4_ = resize->register_module(
      "0", std::make_shared<BlockUpsampling>(BlockUpsampling::Sizes{channels[0], 4}, placement));
  enlarge2_ = resize->register_module(
      "1", std::make_shared<BlockUpsampling>(BlockUpsampling::Sizes{channels[1], 2}, placement));
  auto halving = same_size_convolution(channels[3], channels[3], 3);
  halving.stride = 2;
  reduce2_ = child_convolution(*resize, "3", halving, placement);
  scratch_ = child_module(head, "scratch");
  for (size_t i = 0; i < 4; ++i) {
    auto lateral = same_size_convolution(channels[i], sizes_.features, 3);
    lateral.bias = false;
    lateral_.push_back(
        child_convolution(*scratch_, "layer" + std::to_string(i + 1) + "_rn", lateral, placement));
  }
}

std::vector<std::shared_ptr<FusionBlock>> DptTrunk::fusion_stages(const std::string& suffix,
                                                                  FusionResidual residual,
                                                                  const ParameterPlacement& placement) const {
  std::vector<std::shared_ptr<FusionBlock>> stages;
  for (int stage = 1; stage <= 4; ++stage) {
    FusionBlock::Sizes sizes;
    sizes.channels = sizes_.features;
    sizes.inputs = stage == 4 ? FusionInputs::kRunning : FusionInputs::kRunningAndLateral;
    sizes.residual = residual;
    stages.push_back(scratch_->register_module("refinenet" + std::to_string(stage) + suffix,
                                               std::make_shared<FusionBlock>(sizes, placement)));
  }
  return stages;
}

torch::Tensor DptTrunk::with_positions(const torch::Tensor& maps, const LatentGrid& grid) const {
  if (!sizes_.pos_embed) return maps;
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

DptTrunk::Pyramid DptTrunk::pyramid(const std::vector<torch::Tensor>& levels, const LatentGrid& grid) const {
  Pyramid result;
  for (size_t i = 0; i < 4; ++i) {
    const auto tokens = norm_->forward(levels[i]);
    const auto maps =
        tokens.transpose(1, 2).reshape({tokens.size(0), sizes_.dim_in, grid.height, grid.width});
    auto scaled = with_positions(projects_[i]->forward(maps), grid);
    if (i == 0) scaled = enlarge4_->forward(scaled);
    if (i == 1) scaled = enlarge2_->forward(scaled);
    if (i == 3) scaled = reduce2_->forward(scaled);
    result.maps.push_back(lateral_[i]->forward(scaled));
  }
  return result;
}

torch::Tensor DptTrunk::fuse(const Pyramid& pyramid,
                             const std::vector<std::shared_ptr<FusionBlock>>& stages) {
  const auto& maps = pyramid.maps;
  const auto size_of = [&](size_t i) { return FusionBlock::MapSize{maps[i].size(2), maps[i].size(3)}; };
  auto running = stages[3]->forward(maps[3], {}, size_of(2));
  running = stages[2]->forward(running, maps[2], size_of(1));
  running = stages[1]->forward(running, maps[1], size_of(0));
  return stages[0]->forward(running, maps[0], {2 * maps[0].size(2), 2 * maps[0].size(3)});
}

torch::Tensor DptTrunk::enlarged(const torch::Tensor& fused, const LatentGrid& grid) const {
  const int64_t height = grid.height * sizes_.patch_size / sizes_.down_ratio;
  const int64_t width = grid.width * sizes_.patch_size / sizes_.down_ratio;
  return with_positions(torch::upsample_bilinear2d(fused, {height, width}, /*align_corners=*/true), grid);
}

void DptTrunk::check_levels(const std::vector<torch::Tensor>& levels, const LatentGrid& grid) const {
  const std::vector<int64_t> expected = {grid.views, grid.tokens_per_view(), sizes_.dim_in};
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
}

void DptTrunk::for_each_chunk(const std::vector<torch::Tensor>& levels, const LatentGrid& grid,
                              const std::function<void(const Pyramid&)>& use) const {
  const int64_t pixels = grid.tokens_per_view() * sizes_.patch_size * sizes_.patch_size;
  const int64_t chunk = std::max<int64_t>(1, kPixelsPerChunk / pixels);
  for (int64_t first = 0; first < grid.views; first += chunk) {
    const int64_t count = std::min(chunk, grid.views - first);
    std::vector<torch::Tensor> part;
    part.reserve(levels.size());
    for (const auto& level : levels) part.push_back(level.narrow(0, first, count));
    use(pyramid(part, grid));
  }
}

void add_dpt_pyramid(Cost& cost, const DptSizes& sizes, const LatentGrid& grid, double decoders) {
  const auto tokens = static_cast<double>(grid.views * grid.tokens_per_view());
  const auto features = static_cast<double>(sizes.features);
  for (size_t level = 0; level < sizes.out_channels.size(); ++level) {
    const auto channels = static_cast<double>(sizes.out_channels[level]);
    add_convolution(cost, tokens, static_cast<double>(sizes.dim_in), channels, 1);
    add_convolution(cost, tokens * kPyramidScales[level], channels, features, 3);
  }
  for (size_t level = 0; level < sizes.out_channels.size(); ++level) {
    const double units =
        level + 1 == sizes.out_channels.size() ? 1 : 2;  // the coarsest has one residual unit
    add_convolution(cost, decoders * tokens * kPyramidScales[level], features, 2 * units * features, 3);
    add_convolution(cost, decoders * tokens * kPyramidScales[level] * 4, features, features, 1);
  }
}

void add_dpt_output(Cost& cost, const DptSizes& sizes, const LatentGrid& grid) {
  const auto tokens = static_cast<double>(grid.views * grid.tokens_per_view());
  const auto features = static_cast<double>(sizes.features);
  const auto patch_pixels = static_cast<double>(sizes.patch_size * sizes.patch_size);
  add_convolution(cost, tokens * 64, features, features / 2, 3);
  add_convolution(cost, tokens * patch_pixels, features / 2, DptTrunk::kHiddenChannels, 3);
}

int64_t dpt_working_bytes(const DptSizes& sizes, const LatentGrid& grid, const DptMapChannels& channels) {
  // This counts, of a chunk of views, pyramid and fused maps, then the depth decoder's maps at full resolution,
  // enlarged and with positions, or beside its hidden maps, and of all views the maps, and the chunks' maps that they
  // are made of.
  const auto tokens = static_cast<double>(grid.views * grid.tokens_per_view());
  const auto features = static_cast<double>(sizes.features);
  const auto patch_pixels = static_cast<double>(sizes.patch_size * sizes.patch_size);
  const double fused = 53 * features, enlarged = patch_pixels * features / 2;
  const double ray_maps = 149 * features;
  const double depth_maps =
      fused + enlarged + std::max(2 * enlarged, 2 * patch_pixels * DptTrunk::kHiddenChannels);
  const double outputs = 2 * (channels.full_size * patch_pixels + channels.rays * 64);
  const auto per_view = static_cast<double>(grid.tokens_per_view());
  const double chunk_tokens =
      per_view * std::min(static_cast<double>(grid.views),
                          std::max(1.0, std::floor(static_cast<double>(DptTrunk::kPixelsPerChunk) /
                                                   (per_view * patch_pixels))));
  return bytes_of_floats(chunk_tokens *
                             (channels.full_size == 0 ? ray_maps : std::max(ray_maps, depth_maps)) +
                         tokens * outputs);
}

}  // namespace gld
