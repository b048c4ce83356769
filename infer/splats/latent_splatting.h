#pragma once

#include "datasets/splats/scene_fit.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/metrics/metric.h"
#include "gld/splatting/feature_solve.h"
#include "models/bundle/bundle.h"
#include "models/splats/latent_fit.h"

#include <cstdint>
#include <string>
#include <vector>

#include <torch/types.h>

#include <nlohmann/json.hpp>

namespace gld {

// How the latents of a scene's views become features of Gaussians.
struct LatentSplattingOptions : OptionsGroup {
  std::string model = "configs/tiny";
  int64_t side = 256;       // pixels of a picture's longer side at most, in whole patches of the model
  int64_t held_out = 5;     // views that nothing is fitted to, evenly spread
  int64_t input_views = 0;  // of the others, evenly spread; 0: all
  int64_t seed = 0;         // of the order of views and of density control
  int64_t threads = 0;
  SplatFitOptions fit;
  FeatureSolveOptions solve;

  LatentSplattingOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Of commands that do so with many scenes and write a run folder.
struct ScenesSplattingOptions : LatentSplattingOptions {
  std::vector<std::string> scenes;
  int64_t synthetic = 8;       // drawn rooms where no scenes are given
  int64_t synthetic_seed = 0;  // theirs
  SyntheticOptions generator;
  std::string out;
  bool overwrite = false;

  ScenesSplattingOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Gaussians fitted to the views of a scene, and features of the levels that the bundle's image decoder takes. Views:
// fitted ones first.
struct LatentSplats {
  torch::Tensor images;  // (views, 3, height, width), RGB in [0, 1]
  torch::Tensor depth;   // (views, height, width), planar, 0 where unknown; undefined where a view has none
  SplatFit fit;
  std::vector<Camera> cameras;
  int64_t fitted = 0;
  ProjectionOptions projection;
  std::vector<LatentPictures> levels;
  std::vector<LatentFit> fits;  // one a level
  double seconds = 0;           // of fit and solve

  StillGaussians gaussians() const { return {fit.set, projection, cameras, fitted}; }
  int64_t views() const { return static_cast<int64_t>(cameras.size()); }
  std::vector<Camera> fitted_cameras() const { return {cameras.begin(), cameras.begin() + fitted}; }
  // Returns what the Gaussians show of the held-out views' latents of a level, normalised: (views - fitted, channels,
  // height, width).
  torch::Tensor shown(size_t level, const KernelSettings& settings) const;
  // Returns them as they are encoded, of views `first` to `end`.
  torch::Tensor encoded(size_t level, int64_t first, int64_t end) const;
  // Returns the held-out views as the Gaussians' colours show them, (views - fitted, 3, height, width), RGB in about
  // [0, 1].
  torch::Tensor colours(const KernelSettings& settings) const;
  // Returns what such pictures are encoded as, by backbones that see views together beside the fitted ones; normalised
  // as `levels` are, a tensor a level as `shown` has it.
  std::vector<torch::Tensor> encoded_colours(const torch::Tensor& colours,
                                             const LatentEncoding& encoding) const;
};

LatentSplats splat_latents(const Scene& scene, const LatentEncoding& encoding,
                           const LatentSplattingOptions& options, const KernelSettings& settings);

// Returns a mean over scenes as reports of these commands have it: "mean" and "interval_95".
nlohmann::ordered_json mean_json(const SceneStatistics& statistics);

// Throws Error where the bundle lacks the weights of a backbone or of what decodes images.
void require_encoder_and_decoder(const ModelBundle& bundle, const std::string& where);

}  // namespace gld
