#pragma once

#include "gld/files/dtype.h"
#include "gld/latents/level_statistics.h"
#include "models/blending/photograph_blending.h"
#include "models/bundle/bundle_options.h"
#include "models/depth_refinement/depth_refinement.h"
#include "models/dit/dit_dh.h"
#include "models/refiner/denoising_unet.h"
#include "models/weights/weight_loading.h"

#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// A file of a model bundle beside model.yaml. Each holds one module's tensors, under the module's own names, or a
// level's statistics.
struct BundlePart {
  enum class Kind {
    kBackbone,
    kGeometryHead,
    kRgbDecoder,
    kBlending,
    kDepthRefinement,
    kRefiner,
    kGenerator,
    kStatistics,
    kSpecialStatistics
  };
  Kind kind = Kind::kBackbone;
  LevelGenerator generator;  // of kGenerator
  int64_t level = 0;         // of kStatistics and kSpecialStatistics

  static BundlePart backbone() { return {}; }
  static BundlePart geometry_head() { return {Kind::kGeometryHead, {}, 0}; }
  static BundlePart rgb_decoder() { return {Kind::kRgbDecoder, {}, 0}; }
  static BundlePart blending() { return {Kind::kBlending, {}, 0}; }
  static BundlePart depth_refinement() { return {Kind::kDepthRefinement, {}, 0}; }
  static BundlePart refiner() { return {Kind::kRefiner, {}, 0}; }
  static BundlePart of(const LevelGenerator& generator) { return {Kind::kGenerator, generator, 0}; }
  static BundlePart statistics(int64_t level) { return {Kind::kStatistics, {}, level}; }
  // Returns the statistics of the special tokens that are generated in front of a level's patch tokens.
  static BundlePart special_statistics(int64_t level) { return {Kind::kSpecialStatistics, {}, level}; }

  bool operator==(const BundlePart& other) const {
    return kind == other.kind && generator == other.generator && level == other.level;
  }
};

// Returns the parts that a bundle with these options consists of.
std::vector<BundlePart> bundle_parts(const BundleOptions& options);
std::string bundle_part_name(const BundlePart& part);  // "level1"; the file is "level1.safetensors"

// Returns the module of a part, with uninitialised parameters; null for statistics.
std::shared_ptr<torch::nn::Module> make_bundle_module(const BundlePart& part, const BundleOptions& options,
                                                      const ParameterPlacement& placement);

// A model bundle on disk (DESIGN.md section 5): a folder with model.yaml and safetensors. Parts are loaded one by one,
// so that the weights of one stage are resident at a time; a part may be missing until it is asked for.
class ModelBundle {
 public:
  // Reads and checks model.yaml. Throws Error when the folder is no bundle.
  static ModelBundle open(const std::filesystem::path& folder);

  const std::filesystem::path& folder() const { return folder_; }
  const BundleOptions& options() const { return options_; }
  std::filesystem::path file(const BundlePart& part) const;
  bool has(const BundlePart& part) const;
  // Throws Error, with what to do, where the file of one of these parts is missing.
  void require(const std::vector<BundlePart>& parts) const;

  // Loads the part's file into a module that was built from these options; throws Error when the file is missing, with
  // what to do.
  LoadReport load_into(torch::nn::Module& module, const BundlePart& part) const;

  // Returns the bytes of the float32 numbers that loading makes of weights in another type; the others are read in
  // place, page by page. It is 0 for a part that is missing.
  int64_t converted_bytes(const BundlePart& part) const;

  // Returns the module with its weights, in the placement's dtype whatever the file's is; a geometry head with what
  // guesses its unit of one view (view_unit_file.h).
  std::shared_ptr<Backbone> load_backbone(const ParameterPlacement& placement = {}) const;
  std::shared_ptr<GeometryHead> load_geometry_head(const ParameterPlacement& placement = {}) const;
  std::shared_ptr<RgbDecoder> load_rgb_decoder(const ParameterPlacement& placement = {}) const;
  std::shared_ptr<PhotographBlending> load_blending(const ParameterPlacement& placement = {}) const;
  std::shared_ptr<DepthRefinement> load_depth_refinement(const ParameterPlacement& placement = {}) const;
  std::shared_ptr<DenoisingUnet> load_refiner(const ParameterPlacement& placement = {}) const;
  // Returns the RGB decoder, or the backbone's own half where that decodes images; the second function returns the part
  // that it is of.
  std::shared_ptr<ImageDecoder> load_image_decoder(const ParameterPlacement& placement = {}) const;
  BundlePart image_decoder_part() const;
  std::shared_ptr<DitDh> load_generator(const LevelGenerator& generator,
                                        const ParameterPlacement& placement = {}) const;
  // Loads the statistics of the latent that this generator makes, with the bundle's epsilon; throws Error unless there
  // are as many channels as the backbone's levels have. It loads those of special tokens too where it generates those.
  LevelStatistics load_statistics(const LevelGenerator& generator) const;

  // Returns the SHA-256 over the names and contents of model.yaml, the parts and what guesses the unit of a single
  // view, 64 hexadecimal digits. Reads every file.
  std::string content_hash() const;

 private:
  ModelBundle() = default;
  std::shared_ptr<const WeightFile> open_part(const BundlePart& part) const;
  template <class Module>
  std::shared_ptr<Module> loaded(std::shared_ptr<Module> module, const BundlePart& part) const;
  LatentStatistics read_statistics(const BundlePart& part) const;

  std::filesystem::path folder_;
  BundleOptions options_;
};

// Writes model.yaml; creates the folder. An existing bundle with other options is refused: its weights would no longer
// fit.
void save_bundle_options(const std::filesystem::path& folder, const BundleOptions& options);

// Writes one part into a bundle folder, floating-point tensors in `dtype`. The file is replaced whole or not at all.
void save_bundle_part(const std::filesystem::path& folder, const BundlePart& part,
                      const std::map<std::string, torch::Tensor>& tensors, DType dtype = DType::kFloat32);

}  // namespace gld
