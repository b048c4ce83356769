#include "models/bundle/bundle.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/sha256.h"
#include "gld/machine/block_memory.h"
#include "gld/tensors/weight_tensors.h"
#include "models/bundle/view_unit_file.h"

#include <algorithm>
#include <system_error>
#include <utility>

namespace gld {
namespace {

const std::string kOptionsFile = "model.yaml";
const std::string kExtension = ".safetensors";

std::filesystem::path part_file(const std::filesystem::path& folder, const BundlePart& part) {
  return folder / (bundle_part_name(part) + kExtension);
}

// An autoencoder's half as what decodes images.
class BackboneImages : public ImageDecoder {
 public:
  explicit BackboneImages(std::shared_ptr<Backbone> backbone)
      : backbone_(register_module("backbone", std::move(backbone))) {}
  torch::Tensor decode(const torch::Tensor& features, const LatentGrid& grid) const override {
    return backbone_->decode(features, grid);
  }

 private:
  std::shared_ptr<const Backbone> backbone_;
};

// A relative path is looked up where one works first, then where the program is installed (PREFIX/share/gld beside
// PREFIX/bin, in an archive beside PREFIX/lib/gld), then in the tree that it was built in (TREE/build/PRESET/cli).
std::filesystem::path found_bundle(const std::filesystem::path& folder) {
  std::error_code error;
  if (folder.is_absolute() || std::filesystem::exists(folder, error)) return folder;
  const auto program = std::filesystem::read_symlink("/proc/self/exe", error);
  if (error) return folder;
  for (const char* from_program : {"../share/gld", "../../share/gld", "../../.."}) {
    auto there = (program.parent_path() / from_program / folder).lexically_normal();
    if (std::filesystem::is_regular_file(there / kOptionsFile, error)) return there;
  }
  return folder;
}

// What fields say of each other is told without a file; here it is one.
void check_description(const BundleOptions& options, const std::filesystem::path& yaml) {
  try {
    check_options(options, yaml.string());
  } catch (const Error& error) {
    ErrorParts parts = error.parts();
    if (parts.where.compare(0, yaml.string().size(), yaml.string()) == 0) throw;
    parts.where = yaml.string() + ", " + parts.where;
    fail(parts);
  }
}

}  // namespace

std::vector<BundlePart> bundle_parts(const BundleOptions& options) {
  std::vector<BundlePart> parts = {BundlePart::backbone()};
  if (options.geometry_head.exists()) parts.push_back(BundlePart::geometry_head());
  if (options.has_rgb_decoder()) parts.push_back(BundlePart::rgb_decoder());
  if (options.blending.exists()) parts.push_back(BundlePart::blending());
  if (options.depth_refinement.exists()) parts.push_back(BundlePart::depth_refinement());
  if (options.refiner.exists()) parts.push_back(BundlePart::refiner());
  std::vector<int64_t> levels, special;
  for (const auto& part : options.generators) {
    parts.push_back(BundlePart::of(part.generator));
    levels.push_back(part.generator.level);
    if (part.dit.num_special_tokens > 0) special.push_back(part.generator.level);
  }
  std::sort(levels.begin(), levels.end());
  for (const int64_t level : levels) parts.push_back(BundlePart::statistics(level));
  std::sort(special.begin(), special.end());
  for (const int64_t level : special) parts.push_back(BundlePart::special_statistics(level));
  return parts;
}

std::string bundle_part_name(const BundlePart& part) {
  switch (part.kind) {
    case BundlePart::Kind::kBackbone:
      return "backbone";
    case BundlePart::Kind::kGeometryHead:
      return "dpt_head";
    case BundlePart::Kind::kRgbDecoder:
      return "rgb_decoder";
    case BundlePart::Kind::kBlending:
      return "blending";
    case BundlePart::Kind::kDepthRefinement:
      return "depth_refinement";
    case BundlePart::Kind::kRefiner:
      return "refiner";
    case BundlePart::Kind::kGenerator:
      return generator_name(part.generator);
    case BundlePart::Kind::kStatistics:
      return "statistics_level" + std::to_string(part.level);
    case BundlePart::Kind::kSpecialStatistics:
      return "special_statistics_level" + std::to_string(part.level);
  }
  return "unknown";
}

std::shared_ptr<torch::nn::Module> make_bundle_module(const BundlePart& part, const BundleOptions& options,
                                                      const ParameterPlacement& placement) {
  switch (part.kind) {
    case BundlePart::Kind::kBackbone:
      return options.backbone.make(placement);
    case BundlePart::Kind::kGeometryHead:
      return options.geometry_head.make(placement);
    case BundlePart::Kind::kRgbDecoder:
      return std::make_shared<RgbDecoder>(options.rgb_decoder, placement);
    case BundlePart::Kind::kBlending:
      return std::make_shared<PhotographBlending>(options.blending, placement);
    case BundlePart::Kind::kDepthRefinement:
      return std::make_shared<DepthRefinement>(options.depth_refinement, placement);
    case BundlePart::Kind::kRefiner:
      return std::make_shared<DenoisingUnet>(options.refiner, placement);
    case BundlePart::Kind::kGenerator:
      return std::make_shared<DitDh>(options.generator(part.generator).dit, placement);
    case BundlePart::Kind::kStatistics:
    case BundlePart::Kind::kSpecialStatistics:
      break;
  }
  return nullptr;
}

ModelBundle ModelBundle::open(const std::filesystem::path& asked) {
  const auto folder = found_bundle(asked);
  const auto yaml = folder / kOptionsFile;
  if (!std::filesystem::is_regular_file(yaml)) {
    fail({folder.string(), "a model bundle, a folder with " + kOptionsFile,
          std::filesystem::is_directory(folder) ? "a folder without it"
          : std::filesystem::exists(folder)     ? "a file; name its folder"
                                                : "no such folder",
          // The folder of a run of gld train or gld stats.
          std::filesystem::is_regular_file(folder / "model" / kOptionsFile)
              ? "did you mean " + (folder / "model").string() + "?"
              : "make one with gld convert or gld train, or check the path"});
  }
  ModelBundle bundle;
  bundle.folder_ = folder;
  load_yaml(bundle.options_, yaml);
  check_description(bundle.options_, yaml);
  return bundle;
}

std::filesystem::path ModelBundle::file(const BundlePart& part) const { return part_file(folder_, part); }

bool ModelBundle::has(const BundlePart& part) const { return std::filesystem::is_regular_file(file(part)); }

LoadReport ModelBundle::load_into(torch::nn::Module& module, const BundlePart& part) const {
  return load_strict(module, *open_part(part));
}

std::shared_ptr<const WeightFile> ModelBundle::open_part(const BundlePart& part) const {
  require({part});
  return WeightFile::open(file(part));
}

void ModelBundle::require(const std::vector<BundlePart>& parts) const {
  for (const BundlePart& part : parts) {
    if (has(part)) continue;
    fail({folder_.string(), "a file " + bundle_part_name(part) + kExtension, "none",
          "add the part with gld convert or gld train"});
  }
}

int64_t ModelBundle::converted_bytes(const BundlePart& part) const {
  if (!has(part)) return 0;
  const auto file = open_part(part);
  int64_t numbers = 0;
  for (const TensorEntry& entry : file->entries()) {
    if (is_floating(entry.dtype) && entry.dtype != DType::kFloat32) numbers += entry.element_count();
  }
  return numbers * static_cast<int64_t>(sizeof(float));
}

template <class Module>
std::shared_ptr<Module> ModelBundle::loaded(std::shared_ptr<Module> module, const BundlePart& part) const {
  load_into(*module, part);
  // The module's first parameters were replaced by those of the file; where they are kept, their blocks would let later
  // tensors take that much more memory.
  release_kept_blocks();
  return module;
}

std::shared_ptr<Backbone> ModelBundle::load_backbone(const ParameterPlacement& placement) const {
  return loaded(options_.backbone.make(placement), BundlePart::backbone());
}

std::shared_ptr<GeometryHead> ModelBundle::load_geometry_head(const ParameterPlacement& placement) const {
  auto head = loaded(options_.geometry_head.make(placement), BundlePart::geometry_head());
  head->guess_unit_by(read_single_view_unit(*this));
  return head;
}

BundlePart ModelBundle::image_decoder_part() const {
  return options_.has_rgb_decoder() ? BundlePart::rgb_decoder() : BundlePart::backbone();
}

std::shared_ptr<ImageDecoder> ModelBundle::load_image_decoder(const ParameterPlacement& placement) const {
  if (options_.has_rgb_decoder()) return load_rgb_decoder(placement);
  return std::make_shared<BackboneImages>(load_backbone(placement));
}

std::shared_ptr<RgbDecoder> ModelBundle::load_rgb_decoder(const ParameterPlacement& placement) const {
  return loaded(std::make_shared<RgbDecoder>(options_.rgb_decoder, placement), BundlePart::rgb_decoder());
}

std::shared_ptr<PhotographBlending> ModelBundle::load_blending(const ParameterPlacement& placement) const {
  return loaded(std::make_shared<PhotographBlending>(options_.blending, placement), BundlePart::blending());
}

std::shared_ptr<DepthRefinement> ModelBundle::load_depth_refinement(
    const ParameterPlacement& placement) const {
  return loaded(std::make_shared<DepthRefinement>(options_.depth_refinement, placement),
                BundlePart::depth_refinement());
}

std::shared_ptr<DenoisingUnet> ModelBundle::load_refiner(const ParameterPlacement& placement) const {
  return loaded(std::make_shared<DenoisingUnet>(options_.refiner, placement), BundlePart::refiner());
}

std::shared_ptr<DitDh> ModelBundle::load_generator(const LevelGenerator& generator,
                                                   const ParameterPlacement& placement) const {
  return loaded(std::make_shared<DitDh>(options_.generator(generator).dit, placement),
                BundlePart::of(generator));
}

LatentStatistics ModelBundle::read_statistics(const BundlePart& part) const {
  auto statistics = read_latent_statistics(*open_part(part), "", options_.latent_epsilon);
  if (statistics.channels() != options_.backbone.level_channels()) {
    fail({file(part).string(), std::to_string(options_.backbone.level_channels()) + " channels",
          std::to_string(statistics.channels()), "compute the statistics with this bundle's backbone"});
  }
  return statistics;
}

LevelStatistics ModelBundle::load_statistics(const LevelGenerator& generator) const {
  LevelStatistics statistics;
  statistics.patches = read_statistics(BundlePart::statistics(generator.level));
  statistics.special_tokens = options_.generator(generator).dit.num_special_tokens;
  if (statistics.special_tokens > 0) {
    statistics.special = read_statistics(BundlePart::special_statistics(generator.level));
  }
  return statistics;
}

std::string ModelBundle::content_hash() const {
  Sha256 hash;
  const auto add = [&](const std::filesystem::path& file) {
    // Name and digest of each file are hashed, so that bytes cannot move from one to the next.
    hash.update(file.filename().string() + ":" + sha256_of_file(file) + "\n");
  };
  add(folder_ / kOptionsFile);
  for (const BundlePart& part : bundle_parts(options_)) {
    if (has(part)) add(file(part));
  }
  if (std::filesystem::is_regular_file(folder_ / kSingleViewUnitFile)) add(folder_ / kSingleViewUnitFile);
  return hash.hex_digest();
}

void save_bundle_options(const std::filesystem::path& folder, const BundleOptions& options) {
  check_description(options, folder / kOptionsFile);
  const std::string text = to_yaml(options);
  const auto yaml = folder / kOptionsFile;
  std::error_code problem;
  std::filesystem::create_directories(folder, problem);
  if (problem) {
    fail({folder.string(), "a folder that can be made", problem.message(), "choose another folder"});
  }
  if (std::filesystem::exists(yaml)) {
    const auto there = ModelBundle::open(folder);
    if (to_yaml(there.options()) == text) return;
    const auto parts = bundle_parts(there.options());
    const bool empty =
        std::none_of(parts.begin(), parts.end(), [&](const BundlePart& part) { return there.has(part); });
    if (!empty) {
      fail({yaml.string(), "the options that the bundle is written with", "others",
            "choose another folder or delete this bundle"});
    }
  }
  write_file_atomically(yaml, text);
}

void save_bundle_part(const std::filesystem::path& folder, const BundlePart& part,
                      const std::map<std::string, torch::Tensor>& tensors, DType dtype) {
  const auto file = part_file(folder, part);
  std::vector<TensorEntry> entries;
  for (const auto& [name, tensor] : tensors) {
    TensorEntry entry;
    entry.name = name;
    entry.shape = tensor.sizes().vec();
    entry.dtype = tensor.is_floating_point() ? dtype : file_dtype(tensor.scalar_type(), file.string());
    entries.push_back(std::move(entry));
  }
  save_safetensors(file, std::move(entries), [&](const TensorEntry& entry) {
    return tensors.at(entry.name).to(torch_dtype(entry.dtype, file.string()));
  });
}

}  // namespace gld
