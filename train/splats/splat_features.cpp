#include "train/splats/splat_features.h"

#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/tensors/compute_threads.h"
#include "models/splats/latent_fit.h"

#include <iostream>
#include <utility>
#include <vector>

#include <fmt/format.h>

namespace gld {
namespace {

void solve_features_of(const SplatCommandOptions& options, const FinishedSplatFit& fit,
                       const ModelBundle& bundle) {
  const ImageSize size = latent_image_size(bundle.options(), fit_size(fit.scene, options.side));
  const SplatFitViews views = load_fit_views(fit.scene, size, options.held_out, fit.settings);
  StillGaussians gaussians{fit.set, fit.projection, {}, static_cast<int64_t>(views.fitted.size())};
  std::vector<torch::Tensor> images;
  for (const auto* some : {&views.fitted, &views.held_out}) {
    for (const FittedView& view : *some) {
      gaussians.cameras.push_back(view.camera);
      images.push_back(tensor_of(view.target.image));
    }
  }
  const auto levels = latent_levels(options.features, bundle.options(), "--features");
  std::vector<LatentFit> fits;
  nlohmann::ordered_json& report = fit.report["features"] = nlohmann::ordered_json::array();
  for (const LatentPictures& latents : encode_latent_pictures(bundle, torch::stack(images), levels)) {
    fits.push_back(fit_latents(gaussians, latents, options.solve, fit.settings));
    const LatentFit& solved = fits.back();
    nlohmann::ordered_json row = tag_json(solved.tag);
    row["iterations"] = solved.iterations;
    row["residual"] = solved.residual;
    row["seconds"] = solved.seconds;
    row["fitted_error"] = latent_error(gaussians, solved, latents, 0, gaussians.fitted, fit.settings);
    std::string line =
        fmt::format("level {}: {} channels at {}x{} in {} iterations, error {:.3f} of the spread",
                    solved.tag.level, solved.tag.channels, solved.tag.width, solved.tag.height,
                    solved.iterations, row["fitted_error"].get<double>());
    if (!views.held_out.empty()) {
      row["held_out_error"] = latent_error(gaussians, solved, latents, gaussians.fitted,
                                           static_cast<int64_t>(images.size()), fit.settings);
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
  run_splat_fit(options, [&](const FinishedSplatFit& fit) { solve_features_of(options, fit, bundle); });
}

}  // namespace gld
