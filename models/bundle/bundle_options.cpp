#include "models/bundle/bundle_options.h"

#include "gld/base/error.h"

#include <algorithm>
#include <charconv>
#include <string>
#include <utility>

#include <fmt/format.h>

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

void check_geometry_head(const GeometryHeadOptions& head, const BackboneOptions& backbone) {
  if (!head.exists()) return;
  const auto& architecture = head.architecture();
  if (backbone.levels() != 4) {
    fail({"dpt_head.type", "none for a backbone with other than four levels", architecture.kind(),
          "set dpt_head: {type: none}; geometry then comes from gld sample --geometry-model"});
  }
  require_equal("dpt_head.dim_in", architecture.level_channels(), backbone.level_channels(),
                "the channels of the backbone's levels");
  require_equal("dpt_head.patch_size", architecture.patch_side(), backbone.patch_side(),
                "the backbone's patch size");
  if (architecture.leading_tokens() < 0) return;
  require_equal("dpt_head.num_special_tokens", architecture.leading_tokens(), backbone.leading_tokens(),
                "the backbone's tokens in front of the patches");
}

}  // namespace

ImageSize image_size_from_text(const std::string& text, const std::string& where) {
  ImageSize size;
  const char* position = text.data();
  const char* end = position + text.size();
  const bool good = read_side(position, end, size.width) && position != end && *position++ == 'x' &&
                    read_side(position, end, size.height) && position == end;
  if (!good)
    fail({where, fmt::format("WIDTHxHEIGHT in pixels, sides from 1 to {}", kLargestSide), "'" + text + "'",
          "write for example 504x280"});
  return size;
}

void TimeShiftOptions::visit(FieldVisitor& visitor) {
  visitor.real({"training", "time shift that training draws flow times with; 0: from the latent's shape"},
               training, {0, 1e6});
  visitor.real({"evaluation", "time shift of the published sampler; 0: from the latent's shape"}, evaluation,
               {0, 1e6});
}

BundleOptions::BundleOptions() { set_generators({level_model(1), cascade(1, 0)}); }

void BundleOptions::set_generators(const std::vector<LevelGenerator>& wanted) {
  std::vector<GeneratorOptions> result;
  for (const auto& generator : wanted) {
    const auto same = std::find_if(generators.begin(), generators.end(), [&](const GeneratorOptions& known) {
      return known.generator == generator;
    });
    if (same != generators.end()) {
      result.push_back(*same);
      continue;
    }
    GeneratorOptions options;
    options.generator = generator;
    options.dit.depth = {28, generator.is_cascade() ? 2 : 6};
    if (generator.is_cascade()) options.dit.conditioning = DitConditioning::kDeeperLevel;
    result.push_back(std::move(options));
  }
  generators = std::move(result);
}

void BundleOptions::visit(FieldVisitor& visitor) {
  visitor.text({"name", "name of the model"}, name);
  visitor.group({"backbone", "frozen backbone"}, backbone);
  visitor.group({"dpt_head", "frozen geometry head"}, geometry_head);
  visitor.group({"rgb_decoder", "RGB decoder"}, rgb_decoder);
  visitor.group({"blending", "network that lays photographs together in target views"}, blending);
  visitor.group({"depth_refinement", "network that mends the depth of source views"}, depth_refinement);
  visitor.group(
      {"refiner", "network that repairs a degraded view's latents beside its nearest views in one call"},
      refiner);
  std::vector<std::string> texts;
  for (const auto& part : generators) texts.push_back(generator_text(part.generator));
  const auto before = texts;
  visitor.texts({"generated", "what is generated, in this order: levels from noise (1), cascades (1->0)"},
                texts);
  if (texts != before) {
    std::vector<LevelGenerator> wanted;
    wanted.reserve(texts.size());
    for (const auto& text : texts) wanted.push_back(generator_from_text(text, "generated"));
    set_generators(wanted);
  }
  for (auto& part : generators) {
    const std::string what =
        part.generator.is_cascade()
            ? fmt::format("cascade that generates level {} from level {}", part.generator.level,
                          *part.generator.deeper)
            : fmt::format("M{}, which generates level {}", part.generator.level, part.generator.level);
    visitor.group({generator_name(part.generator), what}, part.dit);
  }
  for (auto& part : generators) {
    visitor.group(
        {generator_name(part.generator) + "_time_shift", "time shift of " + generator_stage(part.generator)},
        part.time_shift);
  }
  visitor.integer({"boundary_level", "level that is generated and propagated from"}, boundary_level, {0, 16});
  visitor.integers({"decoded_levels", "levels that the RGB decoder takes; none is all"}, decoded_levels,
                   {0, 16});
  visitor.real({"latent_epsilon", "added to the variance of latent statistics"}, latent_epsilon, {0, 1});
  visitor.texts({"trained_sizes", "image sizes the model was trained at, WIDTHxHEIGHT in pixels"},
                trained_sizes);
  visitor.real(
      {"single_source_unit",
       "metres of the geometry head's unit where it sees one view alone, as usual in what the model was "
       "trained on; 0 is not known"},
      single_source_unit, {0, 1e6});
  visitor.real({"single_source_unit_deviation",
                "standard deviation of its logarithm in what the model was trained on; 0 is not known"},
               single_source_unit_deviation, {0, 10});
}

LevelSet BundleOptions::level_set() const {
  LevelSet set;
  for (const auto& part : generators) {
    set.generators.push_back(part.generator);
    set.warped_sources = std::max(set.warped_sources, part.dit.warped_sources);
  }
  set.boundary = boundary_level;
  set.levels = backbone.levels();
  set.decoded = decoded_levels;
  return set;
}

const GeneratorOptions& BundleOptions::generator(const LevelGenerator& generator) const {
  std::string known;
  for (const auto& part : generators) {
    if (part.generator == generator) return part;
    known += (known.empty() ? "" : ", ") + generator_text(part.generator);
  }
  fail({"model " + name, "one of its generated parts: " + known, generator_text(generator),
        "list it under generated in model.yaml"});
}

GeneratorOptions& BundleOptions::generator(const LevelGenerator& generator) {
  return const_cast<GeneratorOptions&>(static_cast<const BundleOptions&>(*this).generator(generator));
}

bool BundleOptions::has_geometry() const {
  const auto set = level_set();
  if (!geometry_head.exists()) return false;
  for (int64_t level = 0; level < set.levels; ++level) {
    if (!set.knows(level)) return false;
  }
  return true;
}

void BundleOptions::check() const {
  const int64_t channels = backbone.level_channels();
  const std::string because = "the channels of the backbone's levels";
  const LevelSet set = level_set();
  check_level_set(set);
  const std::string patches = "the backbone's patch size";
  check_geometry_head(geometry_head, backbone);
  if (single_source_unit_deviation > 0 && single_source_unit == 0) {
    fail({"single_source_unit_deviation", "0 without single_source_unit, whose error it is",
          fmt::format("{:g}", single_source_unit_deviation), "give both, as gld stats does"});
  }
  if (has_rgb_decoder()) {
    const auto decoded = static_cast<int64_t>(set.decoded_levels().size());
    require_equal("rgb_decoder.in_channels", rgb_decoder.in_channels, decoded * channels,
                  decoded == set.levels ? "the channels of all levels together"
                                        : "the channels of the decoded levels together");
    require_equal("rgb_decoder.patch_size", rgb_decoder.patch_size, backbone.patch_side(), patches);
  }
  if (set.warped_sources > 0 && !geometry_head.exists()) {
    fail({"warped_sources", "0 for a model without a geometry head, whose depth carries the photographs",
          std::to_string(set.warped_sources), "set it to 0, or give the model a dpt_head"});
  }
  if (refiner.repairs_samples()) {
    require_equal("refiner.latent_channels", refiner.latent_channels,
                  static_cast<int64_t>(generators.size()) * channels,
                  "the channels of all generated levels together");
  } else if (refiner.exists() && has_rgb_decoder()) {
    fail({"refiner.degraded",
          "generated for a model with an RGB decoder: splats show latents of autoencoders",
          refiner.degraded == DegradedLatents::kColours ? "colours" : "splatted",
          "change it, or leave the refiner out"});
  } else if (refiner.exists()) {
    const int64_t pixels = backbone.architecture().latent_pixels();
    require_equal("refiner.latent_channels", refiner.latent_channels, channels / (pixels * pixels),
                  "the channels of a pixel of the backbone's latents");
  }
  const auto require_head_for = [&](const std::string& key, const PixelUnetOptions& network) {
    if (!network.exists() || geometry_head.exists()) return;
    fail({key + ".channels", "none for a model without a geometry head, whose depth carries the photographs",
          std::to_string(network.channels.size()) + " numbers",
          "leave them out, or give the model a dpt_head"});
  };
  require_head_for("blending", blending);
  require_head_for("depth_refinement", depth_refinement);
  if (!backbone.architecture().propagates()) {
    require_equal(
        "boundary_level", boundary_level, set.levels - 1,
        "the deepest level of a " + backbone.architecture().kind() + " backbone, which propagates none");
  }
  for (const auto& part : generators) {
    const std::string key = generator_name(part.generator);
    require_equal(key + ".in_channels", part.dit.in_channels, channels, because);
    require_equal(key + ".camera_patch_size", part.dit.camera_patch_size, backbone.patch_side(), patches);
    if (part.dit.num_special_tokens != 0) {
      require_equal(key + ".num_special_tokens", part.dit.num_special_tokens, backbone.leading_tokens(),
                    "the backbone's tokens in front of the patches, or 0");
    }
    const bool takes_deeper = part.dit.conditioning == DitConditioning::kDeeperLevel;
    if (takes_deeper != part.generator.is_cascade()) {
      const std::string right = part.generator.is_cascade() ? "deeper_level" : "none";
      fail({key + ".conditioning", right, takes_deeper ? "deeper_level" : "none", "set it to " + right});
    }
  }
  if (trained_sizes.empty()) {
    fail({"trained_sizes", "at least one size", "none", "write for example trained_sizes: [504x280]"});
  }
  for (const auto& size : image_sizes()) {
    if (size.width % backbone.patch_side() != 0 || size.height % backbone.patch_side() != 0) {
      fail({"trained_sizes", "sides that are multiples of " + std::to_string(backbone.patch_side()),
            std::to_string(size.width) + "x" + std::to_string(size.height), "choose whole patches"});
    }
  }
}

std::vector<ImageSize> BundleOptions::image_sizes() const {
  std::vector<ImageSize> sizes;
  for (const auto& text : trained_sizes) sizes.push_back(image_size_from_text(text, "trained_sizes"));
  return sizes;
}

double BundleOptions::unit_of_single_source(const Views& views, bool metric) const {
  const bool sees = geometry_head.exists() && geometry_head.predicts_rays();
  return views.num_sources == 1 && metric && sees ? single_source_unit : 0;
}

BundleOptions single_level_options(const std::string& name, const BackboneOptions& backbone) {
  BundleOptions options;
  options.name = name;
  options.backbone = backbone;
  options.geometry_head = GeometryHeadOptions::none();
  const int64_t deepest = backbone.levels() - 1, channels = backbone.level_channels();
  options.boundary_level = deepest;
  options.set_generators({level_model(deepest)});
  options.decoded_levels = {deepest};
  options.rgb_decoder.in_channels = channels;
  options.rgb_decoder.patch_size = backbone.patch_side();
  options.trained_sizes.clear();
  const int64_t side = backbone.patch_side();
  for (const int64_t height : {504, 378, 336, 280}) {
    options.trained_sizes.push_back(
        fmt::format("{}x{}", (504 + side / 2) / side * side, (height + side / 2) / side * side));
  }
  options.rgb_decoder.base_image_size = (504 + side / 2) / side * side;
  for (auto& part : options.generators) {
    part.dit.in_channels = channels;
    part.dit.camera_patch_size = side;
    part.time_shift.training = part.time_shift.evaluation = 0;
  }
  return options;
}

}  // namespace gld
