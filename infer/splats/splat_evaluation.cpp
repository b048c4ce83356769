#include "infer/splats/splat_evaluation.h"

#include "datasets/loading/batching.h"
#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/cameras/relative_cameras.h"
#include "gld/latents/relative_latent_error.h"
#include "gld/machine/timing.h"
#include "gld/metrics/latent_spectrum.h"
#include "gld/metrics/metric.h"
#include "gld/metrics/metric_list.h"
#include "gld/report/distinct_names.h"
#include "gld/report/progress.h"
#include "gld/report/report_text.h"
#include "gld/report/run_folder.h"
#include "gld/report/table.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/tensor_pictures.h"
#include "infer/export/image_export.h"
#include "infer/request/held_out_scenes.h"
#include "models/bundle/bundle.h"
#include "models/bundle/part_lineage.h"
#include "models/refiner/latent_refining.h"
#include "models/scene_geometry/composed_views.h"
#include "models/scene_geometry/photograph_depth.h"
#include "models/splats/splat_refiner.h"

#include <algorithm>
#include <iostream>
#include <memory>
#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <torch/autograd.h>

#include <fmt/format.h>

namespace gld {
namespace {

// What looks at pictures, to tell how alike a place is in two views.
struct PlaceFeatures {
  std::shared_ptr<const Backbone> backbone;
  BundleOptions options;

  // Pictures are resized to whole patches: features cover them evenly whatever their size is.
  torch::Tensor operator()(const torch::Tensor& pictures) const {
    const torch::NoGradGuard no_grad;
    const ImageSize size = latent_image_size(options, {pictures.size(3), pictures.size(2)});
    return backbone->features_of_each(
        torch::upsample_bilinear2d(pictures, {size.height, size.width}, /*align_corners=*/false));
  }
};

// What encodes, decodes and, where the model can, repairs; read once for all scenes.
struct EvaluatedModel {
  LatentEncoding encoding;
  LatentDecoding decoding;
  std::shared_ptr<const DenoisingUnet> refiner;  // null: nothing does
  std::optional<PlaceFeatures> places;

  bool repairs_colours() const { return refiner->options().degraded == DegradedLatents::kColours; }
};

// One way to show the held-out views.
struct ShownViews {
  std::string name, says;  // "rgb", "the Gaussians' colours"
  std::vector<torch::Tensor>
      latents;             // normalised, (views, channels, height, width) a level; none of pictures
  torch::Tensor pictures;  // (views, 3, height, width)
};

// A column of eval.csv and a row of splat_eval.md, and its mean over the held-out views of a scene.
struct Score {
  std::string name, says;
  double value = 0;
};

struct EvaluatedScene {
  std::string name;
  int64_t gaussians = 0;
  std::vector<Score> scores;
  torch::Tensor sheet;  // (3, height, width): the first held-out view
};

// Returns what the refiner makes of degraded latents, and the seconds that a view took.
std::pair<torch::Tensor, double> refined_views(const LatentSplats& splats, const torch::Tensor& degraded,
                                               const DenoisingUnet& refiner) {
  const LatentRefining refining(refiner, splats.fitted_cameras(), splats.encoded(0, 0, splats.fitted));
  std::vector<torch::Tensor> refined;
  const double seconds = seconds_of([&] {
    for (int64_t view = splats.fitted; view < splats.views(); ++view) {
      refined.push_back(refining(splats.cameras[static_cast<size_t>(view)], degraded[view - splats.fitted]));
    }
  });
  return {torch::stack(refined), seconds / static_cast<double>(refined.size())};
}

torch::Tensor decoded(const std::vector<torch::Tensor>& latents, const LatentSplats& splats,
                      const LatentDecoding& decoding) {
  std::vector<torch::Tensor> maps;
  for (size_t level = 0; level < latents.size(); ++level)
    maps.push_back(raw_latents(latents[level], splats.levels[level].statistics));
  return decoding(maps);
}

torch::Tensor nearest_views(const LatentSplats& splats) {
  Views cameras;
  cameras.cameras = splats.cameras;
  cameras.num_sources = splats.fitted;
  std::vector<torch::Tensor> nearest;
  for (int64_t view = splats.fitted; view < cameras.size(); ++view)
    nearest.push_back(splats.images[nearest_source(cameras, view)]);
  return torch::stack(nearest);
}

// Returns the held-out views as the fitted ones say, carried by the scene's own depth, with gaps filled: the rival of
// whatever is made of the same views and depth. Undefined where a view has no depth.
torch::Tensor views_carried_by_depth(const LatentSplats& splats) {
  if (!splats.depth.defined()) return {};
  Views views;
  views.cameras = splats.cameras;
  views.num_sources = splats.fitted;
  std::vector<PlanarDepth> depth;
  for (int64_t view = 0; view < splats.fitted; ++view)
    depth.push_back({splats.depth.size(2), splats.depth.size(1), numbers_of(splats.depth[view])});
  const torch::Tensor images = splats.images.slice(0, 0, splats.fitted);
  return filled_views(views, photographs_of_images(views, images), depth_of_scene(std::move(depth))).images;
}

// Returns |latents - encoded| over |encoded - its mean|, as a mean over levels.
double mean_error(const std::vector<torch::Tensor>& latents, const std::vector<torch::Tensor>& encoded) {
  double sum = 0;
  for (size_t level = 0; level < latents.size(); ++level)
    sum += relative_latent_error(latents[level], encoded[level]);
  return sum / static_cast<double>(latents.size());
}

// Returns the energy of the high frequencies of the first level's raw latents over that of the encoded ones
// (gld/metrics/latent_spectrum.h); none where they are not square, or too small.
std::optional<double> high_band(const torch::Tensor& latents, const torch::Tensor& encoded,
                                const LatentPictures& of) {
  const int64_t side = encoded.size(2);
  if (encoded.size(3) != side || side < 8) return std::nullopt;
  const int64_t last = last_whole_ring(side);
  const auto amplitudes = [&](const torch::Tensor& views) {
    return ring_amplitudes(raw_latents(views, of.statistics), last, SpectrumWindow::kHann);
  };
  return band_ratio(amplitudes(latents), amplitudes(encoded), side / 4, last);
}

// Adds the metrics of pictures against the true ones.
void score_pictures(const std::vector<ShownViews>& shown, const torch::Tensor& truth,
                    std::vector<Score>& scores) {
  struct PictureMetric {
    const char* name;
    const char* says;
  };
  constexpr PictureMetric kMetrics[] = {{"psnr", "PSNR in dB"},
                                        {"ssim", "SSIM"},
                                        {"sharpness", "sharpness of the truth's"},
                                        {"random_features", "distance of random features from the truth"}};
  for (const PictureMetric& metric : kMetrics) {
    for (const ShownViews& views : shown) {
      scores.push_back({views.name + "_" + metric.name, views.says + ", " + metric.says,
                        measure_images(metric_named(metric.name), truth, views.pictures).mean()});
    }
  }
}

// Adds those of latents against the encoded ones. Columns of splatted latents have no prefix.
void score_latents(const std::vector<ShownViews>& shown, const ShownViews& encoded,
                   const LatentSplats& splats, std::vector<Score>& scores) {
  const auto scored = [&](const ShownViews& views) {
    return !views.latents.empty() && views.name != encoded.name;
  };
  for (const ShownViews& views : shown) {
    if (!scored(views)) continue;
    scores.push_back({views.name == "decoded" ? "latent_error" : views.name + "_error",
                      views.says + ": distance of latents from what is encoded over its spread",
                      mean_error(views.latents, encoded.latents)});
  }
  for (const ShownViews& views : shown) {
    if (!scored(views)) continue;
    const auto band = high_band(views.latents.front(), encoded.latents.front(), splats.levels.front());
    if (!band) continue;
    scores.push_back({views.name == "decoded" ? "high_band" : views.name + "_high_band",
                      views.says + ": high frequencies of latents over those of the encoded ones", *band});
  }
}

// Adds how unlike places look in held-out views and in the view nearest to each, nearly always a fitted one, which is a
// true picture: met3r_like_true_geometry (gld/metrics/feature_consistency.h).
void score_places(const std::vector<ShownViews>& shown, const LatentSplats& splats,
                  const PlaceFeatures& places, std::vector<Score>& scores) {
  const Metric metric = metric_named("met3r_like_true_geometry");
  MetricInputs inputs;
  inputs.views.cameras = splats.cameras;
  inputs.views.num_sources = splats.fitted;
  inputs.all_true_depth = splats.depth;
  const auto fitted = places(splats.images.slice(0, 0, splats.fitted));
  const auto score = [&](const std::string& name, const std::string& says, const torch::Tensor& pictures) {
    inputs.view_features = torch::cat({fitted, places(pictures.clamp(0, 1))});
    scores.push_back({name + "_met3r_like", says + ", one place in two views: distance of features",
                      measure(metric, inputs).mean()});
  };
  score("true", "the truth", splats.images.slice(0, splats.fitted));
  for (const ShownViews& views : shown) score(views.name, views.says, views.pictures);
}

void require_depth(const Scene& scene) {
  for (const Frame& frame : scene.frames) {
    if (frame.has_image() && !frame.has_depth()) {
      fail({"--consistency-model", "scenes with depth in every view",
            fmt::format("none in view {} of {}", frame.name, scene.name),
            "leave it out, or measure scenes with depth"});
    }
  }
}

EvaluatedScene evaluated(const Scene& scene, const EvaluatedModel& model,
                         const SplatEvaluationOptions& options, const KernelSettings& settings) {
  if (model.places) require_depth(scene);
  const LatentSplats splats = splat_latents(scene, model.encoding, options, settings);
  ShownViews rgb{"rgb", "the Gaussians' colours", {}, splats.colours(settings)};
  ShownViews splatted{"decoded", "splatted latents, decoded", {}, {}};
  ShownViews colours{"encoded_colours",
                     "the Gaussians' colours, encoded and decoded",
                     splats.encoded_colours(rgb.pictures, model.encoding),
                     {}};
  ShownViews encoded{"autoencoded", "encoded latents, decoded: what can be reached", {}, {}};
  for (size_t level = 0; level < splats.fits.size(); ++level) {
    encoded.latents.push_back(splats.encoded(level, splats.fitted, splats.views()));
    splatted.latents.push_back(splats.shown(level, settings));
  }
  std::vector<ShownViews> shown = {rgb, splatted};
  double refined_seconds = 0;
  if (model.refiner) {
    const auto& degraded = (model.repairs_colours() ? colours : splatted).latents.front();
    ShownViews refined{"refined", "what the refiner makes of its input, decoded", {}, {}};
    refined.latents.resize(1);
    std::tie(refined.latents.front(), refined_seconds) = refined_views(splats, degraded, *model.refiner);
    shown.push_back(refined);
  }
  shown.insert(shown.end(), {colours, encoded});
  const ShownViews carried{
      "carried", "the input views carried by their depth, gaps filled", {}, views_carried_by_depth(splats)};
  if (carried.pictures.defined()) {
    shown.push_back(carried);
    shown.push_back({"encoded_carried",
                     "the input views carried, encoded and decoded",
                     splats.encoded_colours(carried.pictures, model.encoding),
                     {}});
  }
  std::vector<torch::Tensor> sheet = {splats.images[splats.fitted]};
  for (ShownViews& views : shown) {
    if (!views.latents.empty()) views.pictures = decoded(views.latents, splats, model.decoding);
    sheet.push_back(views.pictures[0]);
  }
  shown.push_back({"nearest", "the nearest input view", {}, nearest_views(splats)});

  EvaluatedScene result;
  result.name = scene.name;
  result.gaussians = splats.fit.set.size();
  result.sheet = torch::cat(sheet, 2).clamp(0, 1);
  score_pictures(shown, splats.images.slice(0, splats.fitted), result.scores);
  score_latents(shown, encoded, splats, result.scores);
  if (model.places) score_places(shown, splats, *model.places, result.scores);
  result.scores.push_back({"seconds", "seconds of fit and solve", splats.seconds});
  if (model.refiner)
    result.scores.push_back({"refined_seconds", "seconds of the refiner, a view", refined_seconds});
  return result;
}

// Returns the value of a scene's score, or none: latents of some scenes may not be square.
std::optional<double> score_of(const EvaluatedScene& scene, const std::string& name) {
  for (const Score& score : scene.scores) {
    if (score.name == name) return score.value;
  }
  return std::nullopt;
}

// Returns those that every scene has, without values.
std::vector<Score> common_scores(const std::vector<EvaluatedScene>& scenes) {
  std::vector<Score> common;
  if (scenes.empty()) return common;
  for (const Score& score : scenes.front().scores) {
    const auto has = [&](const EvaluatedScene& scene) { return score_of(scene, score.name).has_value(); };
    if (std::all_of(scenes.begin(), scenes.end(), has)) common.push_back(score);
  }
  return common;
}

Table scene_table(const std::vector<EvaluatedScene>& scenes, const std::vector<Score>& columns) {
  std::vector<std::string> names{"scene", "gaussians"};
  for (const Score& column : columns) names.push_back(column.name);
  Table table(names);
  for (const EvaluatedScene& scene : scenes) {
    std::vector<TableCell> row{scene.name, scene.gaussians};
    for (const Score& column : columns) row.emplace_back(*score_of(scene, column.name));
    table.add_row(row);
  }
  return table;
}

}  // namespace

void SplatEvaluationOptions::visit(FieldVisitor& visitor) {
  visitor.text({"consistency_model",
                "of scenes with depth: the model bundle whose backbone tells how alike a place looks in two "
                "views, such as configs/tiny; empty: not measured"},
               consistency_model);
  ScenesSplattingOptions::visit(visitor);
}

void run_splat_evaluation(const SplatEvaluationOptions& options) {
  options.check();
  check_run_folder(options.out, "splat eval", earlier_run(options.overwrite));
  KernelSettings settings;
  settings.threads = use_threads(options.threads);
  const ModelBundle bundle = ModelBundle::open(options.model);
  require_encoder_and_decoder(bundle, options.model);
  EvaluatedModel model{LatentEncoding(bundle), LatentDecoding(bundle), nullptr, std::nullopt};
  if (!options.consistency_model.empty()) {
    const ModelBundle looking = ModelBundle::open(options.consistency_model);
    model.places = PlaceFeatures{looking.load_backbone(), looking.options()};
  }
  if (has_splat_refiner(bundle)) {
    print_warnings(mixed_parts(bundle, {BundlePart::refiner()}, /*allow_mixed=*/false));
    model.refiner = bundle.load_refiner();
  }
  const auto dataset =
      held_out_dataset(options.scenes, options.generator, options.synthetic_seed, options.synthetic);
  RunFolder run(options.out, "splat eval", options, earlier_run(options.overwrite));
  const Provenance provenance = make_provenance("splat eval", options);
  std::vector<EvaluatedScene> scenes;
  DistinctNames names;
  Progress progress({"scenes", dataset->size(), 0, run.path()});
  for (int64_t index = 0; index < dataset->size(); ++index) {
    stop_if_interrupted(fmt::format("{} of {} scenes were done", index, dataset->size()));
    scenes.push_back(evaluated(dataset->scene(index), model, options, settings));
    scenes.back().name = names.of(scenes.back().name);
    export_image(run.subfolder("pictures") / (scenes.back().name + ".png"), to_image(scenes.back().sheet),
                 provenance);
    scenes.back().sheet.reset();
    progress.update(index + 1);
  }
  progress.finish();
  const std::vector<Score> columns = common_scores(scenes);
  nlohmann::ordered_json report;
  report["scenes"] = scenes.size();
  report["threads"] = settings.threads;
  Table means({"what", "mean", "low", "high"});
  for (const Score& column : columns) {
    std::vector<double> values;
    values.reserve(scenes.size());
    for (const EvaluatedScene& scene : scenes) values.push_back(*score_of(scene, column.name));
    const SceneStatistics statistics = statistics_over_scenes(values);
    const Interval& interval = statistics.interval;
    report["means"][column.name] = mean_json(statistics);
    means.add_row({column.says, statistics.mean, interval.low, interval.high});
  }
  const std::string text = fmt::format(
      "# Splats against views that they were not fitted to\n\n{} scene{}, {} held-out views of each; means over scenes, "
      "low and high: 95 % by bootstrap over scenes.\n\n{}",
      scenes.size(), scenes.size() == 1 ? "" : "s", options.held_out, means.markdown());
  write_file_atomically(run.path() / "eval.csv", scene_table(scenes, columns).csv());
  write_file_atomically(run.path() / "splat_eval.md", text);
  run.write_report(report);
  std::cout << text;
  run.note("scores", "eval.csv");
  run.note("pictures", "pictures/");
  run.note("report", "report.json");
  std::cout << run.closing_box();
}

}  // namespace gld
