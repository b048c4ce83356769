#include "infer/splats/splat_evaluation.h"

#include "datasets/loading/batching.h"
#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/cameras/relative_cameras.h"
#include "gld/machine/timing.h"
#include "gld/metrics/image_metrics.h"
#include "gld/metrics/latent_spectrum.h"
#include "gld/metrics/metric.h"
#include "gld/metrics/metric_list.h"
#include "gld/metrics/sharpness.h"
#include "gld/report/distinct_names.h"
#include "gld/report/progress.h"
#include "gld/report/report_text.h"
#include "gld/report/run_folder.h"
#include "gld/report/table.h"
#include "gld/tensors/compute_threads.h"
#include "infer/export/image_export.h"
#include "infer/request/held_out_scenes.h"
#include "models/bundle/bundle.h"
#include "models/bundle/part_lineage.h"
#include "models/splats/latent_refining.h"

#include <algorithm>
#include <iostream>
#include <limits>
#include <memory>
#include <set>

#include <torch/autograd.h>

#include <fmt/format.h>

namespace gld {
namespace {

// What encodes, decodes and, where the model can, repairs; read once for all scenes.
struct EvaluatedModel {
  LatentEncoding encoding;
  LatentDecoding decoding;
  std::shared_ptr<const DenoisingUnet> refiner;
  std::shared_ptr<const Backbone> consistency;  // what looks at pictures; null: nothing does
  BundleOptions consistency_options;
};

// Pictures of held-out views, each (views, 3, height, width); refined is undefined without a refiner.
struct HeldOutPictures {
  torch::Tensor truth, rgb, decoded, encoded_colours, refined, autoencoded, nearest;
};

struct EvaluatedScene {
  SplatScores scores;
  HeldOutPictures pictures;
};

// Latents of held-out views, normalised, a tensor a level: (views, channels, height, width).
struct HeldOutLatents {
  std::vector<torch::Tensor> encoded, shown, of_colours, refined;
};

HeldOutLatents held_out_latents(const LatentSplats& splats, const torch::Tensor& colours,
                                const EvaluatedModel& model, SplatScores& scores,
                                const KernelSettings& settings) {
  HeldOutLatents latents;
  latents.of_colours = splats.encoded_colours(colours, model.encoding);
  for (size_t level = 0; level < splats.fits.size(); ++level) {
    latents.encoded.push_back(splats.encoded(level, splats.fitted, splats.views()));
    latents.shown.push_back(splats.shown(level, settings));
  }
  if (!model.refiner) return latents;
  const auto& degraded =
      (model.refiner->options().degraded == DegradedLatents::kColours ? latents.of_colours : latents.shown)
          .front();
  const LatentRefining refining(*model.refiner, splats.fitted_cameras(), splats.encoded(0, 0, splats.fitted));
  std::vector<torch::Tensor> refined;
  scores.refined_seconds = seconds_of([&] {
    for (int64_t view = splats.fitted; view < splats.views(); ++view) {
      refined.push_back(refining(splats.cameras[static_cast<size_t>(view)], degraded[view - splats.fitted]));
    }
  });
  scores.refined_seconds /= static_cast<double>(refined.size());
  latents.refined = {torch::stack(refined)};
  return latents;
}

torch::Tensor decoded(const std::vector<torch::Tensor>& latents, const LatentSplats& splats,
                      const LatentDecoding& decoding) {
  std::vector<torch::Tensor> maps;
  for (size_t level = 0; level < latents.size(); ++level)
    maps.push_back(raw_latents(latents[level], splats.levels[level].statistics));
  return decoding(maps);
}

HeldOutPictures held_out_pictures(const LatentSplats& splats, const torch::Tensor& colours,
                                  const HeldOutLatents& latents, const LatentDecoding& decoding) {
  HeldOutPictures pictures;
  pictures.truth = splats.images.slice(0, splats.fitted);
  pictures.rgb = colours;
  Views cameras;
  cameras.cameras = splats.cameras;
  cameras.num_sources = splats.fitted;
  std::vector<torch::Tensor> nearest;
  for (int64_t view = splats.fitted; view < cameras.size(); ++view)
    nearest.push_back(splats.images[nearest_source(cameras, view)]);
  pictures.nearest = torch::stack(nearest);
  pictures.encoded_colours = decoded(latents.of_colours, splats, decoding);
  pictures.decoded = decoded(latents.shown, splats, decoding);
  pictures.autoencoded = decoded(latents.encoded, splats, decoding);
  if (!latents.refined.empty()) pictures.refined = decoded(latents.refined, splats, decoding);
  return pictures;
}

double mean_psnr(const torch::Tensor& truth, const torch::Tensor& pictures) {
  return psnr(truth, pictures).mean().item<double>();
}
double mean_ssim(const torch::Tensor& truth, const torch::Tensor& pictures) {
  return ssim(truth, pictures).mean().item<double>();
}
double mean_random_features(const torch::Tensor& truth, const torch::Tensor& pictures) {
  return measure_images(metric_named("random_features"), truth, pictures).mean();
}
double mean_sharpness(const torch::Tensor& truth, const torch::Tensor& pictures) {
  return sharpness(truth, pictures.clamp(0, 1)).mean().item<double>();
}

// Returns |latents - encoded| over |encoded - its mean|, as a mean over levels.
double mean_error(const std::vector<torch::Tensor>& latents, const std::vector<torch::Tensor>& encoded) {
  double sum = 0;
  for (size_t level = 0; level < latents.size(); ++level)
    sum += relative_latent_error(latents[level], encoded[level]);
  return sum / static_cast<double>(latents.size());
}

// Of the first level's raw latents; NaN where they are not square.
double high_band(const torch::Tensor& latents, const torch::Tensor& encoded, const LatentPictures& of) {
  const int64_t side = encoded.size(2);
  if (encoded.size(3) != side || side < 8) return std::numeric_limits<double>::quiet_NaN();
  const int64_t last = last_whole_ring(side);
  const auto amplitudes = [&](const torch::Tensor& views) {
    return ring_amplitudes(raw_latents(views, of.statistics), last, SpectrumWindow::kHann);
  };
  return band_ratio(amplitudes(latents), amplitudes(encoded), side / 4, last);
}

// Measures how alike places look in held-out views, shown by such pictures, and in the view nearest to each.
class HeldOutConsistency {
 public:
  HeldOutConsistency(const LatentSplats& splats, const EvaluatedModel& model)
      : model_(model), metric_(metric_named("met3r_like_true_geometry")) {
    inputs_.views.cameras = splats.cameras;
    inputs_.views.num_sources = splats.fitted;
    inputs_.all_true_depth = splats.depth;
    fitted_ = features_of(splats.images.slice(0, 0, splats.fitted));
  }
  // pictures are (views - fitted, 3, height, width); NaN where no view covers another one.
  double of(const torch::Tensor& pictures) {
    inputs_.view_features = torch::cat({fitted_, features_of(pictures.clamp(0, 1))});
    return measure(metric_, inputs_).mean();
  }

 private:
  // Pictures are resized to whole patches: features cover them evenly whatever their size is.
  torch::Tensor features_of(const torch::Tensor& pictures) const {
    const torch::NoGradGuard no_grad;
    const ImageSize size =
        latent_image_size(model_.consistency_options, {pictures.size(3), pictures.size(2)});
    return model_.consistency->features_of_each(
        torch::upsample_bilinear2d(pictures, {size.height, size.width}, /*align_corners=*/false));
  }

  const EvaluatedModel& model_;
  Metric metric_;
  MetricInputs inputs_;
  torch::Tensor fitted_;
};

void measure_consistency(const LatentSplats& splats, const HeldOutPictures& pictures,
                         const EvaluatedModel& model, SplatScores& scores) {
  HeldOutConsistency consistency(splats, model);
  scores.true_met3r_like = consistency.of(pictures.truth);
  scores.rgb_met3r_like = consistency.of(pictures.rgb);
  scores.decoded_met3r_like = consistency.of(pictures.decoded);
  scores.encoded_colours_met3r_like = consistency.of(pictures.encoded_colours);
  scores.autoencoded_met3r_like = consistency.of(pictures.autoencoded);
  if (pictures.refined.defined()) scores.refined_met3r_like = consistency.of(pictures.refined);
}

EvaluatedScene evaluated(const Scene& scene, const EvaluatedModel& model,
                         const SplatEvaluationOptions& options, const KernelSettings& settings) {
  const LatentSplats splats = splat_latents(scene, model.encoding, options, settings);
  EvaluatedScene result;
  SplatScores& scores = result.scores;
  scores.scene = scene.name;
  scores.seconds = splats.seconds;
  scores.gaussians = splats.fit.set.size();
  const auto colours = splats.colours(settings);
  const HeldOutLatents latents = held_out_latents(splats, colours, model, scores, settings);
  scores.encoded_colours_error = mean_error(latents.of_colours, latents.encoded);
  scores.latent_error = mean_error(latents.shown, latents.encoded);
  scores.high_band = high_band(latents.shown.front(), latents.encoded.front(), splats.levels.front());
  result.pictures = held_out_pictures(splats, colours, latents, model.decoding);
  const HeldOutPictures& pictures = result.pictures;
  const auto& truth = pictures.truth;
  scores.rgb_psnr = mean_psnr(truth, pictures.rgb);
  scores.rgb_ssim = mean_ssim(truth, pictures.rgb);
  scores.rgb_sharpness = mean_sharpness(truth, pictures.rgb);
  scores.decoded_psnr = mean_psnr(truth, pictures.decoded);
  scores.decoded_ssim = mean_ssim(truth, pictures.decoded);
  scores.decoded_sharpness = mean_sharpness(truth, pictures.decoded);
  scores.encoded_colours_psnr = mean_psnr(truth, pictures.encoded_colours);
  scores.encoded_colours_ssim = mean_ssim(truth, pictures.encoded_colours);
  scores.autoencoded_psnr = mean_psnr(truth, pictures.autoencoded);
  scores.autoencoded_ssim = mean_ssim(truth, pictures.autoencoded);
  scores.autoencoded_sharpness = mean_sharpness(truth, pictures.autoencoded);
  scores.rgb_random_features = mean_random_features(truth, pictures.rgb);
  scores.decoded_random_features = mean_random_features(truth, pictures.decoded);
  scores.encoded_colours_random_features = mean_random_features(truth, pictures.encoded_colours);
  scores.autoencoded_random_features = mean_random_features(truth, pictures.autoencoded);
  scores.nearest_psnr = mean_psnr(truth, pictures.nearest);
  scores.nearest_ssim = mean_ssim(truth, pictures.nearest);
  if (model.refiner) {
    scores.refined_error = mean_error(latents.refined, latents.encoded);
    scores.refined_high_band =
        high_band(latents.refined.front(), latents.encoded.front(), splats.levels.front());
    scores.refined_psnr = mean_psnr(truth, pictures.refined);
    scores.refined_ssim = mean_ssim(truth, pictures.refined);
    scores.refined_sharpness = mean_sharpness(truth, pictures.refined);
    scores.refined_random_features = mean_random_features(truth, pictures.refined);
  }
  if (model.consistency) {
    if (!splats.depth.defined()) {
      fail({"--consistency-model", "scenes with depth in every view", scene.name + " without",
            "leave it out, or measure scenes with depth"});
    }
    measure_consistency(splats, pictures, model, scores);
  }
  return result;
}

enum class ScoreNeed { kRefiner, kSquareLatents, kConsistencyModel };
// A column of eval.csv and a row of splat_eval.md.
struct ScoreColumn {
  const char* name;
  const char* says;
  double SplatScores::*value;
  std::set<ScoreNeed> needs = {};
};
// Returns those of which every scene has what they need.
std::vector<ScoreColumn> score_columns(const std::set<ScoreNeed>& had) {
  const std::vector<ScoreColumn> columns{
      {"rgb_psnr", "the Gaussians' colours, PSNR in dB", &SplatScores::rgb_psnr},
      {"decoded_psnr", "splatted latents, decoded, PSNR in dB", &SplatScores::decoded_psnr},
      {"refined_psnr",
       "what the refiner makes of its input, decoded, PSNR in dB",
       &SplatScores::refined_psnr,
       {ScoreNeed::kRefiner}},
      {"encoded_colours_psnr", "the Gaussians' colours, encoded and decoded, PSNR in dB",
       &SplatScores::encoded_colours_psnr},
      {"autoencoded_psnr", "encoded latents, decoded: what can be reached, PSNR in dB",
       &SplatScores::autoencoded_psnr},
      {"nearest_psnr", "the nearest input view, PSNR in dB", &SplatScores::nearest_psnr},
      {"rgb_ssim", "the Gaussians' colours, SSIM", &SplatScores::rgb_ssim},
      {"decoded_ssim", "splatted latents, decoded, SSIM", &SplatScores::decoded_ssim},
      {"refined_ssim", "repaired and decoded, SSIM", &SplatScores::refined_ssim, {ScoreNeed::kRefiner}},
      {"encoded_colours_ssim", "the Gaussians' colours, encoded and decoded, SSIM",
       &SplatScores::encoded_colours_ssim},
      {"autoencoded_ssim", "encoded latents, decoded, SSIM", &SplatScores::autoencoded_ssim},
      {"nearest_ssim", "the nearest input view, SSIM", &SplatScores::nearest_ssim},
      {"rgb_sharpness", "the Gaussians' colours, sharpness of the truth's", &SplatScores::rgb_sharpness},
      {"decoded_sharpness", "splatted latents, decoded, sharpness of the truth's",
       &SplatScores::decoded_sharpness},
      {"refined_sharpness",
       "repaired and decoded, sharpness of the truth's",
       &SplatScores::refined_sharpness,
       {ScoreNeed::kRefiner}},
      {"autoencoded_sharpness", "encoded latents, decoded, sharpness of the truth's",
       &SplatScores::autoencoded_sharpness},
      {"rgb_random_features", "the Gaussians' colours, distance of random features from the truth",
       &SplatScores::rgb_random_features},
      {"decoded_random_features", "splatted latents, decoded, the same", &SplatScores::decoded_random_features},
      {"refined_random_features", "repaired and decoded, the same", &SplatScores::refined_random_features,
       {ScoreNeed::kRefiner}},
      {"encoded_colours_random_features", "the Gaussians' colours, encoded and decoded, the same",
       &SplatScores::encoded_colours_random_features},
      {"autoencoded_random_features", "encoded latents, decoded, the same",
       &SplatScores::autoencoded_random_features},
      {"latent_error", "splatted latents, distance from what is encoded over its spread",
       &SplatScores::latent_error},
      {"encoded_colours_error",
       "the Gaussians' colours, encoded: distance from what is encoded over its spread",
       &SplatScores::encoded_colours_error},
      {"refined_error",
       "repaired latents, distance from what is encoded over its spread",
       &SplatScores::refined_error,
       {ScoreNeed::kRefiner}},
      {"high_band",
       "splatted latents, high frequencies of the encoded ones'",
       &SplatScores::high_band,
       {ScoreNeed::kSquareLatents}},
      {"refined_high_band",
       "repaired latents, high frequencies of the encoded ones'",
       &SplatScores::refined_high_band,
       {ScoreNeed::kRefiner, ScoreNeed::kSquareLatents}},
      {"true_met3r_like",
       "the truth, features of one place in two views apart (met3r_like_true_geometry)",
       &SplatScores::true_met3r_like,
       {ScoreNeed::kConsistencyModel}},
      {"rgb_met3r_like",
       "the Gaussians' colours, the same",
       &SplatScores::rgb_met3r_like,
       {ScoreNeed::kConsistencyModel}},
      {"decoded_met3r_like",
       "splatted latents, decoded, the same",
       &SplatScores::decoded_met3r_like,
       {ScoreNeed::kConsistencyModel}},
      {"encoded_colours_met3r_like",
       "the Gaussians' colours, encoded and decoded, the same",
       &SplatScores::encoded_colours_met3r_like,
       {ScoreNeed::kConsistencyModel}},
      {"refined_met3r_like",
       "repaired and decoded, the same",
       &SplatScores::refined_met3r_like,
       {ScoreNeed::kRefiner, ScoreNeed::kConsistencyModel}},
      {"autoencoded_met3r_like",
       "encoded latents, decoded, the same",
       &SplatScores::autoencoded_met3r_like,
       {ScoreNeed::kConsistencyModel}},
      {"seconds", "seconds of fit and solve", &SplatScores::seconds},
      {"refined_seconds",
       "seconds of the refiner, a view",
       &SplatScores::refined_seconds,
       {ScoreNeed::kRefiner}}};
  std::vector<ScoreColumn> shown;
  for (const ScoreColumn& column : columns) {
    if (std::includes(had.begin(), had.end(), column.needs.begin(), column.needs.end()))
      shown.push_back(column);
  }
  return shown;
}

Table scene_table(const std::vector<SplatScores>& scenes, const std::vector<ScoreColumn>& columns) {
  std::vector<std::string> names{"scene", "gaussians"};
  for (const ScoreColumn& column : columns) names.emplace_back(column.name);
  Table table(names);
  for (const SplatScores& scene : scenes) {
    std::vector<TableCell> row{scene.scene, scene.gaussians};
    for (const ScoreColumn& column : columns) row.emplace_back(scene.*column.value);
    table.add_row(row);
  }
  return table;
}

// Writes the first held-out view: truth, colours, decoded latents, what the refiner makes of them where there is one,
// and what decoding alone loses.
void write_pictures(const RunFolder& run, const EvaluatedScene& scene, const std::string& name,
                    const Provenance& provenance) {
  const HeldOutPictures& pictures = scene.pictures;
  std::vector<torch::Tensor> row = {pictures.truth[0], pictures.rgb[0], pictures.decoded[0]};
  if (pictures.refined.defined()) row.push_back(pictures.refined[0]);
  row.push_back(pictures.autoencoded[0]);
  export_image(run.subfolder("pictures") / (name + ".png"), to_image(torch::cat(row, 2).clamp(0, 1)),
               provenance);
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
  EvaluatedModel model{LatentEncoding(bundle), LatentDecoding(bundle), nullptr, nullptr, {}};
  if (!options.consistency_model.empty()) {
    const ModelBundle looking = ModelBundle::open(options.consistency_model);
    model.consistency = looking.load_backbone();
    model.consistency_options = looking.options();
  }
  if (has_refiner(bundle)) {
    print_warnings(mixed_parts(bundle, {BundlePart::refiner()}, /*allow_mixed=*/false));
    model.refiner = bundle.load_refiner();
  }
  const auto dataset =
      held_out_dataset(options.scenes, options.generator, options.synthetic_seed, options.synthetic);
  RunFolder run(options.out, "splat eval", options, earlier_run(options.overwrite));
  const Provenance provenance = make_provenance("splat eval", options);
  std::vector<SplatScores> scenes;
  DistinctNames names;
  Progress progress({"scenes", dataset->size(), 0, run.path()});
  for (int64_t index = 0; index < dataset->size(); ++index) {
    stop_if_interrupted(fmt::format("{} of {} scenes were done", index, dataset->size()));
    const EvaluatedScene scene = evaluated(dataset->scene(index), model, options, settings);
    write_pictures(run, scene, names.of(scene.scores.scene), provenance);
    scenes.push_back(scene.scores);
    progress.update(index + 1);
  }
  progress.finish();
  std::set<ScoreNeed> had;
  if (model.refiner) had.insert(ScoreNeed::kRefiner);
  if (model.consistency) had.insert(ScoreNeed::kConsistencyModel);
  if (std::all_of(scenes.begin(), scenes.end(), [](const SplatScores& of) { return of.high_band > 0; }))
    had.insert(ScoreNeed::kSquareLatents);
  const auto columns = score_columns(had);
  nlohmann::ordered_json report;
  report["scenes"] = scenes.size();
  report["threads"] = settings.threads;
  Table means({"what", "mean", "low", "high"});
  for (const ScoreColumn& column : columns) {
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
