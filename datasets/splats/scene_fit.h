#pragma once

#include "datasets/scenes/scene.h"
#include "datasets/splats/splat_cost.h"
#include "datasets/splats/splat_fit.h"
#include "gld/cameras/image_size.h"
#include "gld/report/provenance.h"
#include "gld/splatting/splat_ply.h"

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace gld {

// All that the Gaussians of a scene depend on beside its pictures, depth and cameras.
struct SceneFitOptions : OptionsGroup {
  int64_t side = 512;    // pixels of a picture's longer side at most
  int64_t held_out = 0;  // views that are kept apart
  int64_t seed = 0;      // of the order of views and of density control
  SplatFitOptions fit;

  void visit(FieldVisitor& visitor) override;
};
// Visits one of its fields, which commands have in groups of their own.
void visit_side(FieldVisitor& visitor, int64_t& side);

// The views of a scene as a fit takes them.
struct SplatFitViews {
  std::vector<SplatPicture> pictures;  // of those that are fitted, for the start
  std::vector<FittedView> fitted, held_out;
  std::vector<DepthMap> held_out_depth;  // one for each of held_out, empty where it is not known
};
// Returns what load_fit_views() will give to a fit of such options, without reading a picture.
SplatWork scene_fit_work(const Scene& scene, const ImageSize& size, int64_t held_out,
                         const SplatFitOptions& options);
// Loads frames with pictures, resized and cropped to that size; held_out of them, evenly spread between the first and
// the last, are kept apart. Throws Error where fewer than one is left to be fitted.
SplatFitViews load_fit_views(const Scene& scene, const ImageSize& size, int64_t held_out,
                             const KernelSettings& settings);
// Returns them with the fitted views first.
std::vector<const FittedView*> all_views(const SplatFitViews& views);
// Gives every view its latent, fitted views first, as many as there are views.
void give_latents(std::vector<LatentView> latents, SplatFitViews& views);
// Returns the size of the first one's aspect with at most `side` pixels. Throws Error where no frame has a picture.
ImageSize fit_size(const Scene& scene, int64_t side);

// Returns mean squared errors of the views' pictures as dB, one a view.
std::vector<double> view_decibels(const std::vector<FittedView>& views, const GaussianSet& set,
                                  const ProjectionOptions& projection, const KernelSettings& settings);

// Returns what a PLY file of the fit says of its origin: the scene's name and the options, and nothing of the command
// that asked for it, so that the same fit gives the same bytes.
Provenance splat_provenance(const std::string& scene_name, const SceneFitOptions& options);

struct SceneFit {
  SplatFit fit;
  int64_t started_with = 0;  // Gaussians
  int64_t views = 0;
  double near = 0;         // that was drawn with
  double fitted_psnr = 0;  // dB, mean over the views
};
// Does all steps of a fit in one go: what gld splat fit does in parts, with the same result. after_step is called after
// each of them. where is the scene's name in errors.
SceneFit fit_scene(const Scene& scene, const SceneFitOptions& options, const std::string& where,
                   const KernelSettings& settings,
                   const std::function<void(const SplatFitStep&)>& after_step);

// Writes splats.ply of such a fit.
void write_fitted_splats(const std::filesystem::path& file, const GaussianSet& set,
                         const std::string& scene_name, const SceneFitOptions& options);

}  // namespace gld
