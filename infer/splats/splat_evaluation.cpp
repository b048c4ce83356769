#include "infer/splats/splat_evaluation.h"

#include "datasets/loading/batching.h"
#include "datasets/splats/splat_picture.h"
#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/cameras/relative_cameras.h"
#include "gld/machine/timing.h"
#include "gld/metrics/image_metrics.h"
#include "gld/metrics/metric.h"
#include "gld/report/progress.h"
#include "gld/report/run_folder.h"
#include "gld/report/table.h"
#include "gld/tensors/compute_threads.h"
#include "infer/export/image_export.h"
#include "infer/request/held_out_scenes.h"
#include "models/bundle/bundle.h"
#include "models/splats/latent_fit.h"

#include <iostream>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

// As many of them as asked for, evenly spread; the first and the last stay.
template <class View>
void thin_out(std::vector<View>& views, int64_t wanted) {
  const auto count = static_cast<int64_t>(views.size());
  if (wanted == 0 || wanted >= count) return;
  std::vector<View> kept;
  for (int64_t i = 0; i < wanted; ++i) {
    const int64_t from = wanted == 1 ? count / 2 : (i * (count - 1) + (wanted - 1) / 2) / (wanted - 1);
    kept.push_back(std::move(views[static_cast<size_t>(from)]));
  }
  views = std::move(kept);
}

// All views, fitted ones first: (views, 3, height, width), their cameras, and latents of the levels that are decoded.
struct EncodedScene {
  torch::Tensor images;
  StillGaussians gaussians;
  std::vector<LatentPictures> levels;
};

EncodedScene encoded_scene(const SplatFitViews& views, const ModelBundle& bundle, const GaussianSet& set) {
  EncodedScene scene{{}, {set, {}, {}, static_cast<int64_t>(views.fitted.size())}, {}};
  std::vector<torch::Tensor> images;
  for (const FittedView* view : all_views(views)) {
    images.push_back(tensor_of(view->target.image));
    scene.gaussians.cameras.push_back(view->camera);
  }
  scene.images = torch::stack(images);
  scene.levels = encode_latent_pictures(bundle, scene.images, decoded_levels(bundle.options()));
  return scene;
}

// Pictures of held-out views, each (views, 3, height, width).
struct HeldOutPictures {
  torch::Tensor truth, rgb, decoded, autoencoded, nearest;
};

HeldOutPictures held_out_pictures(const EncodedScene& scene, const std::vector<LatentFit>& fits,
                                  const ModelBundle& bundle, const KernelSettings& settings) {
  const StillGaussians& gaussians = scene.gaussians;
  HeldOutPictures pictures;
  pictures.truth = scene.images.slice(0, gaussians.fitted);
  Views cameras;
  cameras.cameras = gaussians.cameras;
  cameras.num_sources = gaussians.fitted;
  std::vector<torch::Tensor> rgb, nearest;
  for (int64_t view = gaussians.fitted; view < cameras.size(); ++view) {
    const Camera& camera = gaussians.cameras[static_cast<size_t>(view)];
    rgb.push_back(tensor_of(splat_picture(gaussians.set, camera, gaussians.projection, settings).image));
    nearest.push_back(scene.images[nearest_source(cameras, view)]);
  }
  pictures.rgb = torch::stack(rgb);
  pictures.nearest = torch::stack(nearest);
  std::vector<torch::Tensor> shown, encoded;
  for (size_t level = 0; level < fits.size(); ++level) {
    const LatentPictures& latents = scene.levels[level];
    std::vector<torch::Tensor> of_gaussians, of_encoder;
    for (int64_t view = gaussians.fitted; view < cameras.size(); ++view) {
      const auto number = static_cast<size_t>(view);
      of_encoder.push_back(latents.raw(latents.pictures[number]));
      of_gaussians.push_back(latents.raw(rendered_features(
          gaussians, fits[level].features, latents.camera_of(gaussians.cameras[number]), settings)));
    }
    shown.push_back(torch::stack(of_gaussians));
    encoded.push_back(torch::stack(of_encoder));
  }
  pictures.decoded = decode_latent_maps(bundle, shown);
  pictures.autoencoded = decode_latent_maps(bundle, encoded);
  return pictures;
}

double mean_psnr(const torch::Tensor& truth, const torch::Tensor& pictures) {
  return psnr(truth, pictures).mean().item<double>();
}
double mean_ssim(const torch::Tensor& truth, const torch::Tensor& pictures) {
  return ssim(truth, pictures).mean().item<double>();
}

struct EvaluatedScene {
  SplatScores scores;
  HeldOutPictures pictures;
};

EvaluatedScene evaluated(const Scene& scene, const ModelBundle& bundle, const SplatEvaluationOptions& options,
                         const KernelSettings& settings) {
  const ImageSize size = latent_image_size(bundle.options(), fit_size(scene, options.side));
  SplatFitViews views = load_fit_views(scene, size, options.held_out, settings);
  thin_out(views.fitted, options.input_views);
  thin_out(views.pictures, options.input_views);
  SplatFitOptions fit_options = options.fit;
  SplatFit fit;
  EncodedScene encoded = encoded_scene(views, bundle, fit.set);
  give_latents(latent_views(encoded.levels, encoded.gaussians.cameras), views);
  EvaluatedScene result;
  SplatScores& scores = result.scores;
  scores.scene = scene.name;
  std::vector<LatentFit> fits;
  scores.seconds = seconds_of([&] {
    fit = begin_splat_fit(views.pictures, scene.points_in_world, fit_options, scene.name);
    begin_features(views.fitted, fit_options, settings, fit);
    while (fit.step < fit_options.steps) {
      stop_if_interrupted("in the fit of " + scene.name);
      splat_fit_step(views.fitted, fit_options, static_cast<uint64_t>(options.seed), settings, fit);
    }
    encoded.gaussians.projection = fit_options.projection;
    for (const LatentPictures& latents : encoded.levels)
      fits.push_back(fit_latents(encoded.gaussians, latents, options.solve, settings));
  });
  scores.gaussians = fit.set.size();
  const auto all = static_cast<int64_t>(encoded.gaussians.cameras.size());
  for (size_t level = 0; level < fits.size(); ++level) {
    scores.latent_error += latent_error(encoded.gaussians, fits[level], encoded.levels[level],
                                        encoded.gaussians.fitted, all, settings) /
                           static_cast<double>(fits.size());
  }
  result.pictures = held_out_pictures(encoded, fits, bundle, settings);
  const HeldOutPictures& pictures = result.pictures;
  scores.rgb_psnr = mean_psnr(pictures.truth, pictures.rgb);
  scores.rgb_ssim = mean_ssim(pictures.truth, pictures.rgb);
  scores.decoded_psnr = mean_psnr(pictures.truth, pictures.decoded);
  scores.decoded_ssim = mean_ssim(pictures.truth, pictures.decoded);
  scores.autoencoded_psnr = mean_psnr(pictures.truth, pictures.autoencoded);
  scores.autoencoded_ssim = mean_ssim(pictures.truth, pictures.autoencoded);
  scores.nearest_psnr = mean_psnr(pictures.truth, pictures.nearest);
  scores.nearest_ssim = mean_ssim(pictures.truth, pictures.nearest);
  return result;
}

// A column of eval.csv and a row of splat_eval.md.
struct ScoreColumn {
  const char* name;
  const char* says;
  double SplatScores::*value;
};
const std::vector<ScoreColumn>& score_columns() {
  static const std::vector<ScoreColumn> columns{
      {"rgb_psnr", "the Gaussians' colours, PSNR in dB", &SplatScores::rgb_psnr},
      {"decoded_psnr", "splatted latents, decoded, PSNR in dB", &SplatScores::decoded_psnr},
      {"autoencoded_psnr", "encoded latents, decoded: what can be reached, PSNR in dB",
       &SplatScores::autoencoded_psnr},
      {"nearest_psnr", "the nearest input view, PSNR in dB", &SplatScores::nearest_psnr},
      {"rgb_ssim", "the Gaussians' colours, SSIM", &SplatScores::rgb_ssim},
      {"decoded_ssim", "splatted latents, decoded, SSIM", &SplatScores::decoded_ssim},
      {"autoencoded_ssim", "encoded latents, decoded, SSIM", &SplatScores::autoencoded_ssim},
      {"nearest_ssim", "the nearest input view, SSIM", &SplatScores::nearest_ssim},
      {"latent_error", "splatted latents, distance from what is encoded over its spread",
       &SplatScores::latent_error},
      {"seconds", "of fit and solve", &SplatScores::seconds}};
  return columns;
}

Table scene_table(const std::vector<SplatScores>& scenes) {
  std::vector<std::string> names{"scene", "gaussians"};
  for (const ScoreColumn& column : score_columns()) names.emplace_back(column.name);
  Table table(names);
  for (const SplatScores& scene : scenes) {
    std::vector<TableCell> row{scene.scene, scene.gaussians};
    for (const ScoreColumn& column : score_columns()) row.emplace_back(scene.*column.value);
    table.add_row(row);
  }
  return table;
}

// The first held-out view: truth, colours, decoded latents, what decoding alone loses.
void write_pictures(const RunFolder& run, const EvaluatedScene& scene, const Provenance& provenance) {
  const HeldOutPictures& pictures = scene.pictures;
  const auto sheet = torch::cat({pictures.truth[0], pictures.rgb[0], pictures.decoded[0].clamp(0, 1),
                                 pictures.autoencoded[0].clamp(0, 1)},
                                2);
  export_image(run.subfolder("pictures") / (scene.scores.scene + ".png"), to_image(sheet), provenance);
}

}  // namespace

SplatEvaluationOptions::SplatEvaluationOptions() {
  fit.density.most_gaussians = 30000;
  fit.steps = 1000;
  generator.frames = 35;
  generator.width = generator.height = 256;
}

void SplatEvaluationOptions::visit(FieldVisitor& visitor) {
  visit_scenes(visitor, scenes, "generated ones");
  visitor.integer({"synthetic", "number of generated scenes"}, synthetic, {0, 1'000'000});
  visitor.integer({"synthetic_seed", "seed of the generated scenes"}, synthetic_seed, {0, 1'000'000'000'000});
  visitor.group({"generator", "generated scenes; seed and number come from the options above"}, generator);
  visitor.text({"model", "the model bundle whose latents are splatted and decoded"}, model);
  visit_out(visitor, out, overwrite);
  visit_side(visitor, side);
  visitor.integer({"held_out", "views that are not fitted but compared with, evenly spread over the scene"},
                  held_out, {1, 100000});
  visitor.integer({"input_views", "of the others so many are fitted, evenly spread; 0: all"}, input_views,
                  {0, 100000});
  visit_seed(visitor, seed, "the order of views and what density control draws");
  visit_threads(visitor, threads);
  visitor.group({"fit", "how Gaussians are fitted"}, fit);
  visitor.group({"solve", "how features are solved for"}, solve);
}

void SplatEvaluationOptions::check() const {
  check_out(out, "runs/splat_eval");
  if (scenes.empty() && synthetic == 0) {
    fail({"gld splat eval", "scenes", "none", "give --scenes DIR or --synthetic N"});
  }
  fit.check();
}

void run_splat_evaluation(const SplatEvaluationOptions& options) {
  options.check();
  check_run_folder(options.out, "splat eval", earlier_run(options.overwrite));
  KernelSettings settings;
  settings.threads = use_threads(options.threads);
  const ModelBundle bundle = ModelBundle::open(options.model);
  for (const BundlePart& part : {BundlePart::backbone(), bundle.image_decoder_part()}) {
    if (bundle.has(part)) continue;
    fail({options.model, "a " + bundle_part_name(part) + " with weights", "none",
          "add it with gld convert or gld train"});
  }
  const auto dataset =
      held_out_dataset(options.scenes, options.generator, options.synthetic_seed, options.synthetic);
  RunFolder run(options.out, "splat eval", options, earlier_run(options.overwrite));
  const Provenance provenance = make_provenance("splat eval", options);
  std::vector<SplatScores> scenes;
  Progress progress("scenes", dataset->size());
  for (int64_t index = 0; index < dataset->size(); ++index) {
    stop_if_interrupted(fmt::format("{} of {} scenes were done", index, dataset->size()));
    const EvaluatedScene scene = evaluated(dataset->scene(index), bundle, options, settings);
    write_pictures(run, scene, provenance);
    scenes.push_back(scene.scores);
    progress.update(index + 1);
  }
  progress.finish();
  nlohmann::ordered_json report;
  report["scenes"] = scenes.size();
  report["threads"] = settings.threads;
  Table means({"what", "mean", "low", "high"});
  for (const ScoreColumn& column : score_columns()) {
    std::vector<double> values;
    values.reserve(scenes.size());
    for (const SplatScores& scene : scenes) values.push_back(scene.*column.value);
    const SceneStatistics statistics = statistics_over_scenes(values);
    const Interval& interval = statistics.interval;
    report["means"][column.name] = {{"mean", statistics.mean},
                                    {"interval_95", {interval.low, interval.high}}};
    means.add_row({std::string(column.says), statistics.mean, interval.low, interval.high});
  }
  const std::string text = fmt::format(
      "# Splats against views that they were not fitted to\n\n{} scene{}, {} held-out views of each; means over scenes, "
      "low and high: 95 % by bootstrap over scenes.\n\n{}",
      scenes.size(), scenes.size() == 1 ? "" : "s", options.held_out, means.markdown());
  write_file_atomically(run.path() / "eval.csv", scene_table(scenes).csv());
  write_file_atomically(run.path() / "splat_eval.md", text);
  run.write_report(report);
  std::cout << text;
  run.note("scores", "eval.csv");
  run.note("pictures", "pictures/");
  run.note("report", "report.json");
  std::cout << run.closing_box();
}

}  // namespace gld
