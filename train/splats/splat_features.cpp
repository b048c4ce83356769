#include "train/splats/splat_features.h"

#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/tensors/compute_threads.h"
#include "models/splats/latent_fit.h"
#include "models/splats/splat_refiner.h"

#include <iostream>
#include <optional>
#include <utility>
#include <vector>

#include <fmt/format.h>

namespace gld {
namespace {

// Views of a scene as a model takes them, fitted ones first, and their latents.
struct EncodedViews {
  std::vector<Camera> cameras;
  int64_t fitted = 0;
  bool refined = false;  // the model has a refiner, which is given what these views are encoded as
  std::vector<LatentPictures> levels;
};
EncodedViews encoded_views(const SplatCommandOptions& options, const Scene& scene, const ModelBundle& bundle,
                           const KernelSettings& settings) {
  const ImageSize size = latent_image_size(bundle.options(), fit_size(scene, options.side));
  const SplatFitViews views = load_fit_views(scene, size, options.held_out, settings);
  EncodedViews result;
  result.fitted = static_cast<int64_t>(views.fitted.size());
  std::vector<torch::Tensor> images;
  for (const FittedView* view : all_views(views)) {
    result.cameras.push_back(view->camera);
    images.push_back(tensor_of(view->target.image));
  }
  result.refined = has_splat_refiner(bundle);
  result.levels = LatentEncoding(bundle)(torch::stack(images),
                                         latent_levels(options.features, bundle.options(), "--features"));
  return result;
}

void solve_features_of(const SplatCommandOptions& options, const FinishedSplatFit& fit,
                       const EncodedViews& views) {
  const StillGaussians gaussians{fit.set, fit.projection, views.cameras, views.fitted};
  const auto all = static_cast<int64_t>(views.cameras.size());
  std::vector<LatentFit> fits;
  nlohmann::ordered_json& report = fit.report["features"] = nlohmann::ordered_json::array();
  for (const LatentPictures& latents : views.levels) {
    stop_if_interrupted("features were being solved for; --resume goes on behind the fit");
    fits.push_back(fit_latents(gaussians, latents, options.solve, fit.settings));
    LatentFit& solved = fits.back();
    if (views.refined) solved.encoded = latents.views(0, gaussians.fitted);
    nlohmann::ordered_json row = tag_json(solved.tag);
    row["iterations"] = solved.iterations;
    row["residual"] = solved.residual;
    row["seconds"] = solved.seconds;
    row["fitted_error"] = latent_error(gaussians, solved, latents, 0, gaussians.fitted, fit.settings);
    std::string line =
        fmt::format("level {}: {} channels at {}x{} in {} iterations, error {:.3f} of the spread",
                    solved.tag.level, solved.tag.channels, solved.tag.width, solved.tag.height,
                    solved.iterations, row["fitted_error"].get<double>());
    if (all > views.fitted) {
      row["held_out_error"] = latent_error(gaussians, solved, latents, gaussians.fitted, all, fit.settings);
      line += fmt::format(", held-out views {:.3f}", row["held_out_error"].get<double>());
    }
    std::cout << line << "\n";
    report.push_back(std::move(row));
  }
  Provenance provenance = splat_provenance(fit.scene.name, options);
  save_latent_fits(fit.run.path() / kSplatFeaturesFile, fits, fit.run.path() / kSplatFile,
                   provenance_items(provenance));
  fit.run.note("features", kSplatFeaturesFile);
}

}  // namespace

void run_splat_fit_with_features(const SplatCommandOptions& options) {
  options.check();
  if (!options.has_features()) {
    run_splat_fit(options);
    return;
  }
  use_threads(options.threads);
  const ModelBundle bundle = ModelBundle::open(options.model);
  latent_levels(options.features, bundle.options(), "--features");
  if (!bundle.has(BundlePart::backbone())) {
    fail({options.model, "a backbone with weights", "none", "add it with gld convert or gld train"});
  }
  // Encoded once, before the fit where latents move the geometry, else after it.
  std::optional<EncodedViews> encoded;
  SplatFitLatents latents;
  latents.before = [&](const Scene& scene, SplatFitViews& views) {
    KernelSettings settings;
    settings.threads = static_cast<int>(threads_to_use(options.threads));
    encoded = encoded_views(options, scene, bundle, settings);
    give_latents(latent_views(encoded->levels, encoded->cameras), views);
  };
  latents.after = [&](const FinishedSplatFit& fit) {
    if (!encoded) encoded = encoded_views(options, fit.scene, bundle, fit.settings);
    solve_features_of(options, fit, *encoded);
  };
  run_splat_fit(options, latents);
}

}  // namespace gld
