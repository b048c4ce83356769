#include "cli/splat_command.h"

#include "infer/splats/latent_render.h"
#include "infer/splats/splat_evaluation.h"
#include "infer/splats/splat_pairs.h"
#include "infer/splats/splat_spectrum.h"
#include "train/splats/splat_features.h"

namespace gld {
namespace {

Command make_fit_command() {
  auto options = std::make_shared<SplatCommandOptions>();
  Command command;
  command.name = "splat fit";
  command.summary = "Fit 3D Gaussians to the pictures of a scene, or to a run of gld sample";
  command.description =
      "Example: gld splat fit --scene my_scene --held-out 5 --out runs/splats\n"
      "It starts from depth, else from sparse points, else from what the pictures agree on; splats.ply opens in "
      "public viewers.";
  command.options = options;
  command.usual = {
      {"Scene", {"scene", "run", "side", "held_out"}},
      {"Fit",
       {"fit.steps", "fit.degree", "fit.density.most_gaussians", "checkpoint_every", "validate_every"}},
      {"Latents", {"features", "model", "fit.geometry_from"}}};
  command.run = [options](const std::vector<std::string>&) {
    run_splat_fit_with_features(*options);
    return 0;
  };
  return command;
}

Command make_render_command() {
  auto options = std::make_shared<SplatRenderOptions>();
  Command command;
  command.name = "splat render";
  command.summary = "Draw 3D Gaussians along a path of cameras";
  command.description =
      "Example: gld splat render --splats runs/splats --path orbit --frames 60 --out runs/orbit";
  command.options = options;
  command.run = [options](const std::vector<std::string>&) {
    run_splat_render_with_latents(*options);
    return 0;
  };
  return command;
}

Command make_spectrum_command() {
  auto options = std::make_shared<SplatSpectrumOptions>();
  Command command;
  command.name = "splat spectrum";
  command.summary = "Measure what splatting leaves of the frequencies of latent spaces";
  command.description =
      "Example: gld splat spectrum --scenes rooms/scenes --models configs/tiny bundles/taef2 --out runs/spectrum\n"
      "Latents that are the same from everywhere keep theirs, as a texture fixed in the world does (the control).";
  command.options = options;
  command.run = [options](const std::vector<std::string>&) {
    run_splat_spectrum(*options);
    return 0;
  };
  return command;
}

Command make_evaluation_command() {
  auto options = std::make_shared<SplatEvaluationOptions>();
  Command command;
  command.name = "splat eval";
  command.summary = "Measure what Gaussians show of views that they were not fitted to";
  command.description =
      "Example: gld splat eval --synthetic 8 --input-views 5 --model bundles/taef2 --out runs/splat_eval\n"
      "In colours, and in a model's latents that its decoder turns into pictures, beside what decoding alone loses.";
  command.options = options;
  command.usual = {{"Scenes", {"scenes", "synthetic", "synthetic_seed", "held_out", "input_views"}},
                   {"Fit", {"model", "fit.steps", "fit.geometry_from", "fit.density.most_gaussians"}}};
  command.run = [options](const std::vector<std::string>&) {
    run_splat_evaluation(*options);
    return 0;
  };
  return command;
}

Command make_pairs_command() {
  auto options = std::make_shared<SplatPairsOptions>();
  Command command;
  command.name = "splat pairs";
  command.summary = "What Gaussians show of views that nothing is fitted to, for gld train refiner";
  command.description =
      "Example: gld splat pairs --synthetic 400 --input-views 30 --model configs/splat --out runs/pairs\n"
      "A file a scene: latents as features of Gaussians show them and as their colours do, encoded, beside those of the\n"
      "truth, and the views around them.";
  command.options = options;
  command.usual = {{"Scenes", {"scenes", "synthetic", "synthetic_seed", "held_out", "input_views"}},
                   {"Fit", {"model", "side", "fit.steps", "fit.density.most_gaussians"}}};
  command.run = [options](const std::vector<std::string>&) {
    run_splat_pairs(*options);
    return 0;
  };
  return command;
}

}  // namespace

Command make_splat_command() {
  Command command;
  command.name = "splat";
  command.summary = "3D Gaussians of a scene: fit them, draw them, see latents by them";
  command.subcommands = {make_fit_command(), make_render_command(), make_evaluation_command(),
                         make_spectrum_command(), make_pairs_command()};
  return command;
}

}  // namespace gld
