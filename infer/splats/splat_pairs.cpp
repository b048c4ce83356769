#include "infer/splats/splat_pairs.h"

#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
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

SplattedScene splatted_scene(const Scene& scene, const ModelBundle& bundle, const SplatPairsOptions& options,
                             const KernelSettings& settings) {
  const LatentSplats splats = splat_latents(scene, bundle, options, settings);
  SplattedScene result;
  result.name = scene.name;
  result.tag = splats.levels.front().tag;
  result.cameras = splats.cameras;
  result.fitted = splats.fitted;
  result.pictures = (splats.images * 255).round().clamp(0, 255).to(torch::kUInt8);
  result.encoded = splats.encoded(0, 0, splats.views());
  result.splatted = splats.shown(0, settings);
  return result;
}

double error_of(const SplattedScene& scene) {
  return relative_latent_error(scene.splatted, scene.encoded.slice(0, scene.fitted));
}

void require_statistics(const ModelBundle& bundle, const std::string& where) {
  for (const BundlePart& part : bundle_parts(bundle.options())) {
    if (part.kind == BundlePart::Kind::kStatistics && bundle.has(part)) return;
  }
  fail(
      {where, "statistics of its latents, which are normalised by them", "none", "make them with gld stats"});
}

}  // namespace

SplatPairsOptions::SplatPairsOptions() {
  generator.frames = 35;
  generator.width = generator.height = 128;
  model = "configs/splat";
}

void SplatPairsOptions::visit(FieldVisitor& visitor) {
  visit_scenes(visitor, scenes, "generated ones");
  visitor.integer({"synthetic", "number of generated scenes"}, synthetic, {0, 1'000'000});
  visitor.integer({"synthetic_seed", "seed of the generated scenes"}, synthetic_seed, {0, 1'000'000'000'000});
  visitor.group({"generator", "generated scenes; seed and number come from the options above"}, generator);
  visit_out(visitor, out, overwrite);
  visitor.boolean({"resume", "go on with the run in the folder: scenes that are there stay"}, resume);
  LatentSplattingOptions::visit(visitor);
}

void SplatPairsOptions::check() const {
  LatentSplattingOptions::check();
  check_out(out, "runs/pairs");
  if (resume && overwrite) {
    fail({"--resume, --overwrite", "one of the two", "both",
          "--resume goes on with the run, --overwrite removes it"});
  }
  if (scenes.empty() && synthetic == 0) {
    fail({"gld splat pairs", "scenes", "none", "give --scenes DIR or --synthetic N"});
  }
}

void run_splat_pairs(const SplatPairsOptions& options) {
  options.check();
  const EarlierRun earlier = options.resume ? EarlierRun::kContinue : earlier_run(options.overwrite);
  check_run_folder(options.out, "splat pairs", earlier);
  KernelSettings settings;
  settings.threads = use_threads(options.threads);
  const ModelBundle bundle = ModelBundle::open(options.model);
  require_encoder_and_decoder(bundle, options.model);
  require_statistics(bundle, options.model);
  if (decoded_levels(bundle.options()).size() != 1) {
    fail({options.model, "a model whose pictures are decoded of one level, such as an autoencoder",
          fmt::format("one of {} levels", decoded_levels(bundle.options()).size()), "choose another model"});
  }
  const auto dataset =
      held_out_dataset(options.scenes, options.generator, options.synthetic_seed, options.synthetic);
  RunFolder run(options.out, "splat pairs", options, earlier);
  const auto folder = run.subfolder(kPairsFolder);
  Table table({"scene", "fitted_views", "held_out_views", "latent_error"});
  std::vector<double> errors;
  Progress progress("scenes", dataset->size());
  for (int64_t index = 0; index < dataset->size(); ++index) {
    stop_if_interrupted(
        fmt::format("{} of {} scenes are in {}; --resume goes on", index, dataset->size(), folder.string()));
    const auto file = folder / (dataset->scene_name(index) + ".safetensors");
    SplattedScene scene;
    if (options.resume && std::filesystem::is_regular_file(file)) {
      scene = read_splatted_scene(file);
      require_same_latent_space(scene.tag, bundle, file.string());
    } else {
      scene = splatted_scene(dataset->scene(index), bundle, options, settings);
      save_splatted_scene(file, scene);
    }
    errors.push_back(error_of(scene));
    table.add_row({scene.name, scene.fitted, scene.held_out(), errors.back()});
    progress.update(index + 1);
  }
  progress.finish();
  write_file_atomically(run.path() / "pairs.csv", table.csv());
  const SceneStatistics statistics = statistics_over_scenes(errors);
  run.write_report(
      {{"scenes", errors.size()},
       {"latent_error",
        {{"mean", statistics.mean}, {"interval_95", {statistics.interval.low, statistics.interval.high}}}},
       {"threads", settings.threads}});
  run.note("pairs", kPairsFolder);
  run.note("errors", "pairs.csv");
  run.note("report", "report.json");
  std::cout << run.closing_box();
}

}  // namespace gld
