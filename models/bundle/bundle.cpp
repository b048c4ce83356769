#include "models/bundle/bundle.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/sha256.h"
#include "gld/machine/block_memory.h"
#include "gld/tensors/weight_tensors.h"

#include <algorithm>
#include <system_error>
#include <utility>

namespace gld {
namespace {

const std::string kOptionsFile = "model.yaml";
const std::string kExtension = ".safetensors";

struct PartName {
  BundlePart part;
  const char* name;
};

constexpr PartName kParts[] = {{BundlePart::kBackbone, "backbone"},
                               {BundlePart::kDptHead, "dpt_head"},
                               {BundlePart::kRgbDecoder, "rgb_decoder"},
                               {BundlePart::kLevel1, "level1"},
                               {BundlePart::kCascade, "cascade"},
                               {BundlePart::kStatisticsLevel0, "statistics_level0"},
                               {BundlePart::kStatisticsLevel1, "statistics_level1"}};

std::filesystem::path part_file(const std::filesystem::path& folder, BundlePart part) {
  return folder / (bundle_part_name(part) + kExtension);
}

}  // namespace

const std::vector<BundlePart>& bundle_parts() {
  static const std::vector<BundlePart> parts = [] {
    std::vector<BundlePart> all;
    for (const auto& entry : kParts) all.push_back(entry.part);
    return all;
  }();
  return parts;
}

std::string bundle_part_name(BundlePart part) {
  for (const auto& entry : kParts) {
    if (entry.part == part) return entry.name;
  }
  return "unknown";
}

std::shared_ptr<torch::nn::Module> make_bundle_module(BundlePart part, const BundleOptions& options,
                                                      const ParameterPlacement& placement) {
  switch (part) {
    case BundlePart::kBackbone:
      return std::make_shared<Da3Backbone>(options.backbone, placement);
    case BundlePart::kDptHead:
      return std::make_shared<DptHead>(options.dpt_head, placement);
    case BundlePart::kRgbDecoder:
      return std::make_shared<RgbDecoder>(options.rgb_decoder, placement);
    case BundlePart::kLevel1:
      return std::make_shared<DitDh>(options.level1, placement);
    case BundlePart::kCascade:
      return std::make_shared<DitDh>(options.cascade, placement);
    case BundlePart::kStatisticsLevel0:
    case BundlePart::kStatisticsLevel1:
      break;
  }
  return nullptr;
}

ModelBundle ModelBundle::open(const std::filesystem::path& folder) {
  const auto yaml = folder / kOptionsFile;
  if (!std::filesystem::is_regular_file(yaml)) {
    fail({folder.string(), "a model bundle, a folder with " + kOptionsFile,
          std::filesystem::is_directory(folder) ? "a folder without it" : "no such folder",
          "make one with gld convert or gld train, or check the path"});
  }
  ModelBundle bundle;
  bundle.folder_ = folder;
  load_yaml(bundle.options_, yaml);
  check_options(bundle.options_, yaml.string());
  return bundle;
}

std::filesystem::path ModelBundle::file(BundlePart part) const { return part_file(folder_, part); }

bool ModelBundle::has(BundlePart part) const { return std::filesystem::is_regular_file(file(part)); }

LoadReport ModelBundle::load_into(torch::nn::Module& module, BundlePart part) const {
  return load_strict(module, *open_part(part));
}

std::shared_ptr<const WeightFile> ModelBundle::open_part(BundlePart part) const {
  if (!has(part)) {
    fail({folder_.string(), "a file " + bundle_part_name(part) + kExtension, "none",
          "add the part with gld convert or gld train"});
  }
  return WeightFile::open(file(part));
}

template <class Module, class Options>
std::shared_ptr<Module> ModelBundle::loaded(BundlePart part, const Options& options,
                                            const ParameterPlacement& placement) const {
  auto module = std::make_shared<Module>(options, placement);
  load_into(*module, part);
  // The module's first parameters were replaced by those of the file; kept, their blocks would let later tensors take
  // that much more memory.
  release_kept_blocks();
  return module;
}

std::shared_ptr<Da3Backbone> ModelBundle::load_backbone(const ParameterPlacement& placement) const {
  return loaded<Da3Backbone>(BundlePart::kBackbone, options_.backbone, placement);
}

std::shared_ptr<DptHead> ModelBundle::load_dpt_head(const ParameterPlacement& placement) const {
  return loaded<DptHead>(BundlePart::kDptHead, options_.dpt_head, placement);
}

std::shared_ptr<RgbDecoder> ModelBundle::load_rgb_decoder(const ParameterPlacement& placement) const {
  return loaded<RgbDecoder>(BundlePart::kRgbDecoder, options_.rgb_decoder, placement);
}

std::shared_ptr<DitDh> ModelBundle::load_level1(const ParameterPlacement& placement) const {
  return loaded<DitDh>(BundlePart::kLevel1, options_.level1, placement);
}

std::shared_ptr<DitDh> ModelBundle::load_cascade(const ParameterPlacement& placement) const {
  return loaded<DitDh>(BundlePart::kCascade, options_.cascade, placement);
}

LatentStatistics ModelBundle::load_statistics(BundlePart part) const {
  auto statistics = read_latent_statistics(*open_part(part), "", options_.latent_epsilon);
  if (statistics.channels() != options_.backbone.level_channels()) {
    fail({file(part).string(), std::to_string(options_.backbone.level_channels()) + " channels",
          std::to_string(statistics.channels()), "compute the statistics with this bundle's backbone"});
  }
  return statistics;
}

std::string ModelBundle::content_hash() const {
  Sha256 hash;
  const auto add = [&](const std::filesystem::path& file) {
    // Name and digest of each file, so that bytes cannot move from one to the next.
    hash.update(file.filename().string() + ":" + sha256_of_file(file) + "\n");
  };
  add(folder_ / kOptionsFile);
  for (const BundlePart part : bundle_parts()) {
    if (has(part)) add(file(part));
  }
  return hash.hex_digest();
}

void save_bundle_options(const std::filesystem::path& folder, const BundleOptions& options) {
  check_options(options, (folder / kOptionsFile).string());
  const std::string text = to_yaml(options);
  const auto yaml = folder / kOptionsFile;
  std::error_code problem;
  std::filesystem::create_directories(folder, problem);
  if (problem) {
    fail({folder.string(), "a folder that can be made", problem.message(), "choose another folder"});
  }
  if (std::filesystem::exists(yaml)) {
    if (to_yaml(ModelBundle::open(folder).options()) == text) return;
    const bool empty = std::none_of(bundle_parts().begin(), bundle_parts().end(), [&](BundlePart part) {
      return std::filesystem::exists(part_file(folder, part));
    });
    if (!empty) {
      fail({yaml.string(), "the options that the bundle is written with", "others",
            "choose another folder or delete this bundle"});
    }
  }
  write_file_atomically(yaml, text);
}

void save_bundle_part(const std::filesystem::path& folder, BundlePart part,
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
