#pragma once

#include "gld/files/dtype.h"
#include "gld/latents/latent_statistics.h"
#include "models/bundle/bundle_options.h"
#include "models/dit/dit_dh.h"
#include "models/weights/weight_loading.h"

#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// The files of a model bundle beside model.yaml. Each holds one module's tensors under the module's own names.
enum class BundlePart {
  kBackbone,
  kDptHead,
  kRgbDecoder,
  kLevel1,
  kCascade,
  kStatisticsLevel0,
  kStatisticsLevel1
};

const std::vector<BundlePart>& bundle_parts();
std::string bundle_part_name(BundlePart part);  // "level1"; the file is "level1.safetensors"

// The module of a part, with uninitialised parameters; null for the statistics.
std::shared_ptr<torch::nn::Module> make_bundle_module(BundlePart part, const BundleOptions& options,
                                                      const ParameterPlacement& placement);

// A model bundle on disk (DESIGN.md section 5): a folder with model.yaml and safetensors. Parts are loaded one by one,
// so that the weights of one stage are resident at a time; a part may be missing until it is asked for.
class ModelBundle {
 public:
  // Reads and checks model.yaml. Throws Error when the folder is no bundle.
  static ModelBundle open(const std::filesystem::path& folder);

  const std::filesystem::path& folder() const { return folder_; }
  const BundleOptions& options() const { return options_; }
  std::filesystem::path file(BundlePart part) const;
  bool has(BundlePart part) const;

  // Loads the part's file into a module that was built from these options; Error when the file is missing, with what
  // to do.
  LoadReport load_into(torch::nn::Module& module, BundlePart part) const;

  // The module with its weights, in the placement's dtype whatever the file's is.
  std::shared_ptr<Da3Backbone> load_backbone(const ParameterPlacement& placement = {}) const;
  std::shared_ptr<DptHead> load_dpt_head(const ParameterPlacement& placement = {}) const;
  std::shared_ptr<RgbDecoder> load_rgb_decoder(const ParameterPlacement& placement = {}) const;
  std::shared_ptr<DitDh> load_level1(const ParameterPlacement& placement = {}) const;
  std::shared_ptr<DitDh> load_cascade(const ParameterPlacement& placement = {}) const;
  // Of kStatisticsLevel0 or kStatisticsLevel1, with the bundle's epsilon; as many channels as the backbone's levels.
  LatentStatistics load_statistics(BundlePart part) const;

  // SHA-256 over the names and contents of model.yaml and the parts, 64 hexadecimal digits. Reads every file.
  std::string content_hash() const;

 private:
  ModelBundle() = default;
  std::shared_ptr<const WeightFile> open_part(BundlePart part) const;
  template <class Module, class Options>
  std::shared_ptr<Module> loaded(BundlePart part, const Options& options,
                                 const ParameterPlacement& placement) const;

  std::filesystem::path folder_;
  BundleOptions options_;
};

// Writes model.yaml; creates the folder. An existing bundle with other options is refused: its weights would no longer
// fit.
void save_bundle_options(const std::filesystem::path& folder, const BundleOptions& options);

// Writes one part into a bundle folder, floating-point tensors in `dtype`. The file is replaced whole or not at all.
void save_bundle_part(const std::filesystem::path& folder, BundlePart part,
                      const std::map<std::string, torch::Tensor>& tensors, DType dtype = DType::kFloat32);

}  // namespace gld
