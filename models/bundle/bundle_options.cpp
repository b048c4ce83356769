#include "models/bundle/bundle_options.h"

#include "gld/base/error.h"

#include <charconv>
#include <string>

namespace gld {
namespace {

constexpr int64_t kLargestSide = 1 << 16;

void require_equal(const std::string& key, int64_t value, int64_t expected, const std::string& because) {
  if (value == expected) return;
  fail({key, std::to_string(expected) + ", " + because, std::to_string(value), "change one of them"});
}

bool read_side(const char*& position, const char* end, int64_t& side) {
  const auto result = std::from_chars(position, end, side);
  position = result.ptr;
  return result.ec == std::errc() && side > 0 && side <= kLargestSide;
}

}  // namespace

ImageSize image_size_from_text(const std::string& text, const std::string& where) {
  ImageSize size;
  const char* position = text.data();
  const char* end = position + text.size();
  const bool good = read_side(position, end, size.width) && position != end && *position++ == 'x' &&
                    read_side(position, end, size.height) && position == end;
  if (!good) fail({where, "WIDTHxHEIGHT in pixels", "'" + text + "'", "write for example 504x280"});
  return size;
}

void TimeShiftOptions::visit(FieldVisitor& visitor) {
  visitor.real({"training", "time shift that training draws flow times with"}, training, {1e-3, 1e6});
  visitor.real({"evaluation", "time shift of the published sampler"}, evaluation, {1e-3, 1e6});
}

BundleOptions::BundleOptions() {
  level1.depth = {28, 6};
  cascade.depth = {28, 2};
  cascade.conditioning = DitConditioning::kDeeperLevel;
}

void BundleOptions::visit(FieldVisitor& visitor) {
  visitor.text({"name", "name of the model"}, name);
  visitor.group({"backbone", "frozen backbone"}, backbone);
  visitor.group({"dpt_head", "frozen DPT head"}, dpt_head);
  visitor.group({"rgb_decoder", "RGB decoder"}, rgb_decoder);
  visitor.group({"level1", "M1, which generates the boundary level"}, level1);
  visitor.group({"cascade", "M1->0, which generates level 0 from the boundary level"}, cascade);
  visitor.group({"level1_time_shift", "time shift of M1"}, level1_time_shift);
  visitor.group({"cascade_time_shift", "time shift of the cascade"}, cascade_time_shift);
  visitor.integer({"boundary_level", "level that is generated first and propagated from"}, boundary_level,
                  {1, 16});
  visitor.real({"latent_epsilon", "added to the variance of latent statistics"}, latent_epsilon, {0, 1});
  visitor.texts({"trained_sizes", "image sizes the model was trained at, WIDTHxHEIGHT in pixels"},
                trained_sizes);
}

void BundleOptions::check() const {
  const int64_t channels = backbone.level_channels();
  const std::string because = "the channels of the backbone's levels";
  require_equal("dpt_head.dim_in", dpt_head.dim_in, channels, because);
  require_equal("level1.in_channels", level1.in_channels, channels, because);
  require_equal("cascade.in_channels", cascade.in_channels, channels, because);
  require_equal("rgb_decoder.in_channels", rgb_decoder.in_channels, backbone.levels() * channels,
                "the channels of all levels together");
  const std::string patches = "the backbone's patch size";
  require_equal("dpt_head.patch_size", dpt_head.patch_size, backbone.patch_size, patches);
  require_equal("rgb_decoder.patch_size", rgb_decoder.patch_size, backbone.patch_size, patches);
  require_equal("level1.camera_patch_size", level1.camera_patch_size, backbone.patch_size, patches);
  require_equal("cascade.camera_patch_size", cascade.camera_patch_size, backbone.patch_size, patches);
  if (cascade.conditioning != DitConditioning::kDeeperLevel) {
    fail({"cascade.conditioning", "deeper_level", "none", "set it to deeper_level"});
  }
  if (boundary_level >= backbone.levels()) {
    fail({"boundary_level", "a level below " + std::to_string(backbone.levels()),
          std::to_string(boundary_level), "choose one of the backbone's levels"});
  }
  if (trained_sizes.empty()) {
    fail({"trained_sizes", "at least one size", "none", "write for example trained_sizes: [504x280]"});
  }
  for (const auto& size : image_sizes()) {
    if (size.width % backbone.patch_size != 0 || size.height % backbone.patch_size != 0) {
      fail({"trained_sizes", "sides that are multiples of " + std::to_string(backbone.patch_size),
            std::to_string(size.width) + "x" + std::to_string(size.height), "choose whole patches"});
    }
  }
}

std::vector<ImageSize> BundleOptions::image_sizes() const {
  std::vector<ImageSize> sizes;
  for (const auto& text : trained_sizes) sizes.push_back(image_size_from_text(text, "trained_sizes"));
  return sizes;
}

BundleOptions released_da3_options() {
  BundleOptions options;
  options.name = "GLD DA3-Base, released";
  options.rgb_decoder.hidden_size = 1152;
  options.rgb_decoder.num_layers = 28;
  options.rgb_decoder.num_heads = 16;
  options.rgb_decoder.intermediate_size = 4096;
  options.cascade.split_embedders = false;
  options.cascade.prope_image_size = "504";
  options.cascade.unconditional_intrinsics = UnconditionalIntrinsics::kKeep;
  apply_published_conventions(options.level1);
  apply_published_conventions(options.cascade);
  return options;
}

}  // namespace gld
