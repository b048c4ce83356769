#include "models/splats/latent_pictures.h"

#include "gld/base/error.h"
#include "gld/base/sha256.h"
#include "gld/cameras/latent_grid.h"
#include "gld/cameras/resized_camera.h"
#include "gld/latents/latent_tokens.h"
#include "gld/machine/stage_record.h"

#include <algorithm>
#include <cstring>
#include <memory>
#include <utility>

#include <ATen/core/grad_mode.h>

#include <fmt/format.h>

namespace gld {
namespace {

bool is_number(const std::string& text) {
  return !text.empty() && text.size() < 4 &&
         std::all_of(text.begin(), text.end(), [](char c) { return c >= '0' && c <= '9'; });
}

// Returns the statistics of a latent's channels where a token holds a block of its pixels: those of the block's places
// together.
LatentStatistics of_pixels(const LatentStatistics& of_tokens, int64_t token_pixels) {
  if (token_pixels == 1) return of_tokens;
  LatentStatistics result = of_tokens;
  const auto means = of_tokens.mean.reshape({-1, token_pixels * token_pixels});
  result.mean = means.mean(1);
  result.variance = of_tokens.variance.reshape({-1, token_pixels * token_pixels}).mean(1) +
                    (means - result.mean.unsqueeze(1)).square().mean(1);
  return result;
}

// latents are (views, channels, height, width).
LatentStatistics of_views(const torch::Tensor& latents) {
  LatentStatistics result;
  const auto wide = latents.to(torch::kFloat64);
  result.mean = wide.mean({0, 2, 3}).to(torch::kFloat32);
  result.variance = (wide - wide.mean({0, 2, 3}, true)).square().mean({0, 2, 3}).to(torch::kFloat32);
  return result;
}

void require_memory(const BackboneArchitecture& architecture, const LatentGrid& grid, int64_t last_level) {
  const int64_t needed = architecture.encoding_cost(grid, last_level).working_bytes;
  const int64_t available = available_memory_bytes();
  if (available <= 0 || needed <= available) return;
  fail({"encoding views", fmt::format("at most {} of memory", bytes_text(available)),
        fmt::format("{} for {} views of {}x{} tokens by the forecast", bytes_text(needed), grid.views,
                    grid.width, grid.height),
        "take fewer or smaller views"});
}

LatentPictures normalised_pictures(const torch::Tensor& latents, LatentStatistics statistics, LatentTag tag) {
  LatentPictures result;
  result.statistics = std::move(statistics);
  result.tag = std::move(tag);
  result.tag.channels = latents.size(1);
  result.tag.height = latents.size(2);
  result.tag.width = latents.size(3);
  const auto normal = normalised_latents(latents, result.statistics);
  for (int64_t view = 0; view < normal.size(0); ++view)
    result.pictures.push_back(splat_image_of(normal[view]));
  return result;
}

const LevelGenerator* generator_of(const BundleOptions& bundle, int64_t level) {
  for (const auto& part : bundle.generators) {
    if (part.generator.level == level) return &part.generator;
  }
  return nullptr;
}

}  // namespace

nlohmann::ordered_json tag_json(const LatentTag& tag) {
  return {{"model", tag.model},   {"backbone", tag.backbone},     {"backbone_hash", tag.backbone_hash},
          {"level", tag.level},   {"channels", tag.channels},     {"width", tag.width},
          {"height", tag.height}, {"statistics", tag.statistics}, {"statistics_hash", tag.statistics_hash}};
}

std::optional<LatentTag> tag_of_json(const nlohmann::json& json) {
  LatentTag tag;
  try {
    tag.model = json.at("model").get<std::string>();
    tag.backbone = json.at("backbone").get<std::string>();
    tag.backbone_hash = json.at("backbone_hash").get<std::string>();
    tag.level = json.at("level").get<int64_t>();
    tag.channels = json.at("channels").get<int64_t>();
    tag.width = json.at("width").get<int64_t>();
    tag.height = json.at("height").get<int64_t>();
    tag.statistics = json.at("statistics").get<std::string>();
    tag.statistics_hash = json.at("statistics_hash").get<std::string>();
  } catch (const nlohmann::json::exception&) {
    return std::nullopt;
  }
  constexpr int64_t kMost = 1 << 16;
  for (const int64_t count : {tag.channels, tag.width, tag.height}) {
    if (count < 1 || count > kMost) return std::nullopt;
  }
  return tag;
}

Camera LatentPictures::camera_of(const Camera& of_image) const {
  return resized_camera(of_image, tag.width, tag.height);
}

torch::Tensor LatentPictures::views(int64_t first, int64_t end) const {
  std::vector<torch::Tensor> chosen;
  for (int64_t view = first; view < end; ++view)
    chosen.push_back(tensor_of(pictures[static_cast<size_t>(view)]));
  return torch::stack(chosen);
}

torch::Tensor LatentPictures::raw(const SplatImage& picture) const {
  return raw_latents(tensor_of(picture).unsqueeze(0), statistics)[0];
}

torch::Tensor raw_latents(const torch::Tensor& normalised, const LatentStatistics& statistics) {
  return statistics.denormalise(normalised.permute({0, 2, 3, 1})).permute({0, 3, 1, 2}).contiguous();
}

torch::Tensor normalised_latents(const torch::Tensor& raw, const LatentStatistics& statistics) {
  return statistics.normalise(raw.permute({0, 2, 3, 1})).permute({0, 3, 1, 2}).contiguous();
}

LatentStatistics statistics_of_pictures(const ModelBundle& bundle, int64_t level) {
  const BundleOptions& options = bundle.options();
  const LevelGenerator* generator = generator_of(options, level);
  if (generator == nullptr || !bundle.has(BundlePart::statistics(level))) {
    fail({bundle.folder().string(),
          fmt::format("statistics of level {}, which its latents are normalised by", level), "none",
          "make them with gld stats"});
  }
  return of_pixels(bundle.load_statistics(*generator).patches,
                   options.backbone.architecture().latent_pixels());
}

std::vector<int64_t> latent_levels(const std::vector<std::string>& names, const BundleOptions& bundle,
                                   const std::string& option) {
  const int64_t levels = bundle.backbone.levels();
  std::vector<int64_t> chosen;
  for (const std::string& name : names) {
    if (name == "all") {
      for (int64_t level = 0; level < levels; ++level) chosen.push_back(level);
    } else if (is_number(name) && std::stoll(name) < levels) {
      chosen.push_back(std::stoll(name));
    } else {
      fail({option, fmt::format("levels 0 to {} of {}, or all", levels - 1, bundle.name), "'" + name + "'",
            "choose among them"});
    }
  }
  std::sort(chosen.begin(), chosen.end());
  chosen.erase(std::unique(chosen.begin(), chosen.end()), chosen.end());
  return chosen;
}

ImageSize latent_image_size(const BundleOptions& bundle, const ImageSize& about) {
  const int64_t side = bundle.backbone.patch_side();
  return {nearest_whole_patches(about.width, side) * side, nearest_whole_patches(about.height, side) * side};
}

ImageSize image_size_of_latents(const BundleOptions& bundle, int64_t width, int64_t height) {
  const int64_t pixels = bundle.backbone.architecture().latent_pixels();
  const auto image_side = [&](int64_t side) {
    if (side % pixels == 0) return side / pixels * bundle.backbone.patch_side();
    fail({"latents of " + bundle.name, fmt::format("a side in whole tokens of {} latent pixels", pixels),
          std::to_string(side), "choose another"});
  };
  return {image_side(width), image_side(height)};
}

LatentPictures latent_pictures_of(const torch::Tensor& latents, LatentTag tag) {
  tag.statistics = "of the views";
  return normalised_pictures(latents, of_views(latents), std::move(tag));
}

LatentEncoding::LatentEncoding(const ModelBundle& bundle)
    : bundle_(bundle),
      backbone_(bundle.load_backbone()),
      backbone_hash_(sha256_of_file(bundle.file(BundlePart::backbone()))) {
  for (int64_t level = 0; level < options().backbone.levels(); ++level) {
    if (generator_of(options(), level) == nullptr || !bundle.has(BundlePart::statistics(level))) continue;
    statistics_[level] = {statistics_of_pictures(bundle, level),
                          sha256_of_file(bundle.file(BundlePart::statistics(level)))};
  }
}

bool LatentEncoding::encodes_alone() const {
  const auto& architecture = backbone_->architecture();
  for (int64_t block = 0; block < architecture.blocks(); ++block) {
    if (architecture.attends_over_views(block)) return false;
  }
  return true;
}

std::vector<LatentPictures> LatentEncoding::operator()(const torch::Tensor& images,
                                                       const std::vector<int64_t>& levels) const {
  const at::NoGradGuard no_gradients;
  std::vector<LatentPictures> result;
  if (levels.empty()) return result;
  const auto& architecture = backbone_->architecture();
  const LatentGrid grid = architecture.grid_of(images.size(0), images.size(2), images.size(3));
  const int64_t token_pixels = architecture.latent_pixels();
  require_memory(architecture, grid, levels.back());
  const auto encoded = backbone_->encode(images, levels.back());
  for (const int64_t level : levels) {
    const auto tokens =
        backbone_->patches_of(encoded.at(static_cast<size_t>(level))).to(torch::kFloat32).contiguous();
    const auto latents = latents_of_tokens(tokens, grid, token_pixels);
    if (!latents.isfinite().all().item<bool>()) {
      fail({"encoding views with " + options().name, "finite latents",
            fmt::format("NaN or infinity at level {}", level), "check the backbone with gld inspect"});
    }
    const auto of_model = statistics_.find(level);
    const bool known = of_model != statistics_.end();
    LatentTag tag;
    tag.model = options().name;
    tag.backbone = architecture.kind();
    tag.backbone_hash = backbone_hash_;
    tag.level = level;
    tag.statistics = known ? "of the model" : "of the views";
    if (known) tag.statistics_hash = of_model->second.hash;
    result.push_back(
        normalised_pictures(latents, known ? of_model->second.values : of_views(latents), std::move(tag)));
  }
  return result;
}

std::vector<LatentView> latent_views(const std::vector<LatentPictures>& levels,
                                     const std::vector<Camera>& cameras) {
  std::vector<LatentView> views;
  for (size_t view = 0; view < cameras.size(); ++view) {
    std::vector<torch::Tensor> channels;
    channels.reserve(levels.size());
    for (const LatentPictures& level : levels) channels.push_back(tensor_of(level.pictures[view]));
    views.push_back({levels.front().camera_of(cameras[view]), splat_image_of(torch::cat(channels))});
  }
  return views;
}

std::vector<int64_t> decoded_levels(const BundleOptions& bundle) {
  return bundle.level_set().decoded_levels();
}

LatentDecoding::LatentDecoding(const ModelBundle& bundle)
    : backbone_(bundle.load_backbone()), decoder_(bundle.load_image_decoder()) {}

torch::Tensor LatentDecoding::operator()(const std::vector<torch::Tensor>& maps) const {
  const at::NoGradGuard no_gradients;
  const int64_t token_pixels = backbone_->architecture().latent_pixels();
  std::vector<torch::Tensor> levels;
  levels.reserve(maps.size());
  for (const auto& level : maps)
    levels.push_back(backbone_->normalise_for_decoding(tokens_of_latents(level, token_pixels)));
  const auto& first = maps.front();
  const LatentGrid grid{first.size(0), first.size(2) / token_pixels, first.size(3) / token_pixels};
  return decoder_->decode(torch::cat(levels, 2), grid);
}

SplatImage splat_image_of(const torch::Tensor& picture) {
  const auto values = picture.to(torch::kCPU, torch::kFloat32).contiguous();
  SplatImage image(values.size(0), values.size(2), values.size(1));
  const float* from = values.data_ptr<float>();
  for (int64_t c = 0; c < image.channels; ++c) {
    for (int64_t y = 0; y < image.height; ++y, from += image.width)
      std::memcpy(image.row(c, y), from, static_cast<size_t>(image.width) * sizeof(float));
  }
  return image;
}

torch::Tensor tensor_of(const SplatImage& picture) {
  auto values = torch::empty({picture.channels, picture.height, picture.width}, torch::kFloat32);
  float* to = values.data_ptr<float>();
  for (int64_t c = 0; c < picture.channels; ++c) {
    for (int64_t y = 0; y < picture.height; ++y, to += picture.width)
      std::memcpy(to, picture.row(c, y), static_cast<size_t>(picture.width) * sizeof(float));
  }
  return values;
}

}  // namespace gld
