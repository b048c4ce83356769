#include "infer/splats/splat_pairs.h"

#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/base/option_differences.h"
#include "gld/latents/relative_latent_error.h"
#include "gld/metrics/metric.h"
#include "gld/report/progress.h"
#include "gld/report/run_folder.h"
#include "gld/report/table.h"
#include "gld/tensors/compute_threads.h"
#include "infer/request/held_out_scenes.h"
#include "models/splats/splatted_scene.h"

#include <iostream>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr const char* kPairsFolder = "pairs";

SplattedScene splatted_scene(const Scene& scene, const LatentEncoding& encoding,
                             const SplatPairsOptions& options, const KernelSettings& settings) {
  const LatentSplats splats = splat_latents(scene, encoding, options, settings);
  SplattedScene result;
  result.name = scene.name;
  result.tag = splats.levels.front().tag;
  result.cameras = splats.cameras;
  result.fitted = splats.fitted;
  result.pictures = (splats.images * 255).round().clamp(0, 255).to(torch::kUInt8);
  result.encoded = splats.encoded(0, 0, splats.views());
  result.splatted = splats.shown(0, settings);
  result.colours = splats.encoded_colours(splats.colours(settings), encoding).front();
  return result;
}

double error_of(const torch::Tensor& latents, const SplattedScene& scene) {
  return relative_latent_error(latents, scene.encoded.slice(0, scene.fitted));
}

// A run that goes on cannot make a file again that it takes for its own.
SplattedScene kept_scene(const std::filesystem::path& file, bool resumed) {
  try {
    return read_splatted_scene(file);
  } catch (const Error& error) {
    if (!resumed) throw;
    ErrorParts parts = error.parts();
    parts.remedy = "delete the file and go on with --resume, or make all anew with --overwrite";
    fail(parts);
  }
}

}  // namespace

SplatPairsOptions::SplatPairsOptions() {
  synthetic = 400;
  generator.width = generator.height = 128;
  model = "configs/splat";
}

void SplatPairsOptions::visit(FieldVisitor& visitor) {
  visitor.boolean({"resume", "go on with the run in the folder: scenes that are there stay"}, resume);
  ScenesSplattingOptions::visit(visitor);
}

void SplatPairsOptions::check() const {
  ScenesSplattingOptions::check();
  if (resume && overwrite) {
    fail({"--resume, --overwrite", "one of the two", "both",
          "--resume goes on with the run, --overwrite removes it"});
  }
}

void run_splat_pairs(const SplatPairsOptions& options) {
  options.check();
  const EarlierRun earlier = options.resume ? EarlierRun::kContinue : earlier_run(options.overwrite);
  check_run_folder(options.out, "splat pairs", earlier);
  if (options.resume) refuse_other_options(options.out, options, SplatPairsOptions());
  KernelSettings settings;
  settings.threads = use_threads(options.threads);
  const ModelBundle bundle = ModelBundle::open(options.model);
  require_encoder_and_decoder(bundle, options.model);
  statistics_of_pictures(bundle, decoded_levels(bundle.options()).front());
  if (decoded_levels(bundle.options()).size() != 1) {
    fail({options.model, "a model whose pictures are decoded of one level, such as an autoencoder",
          fmt::format("one of {} levels", decoded_levels(bundle.options()).size()), "choose another model"});
  }
  const auto dataset =
      held_out_dataset(options.scenes, options.generator, options.synthetic_seed, options.synthetic);
  // Before an earlier run is removed.
  const LatentEncoding encoding(bundle);
  RunFolder run(options.out, "splat pairs", options, earlier);
  const auto folder = run.subfolder(kPairsFolder);
  Table table({"scene", "fitted_views", "held_out_views", "latent_error", "encoded_colours_error"});
  std::vector<double> errors, of_colours;
  int64_t made = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (options.resume && entry.path().extension() == ".safetensors") ++made;
  }
  Progress progress({"scenes", dataset->size(), made, run.path()});
  for (int64_t index = 0; index < dataset->size(); ++index) {
    stop_if_interrupted(
        fmt::format("{} of {} scenes are in {}; --resume goes on", index, dataset->size(), folder.string()));
    const Scene drawn = dataset->scene(index);
    // Names of scenes in several folders may be the same.
    const auto file = folder / fmt::format("{:06}_{}.safetensors", index, drawn.name);
    if (!options.resume || !std::filesystem::is_regular_file(file)) {
      save_splatted_scene(file, splatted_scene(drawn, encoding, options, settings));
      ++made;
    }
    const SplattedScene scene = kept_scene(file, options.resume);
    require_same_normalisation(scene.tag, bundle, file.string());
    errors.push_back(error_of(scene.splatted, scene));
    of_colours.push_back(error_of(scene.colours, scene));
    table.add_row({scene.name, scene.fitted, scene.held_out(), errors.back(), of_colours.back()});
    progress.update(made);
  }
  progress.finish();
  write_file_atomically(run.path() / "pairs.csv", table.csv());
  run.write_report({{"scenes", errors.size()},
                    {"latent_error", mean_json(statistics_over_scenes(errors))},
                    {"encoded_colours_error", mean_json(statistics_over_scenes(of_colours))},
                    {"threads", settings.threads}});
  run.note("pairs", kPairsFolder);
  run.note("errors", "pairs.csv");
  run.note("report", "report.json");
  std::cout << run.closing_box();
}

}  // namespace gld
