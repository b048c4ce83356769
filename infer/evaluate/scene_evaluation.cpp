#include "infer/evaluate/scene_evaluation.h"

#include "datasets/loading/batching.h"
#include "gld/base/error.h"
#include "gld/metrics/metric_list.h"
#include "gld/tensors/device.h"
#include "infer/evaluate/carried_pictures.h"
#include "infer/evaluate/encoded_pictures.h"
#include "infer/evaluate/latent_comparison.h"
#include "infer/evaluate/scene_truth.h"
#include "infer/method/sampling_method.h"
#include "infer/pipeline/geometry_of_pictures.h"
#include "infer/pipeline/placed_cloud.h"
#include "infer/request/photo_cameras.h"
#include "infer/request/scale_evidence.h"
#include "infer/request/scene_request.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr const char* kNothingGenerated =
    "nothing is generated of target views that photographs show whole; --photograph-use.generate-complete does it all "
    "the same";

PipelineResult run(const EvaluationModels& models, const PipelineRequest& request) {
  StageRecords stages;
  record_device(stages, models.device);
  return run_pipeline(models.models, request, stages);
}

PipelineResult run(const EvaluationModels& models, const SamplingScene& scene, const FlowSettings& settings,
                   const PhotographUse& photographs, int64_t noise_seed, DecodedViews geometry_views) {
  PipelineRequest request = scene_request(scene, models.bundle, noise_seed, models.device);
  request.photographs = photographs;
  request.flow = settings;
  request.image_views = DecodedViews::kTargets;
  request.geometry_views = geometry_views;
  request.geometry_maps = GeometryMaps::kDepthAndRays;
  return run(models, request);
}

// Returns the prediction of the mean of each level that a cascade makes, of the true deeper ones; latents alone.
PipelineResult predicted_from_true_levels(const EvaluationModels& models, const SamplingScene& scene,
                                          const PhotographUse& photographs, int64_t noise_seed,
                                          const LevelLatents& true_latents) {
  PipelineRequest request = scene_request(scene, models.bundle, noise_seed, models.device);
  request.photographs = photographs;
  request.flow = mean_prediction_settings(models.bundle);
  request.image_views = request.geometry_views = DecodedViews::kNone;
  for (const LevelGenerator& generator : models.models.levels.generators) {
    if (!generator.is_cascade())
      request.kept_latents[generator.level] = true_latents.at(generator.level).cpu();
  }
  PipelineResult result = run(models, request);
  for (const auto& kept : request.kept_latents) result.latents.erase(kept.first);
  return result;
}

// A scene's truth as metrics take it, and how to measure images against it.
class SceneMetrics {
 public:
  // Both must outlive this object.
  SceneMetrics(const EvaluationModels& models, const SamplingScene& scene, const torch::Tensor& shown)
      : models_(models), scene_(scene), lpips_(models.lpips) {
    truth_.true_images = true_images(scene);
    truth_.shown = shown;
    truth_.true_depth = true_depth(scene);
    truth_.all_true_depth = all_true_depth(scene);
    truth_.views = scene.views;
    const std::string no_picture = "a target view of the scene has no picture";
    for (const MetricNeed need : {MetricNeed::kImages, MetricNeed::kPhotoCameras, MetricNeed::kPseudoDepth,
                                  MetricNeed::kTrueLevels, MetricNeed::kTrueFeatures, MetricNeed::kLatents}) {
      truth_.missing[need] = no_picture;
    }
    if (truth_.true_images.defined()) {
      pictures_ = encoded_pictures(models, torch::cat({stacked(scene.source_images), truth_.true_images}));
      truth_.true_features = models.models.backbone()->features_of_each(pictures_.images.to(models.device));
      for (const auto& level : pictures_.levels)
        truth_.true_levels.push_back(token_maps(level, pictures_.grid));
      latents_ = latents_of_levels(models.models, pictures_.raw, pictures_.grid);
      truth_.true_latents = maps_of_targets(latents_, pictures_.grid, scene.views);
      if (models.bundle.geometry_head.predicts_rays()) {
        set_what_the_head_says_of_true_pictures(geometry_of_pictures(
            models.models, pictures_.images, GeometryMaps::kDepthAndRays, models.device));
      } else {
        truth_.missing[MetricNeed::kPhotoCameras] = truth_.missing[MetricNeed::kPseudoDepth] = kNoCameraHead;
      }
    }
    auto& no_lpips = truth_.missing[MetricNeed::kPerceptualDistance];
    if (!lpips_) {
      no_lpips = "no LPIPS weights were given (--lpips-backbone, --lpips-heads)";
    } else if (std::min(scene.size.width, scene.size.height) < lpips_->minimum_side()) {
      no_lpips = fmt::format("LPIPS takes images of at least {} pixels", lpips_->minimum_side());
    } else {
      truth_.perceptual_distance = [this](const torch::Tensor& a, const torch::Tensor& b) {
        return lpips_->forward(a, b);
      };
    }
  }
  SceneMetrics(const SceneMetrics&) = delete;
  SceneMetrics& operator=(const SceneMetrics&) = delete;

  // Returns the inputs of target views, or those with the true images of the views that `images` are of.
  MetricInputs of_images(const torch::Tensor& images) const { return of_images(truth_.true_images, images); }
  MetricInputs of_images(const torch::Tensor& truth, const torch::Tensor& images) const {
    MetricInputs inputs = truth_;
    inputs.true_images = truth;
    inputs.images = images;
    if (images.defined()) inputs.samples = images.unsqueeze(0);
    return inputs;
  }

  // Returns the inputs of all samples of the target views together.
  MetricInputs of_samples(const std::vector<torch::Tensor>& samples) const {
    MetricInputs inputs = of_images(samples.front());
    inputs.samples = torch::stack(samples);
    return inputs;
  }

  // Returns the inputs of a result's images and of its latents.
  MetricInputs of_result(const PipelineResult& result) const {
    MetricInputs inputs = of_images(result.images);
    set_latents(result, inputs);
    return inputs;
  }

  // Returns the inputs of the geometry of all views of a sample, and of its latents.
  MetricInputs of_geometry(const PipelineResult& sample) const {
    const GeometryOutput& geometry = sample.geometry;
    MetricInputs inputs = truth_;
    const Views& views = truth_.views;
    inputs.view_images = torch::cat({stacked(scene_.source_images), sample.images}).clamp(0, 1);
    inputs.view_features = models_.models.backbone()->features_of_each(inputs.view_images.to(models_.device));
    set_estimated_cameras(geometry, inputs);
    set_latents(sample, inputs);
    if (!geometry.depth.defined()) {
      for (const MetricNeed need : {MetricNeed::kDepth, MetricNeed::kDepthScale, MetricNeed::kRays,
                                    MetricNeed::kCameraScale, MetricNeed::kPseudoDepth}) {
        inputs.missing[need] = no_geometry_of_samples(models_.bundle).value();
      }
      return inputs;
    }
    inputs.rays = geometry.rays;
    const GeometryPlacement placement =
        place_geometry(geometry, views.cameras, scale_evidence(scene_, usual_scale_evidence(), sample));
    inputs.predicted_cameras = placement.predicted;
    inputs.missing[MetricNeed::kRays] = "no camera fits the predicted rays";
    inputs.missing[MetricNeed::kDepthScale] = "the scale of the predicted depth is not known";
    inputs.missing[MetricNeed::kCameraScale] = "the cameras that the sample's rays show do not tell a scale";
    if (placement.alignment && placement.alignment->scale_known) {
      inputs.camera_scale = placement.alignment->b_from_a.scale;
    }
    inputs.true_surface = true_surface(scene_);
    const bool unit_known = placement.scale || !sample.view_depth.empty();
    inputs.missing[MetricNeed::kCloud] =
        unit_known ? "a view of the scene has no true depth" : inputs.missing[MetricNeed::kDepthScale];
    if (placement.scale) inputs.depth_scale = placement.scale->scale;
    if (unit_known) inputs.cloud = points_of(cloud_of(sample, placement));
    inputs.depth = geometry.depth.narrow(0, views.num_sources, views.num_targets());
    if (sample.view_depth.empty()) return inputs;
    // As gld sample writes it, but in the model's unit, which metrics beside the head's own depth take.
    if (!inputs.depth_scale) {
      inputs.depth_scale = 1;
      inputs.depth_scale_is_told = false;
      inputs.camera_scale.reset();  // that of the model's unit
      inputs.missing[MetricNeed::kCameraScale] =
          "the depth is not in the unit of the cameras that the rays show";
    }
    std::vector<torch::Tensor> fused;
    for (size_t view = static_cast<size_t>(views.num_sources); view < sample.view_depth.size(); ++view) {
      const PlanarDepth& map = sample.view_depth[view];
      fused.push_back(torch::tensor(at::ArrayRef<float>(map.values)).view({map.height, map.width}));
    }
    inputs.head_depth = inputs.depth;
    inputs.depth = torch::stack(fused) / *inputs.depth_scale;
    return inputs;
  }

  // Returns the true ones of all views.
  const EncodedPictures& pictures() const { return pictures_; }
  const LevelLatents& latents() const { return latents_; }

 private:
  void set_latents(const PipelineResult& result, MetricInputs& inputs) const {
    if (latents_.empty()) return;
    if (result.carried_only.empty()) {
      inputs.latents = maps_of_targets(result.latents, result.grid, truth_.views);
    } else {
      inputs.missing[MetricNeed::kLatents] = kNothingGenerated;
    }
  }

  // Makes the cloud as gld sample writes it: the sources' pixels have their photographs' colours, the targets' those of
  // the sample's images.
  PointCloud cloud_of(const PipelineResult& sample, const GeometryPlacement& placement) const {
    std::vector<Image> images = scene_.source_images;
    for (int64_t i = 0; i < sample.images.size(0); ++i) images.push_back(to_image(sample.images[i]));
    return point_cloud_of({sample.geometry, placement, sample.view_depth}, scene_.views.cameras, images,
                          PointCloudOptions());
  }

  // Sets the head's depth, and the cameras that it finds when it is given the true pictures of all views and no
  // cameras.
  void set_what_the_head_says_of_true_pictures(const GeometryOutput& geometry) {
    truth_.pseudo_depth = geometry.depth.narrow(0, truth_.views.num_sources, truth_.views.num_targets());
    const torch::Tensor& pictures = pictures_.images;
    // Of one size, so one lens, as gld sample --photos takes it.
    const std::vector<PhotographLens> one_lens(
        static_cast<size_t>(pictures.size(0)),
        {0, static_cast<double>(std::max(pictures.size(2), pictures.size(3)))});
    try {
      truth_.photo_cameras = photo_cameras(geometry, pictures, one_lens).cameras;
    } catch (const Error&) {
      truth_.missing[MetricNeed::kPhotoCameras] = "no camera fits the rays of a picture";
    }
  }

  // By the estimator that was asked for, from the sample's own geometry or what the pose model sees in its pictures.
  void set_estimated_cameras(const GeometryOutput& own, MetricInputs& inputs) const {
    const auto missing = [&](const std::string& reason) {
      inputs.missing[MetricNeed::kEstimatedCameras] = inputs.missing[MetricNeed::kViewGeometry] = reason;
    };
    if (models_.poses == PoseEstimator::kNone) return missing("no poses were asked for (--poses none)");
    if (!models_.pose_model && !own.rays.defined())
      return missing(no_geometry_of_samples(models_.bundle).value());
    const GeometryOutput geometry = models_.pose_model
                                        ? geometry_of_pictures(*models_.pose_model, inputs.view_images,
                                                               GeometryMaps::kDepthAndRays, models_.device)
                                        : own;
    try {
      inputs.estimated_cameras = estimated_cameras(models_.poses, geometry, truth_.views.cameras);
      inputs.view_depth = geometry.depth;
    } catch (const Error&) {
      missing(models_.poses == PoseEstimator::kDa3Decoder
                  ? "the camera decoder gave no camera for a view of the sample"
                  : "no camera fits the rays of a view of the sample");
    }
  }

  const EvaluationModels& models_;
  const SamplingScene& scene_;
  MetricInputs truth_;
  EncodedPictures pictures_;
  LevelLatents latents_;  // of these
  std::shared_ptr<Lpips> lpips_;
};

// Returns what a metric has for the targets: nothing where it is of the scene. A reconstruction is of all views.
std::vector<double> of_targets(const MetricValue& value, const Views& views, const Predictor& predictor) {
  if (!value.per_view.defined()) return {};
  const int64_t count = value.per_view.size(0);
  if (count != (predictor.of_all_views() ? views.size() : views.num_targets())) return {};
  const auto numbers = value.per_view.narrow(0, count - views.num_targets(), views.num_targets())
                           .to(torch::kFloat64)
                           .contiguous();
  const double* first = numbers.data_ptr<double>();
  return {first, first + numbers.numel()};
}

// Returns whether a column's number is another one in each sample.
bool depends_on_sample(const EvaluationColumn& column) {
  const auto& needs = column.metric.needs;
  const auto needs_one_of = [&](const std::vector<MetricNeed>& wanted) {
    return std::any_of(wanted.begin(), wanted.end(), [&](MetricNeed need) {
      return std::find(needs.begin(), needs.end(), need) != needs.end();
    });
  };
  if (of_every_predictor(column.metric) || column.of != Predictor::kSample) {
    return column.of == Predictor::kSample || column.of == Predictor::kGenerated;
  }
  return !needs_one_of({MetricNeed::kPhotoCameras, MetricNeed::kTrueLevels, MetricNeed::kTrueFeatures});
}

// Makes one number of several samples' values.
SceneNumber over_samples(const std::vector<MetricValue>& values, const EvaluationColumn& column,
                         const Views& views) {
  SceneNumber number;
  double sum = 0;
  int64_t present = 0;
  for (const MetricValue& value : values) {
    number.of_targets.push_back(of_targets(value, views, column.of));
    if (!value.absent.empty()) {
      number.absent = value.absent;
      continue;
    }
    sum += value.mean();
    ++present;
  }
  number.value = present > 0 ? sum / static_cast<double>(present) : std::numeric_limits<double>::quiet_NaN();
  if (present > 0) {
    number.absent.clear();
    number.absent_samples = static_cast<int64_t>(values.size()) - present;
  }
  const auto empty = [](const std::vector<double>& list) { return list.empty(); };
  if (std::all_of(number.of_targets.begin(), number.of_targets.end(), empty)) number.of_targets.clear();
  return number;
}

}  // namespace

const SceneNumber& SceneEvaluation::number(const std::string& column) const {
  const auto& columns = evaluation_columns();
  for (size_t i = 0; i < columns.size() && i < numbers.size(); ++i) {
    if (columns[i].name == column) return numbers[i];
  }
  fail({"evaluation of " + scene, "a column of eval.csv", "'" + column + "'", "choose among its first line"});
}

bool SceneEvaluation::sample_beats(const Predictor& trivial) const {
  return sample_wins(trivial, metric_named("psnr")).value_or(false);
}

std::optional<bool> SceneEvaluation::sample_wins(const Predictor& other, const Metric& metric) const {
  const double of_sample = number(column_name(Predictor::kSample, metric)).value;
  const double of_other = number(column_name(other, metric)).value;
  if (std::isnan(of_sample) || std::isnan(of_other)) return std::nullopt;
  return metric.better == Better::kLower ? of_sample < of_other : of_sample > of_other;
}

bool SceneEvaluation::sample_beats_every_trivial() const {
  const auto& trivial = trivial_predictors();
  return std::all_of(trivial.begin(), trivial.end(),
                     [&](const Predictor& predictor) { return sample_beats(predictor); });
}

EvaluatedScene evaluate_scene(const EvaluationModels& models, const SamplingScene& scene,
                              const FlowSettings& sampling, const std::vector<int64_t>& noise_seeds) {
  const torch::NoGradGuard no_gradients;
  if (noise_seeds.empty()) fail({"evaluation", "at least one sample", "none", "give a seed"});
  EvaluatedScene result;
  // The prediction of the mean is the model's own: nothing is kept in it, so that it says what the model learnt.
  PhotographUse shown_only = models.photographs;
  shown_only.composition = Composition::kNone;
  result.mean_prediction = run(models, scene, mean_prediction_settings(models.bundle), shown_only,
                               noise_seeds.front(), DecodedViews::kNone);
  const CarriedPictures carried = carried_pictures(models, scene);
  const SceneMetrics metrics(models, scene, carried.filled.shown);
  const auto sources = stacked(scene.source_images);
  const int64_t targets = scene.views.num_targets();
  const auto for_every_target = [&](const torch::Tensor& image) {
    return image.expand({targets, 3, scene.size.height, scene.size.width});
  };
  std::map<std::string, MetricInputs> by_predictor;
  const auto set = [&](const Predictor& predictor, MetricInputs inputs) {
    by_predictor[predictor_name(predictor)] = std::move(inputs);
  };
  set(Predictor::kMeanPrediction, metrics.of_result(result.mean_prediction));
  const auto& generators = models.models.levels.generators;
  MetricInputs from_truth = metrics.of_images(torch::Tensor());
  if (std::none_of(generators.begin(), generators.end(),
                   [](const auto& made) { return made.is_cascade(); })) {
    from_truth.missing[MetricNeed::kLatents] = "the model has no cascade, which is given a deeper level";
  } else if (!metrics.latents().empty()) {
    from_truth = metrics.of_result(
        predicted_from_true_levels(models, scene, shown_only, noise_seeds.front(), metrics.latents()));
  }
  set(Predictor::kFromTrueLevels, std::move(from_truth));
  set(Predictor::kNearestSource, metrics.of_images(nearest_sources(scene.views, sources)));
  set(Predictor::kMeanSource, metrics.of_images(for_every_target(sources.mean(0, /*keepdim=*/true))));
  set(Predictor::kMeanColor, metrics.of_images(for_every_target(sources.mean({0, 2, 3}, /*keepdim=*/true))));
  MetricInputs of_carried = metrics.of_images(carried.images);
  of_carried.depth = carried.depth;
  of_carried.depth_scale = 1;
  if (!carried.no_images.empty()) of_carried.missing[MetricNeed::kImages] = carried.no_images;
  of_carried.missing[MetricNeed::kDepth] = carried.no_depth;
  set(Predictor::kWarpedSources, std::move(of_carried));
  MetricInputs of_fill = metrics.of_images(carried.filled.images);
  if (!carried.no_images.empty()) of_fill.missing[MetricNeed::kImages] = carried.no_images;
  set(Predictor::kFill, std::move(of_fill));
  MetricInputs of_reconstructed = metrics.of_images(through_decoder(models, sources, carried.filled.images));
  if (!carried.no_images.empty()) of_reconstructed.missing[MetricNeed::kImages] = carried.no_images;
  set(Predictor::kReconstructedFill, std::move(of_reconstructed));
  MetricInputs of_true_depth = metrics.of_images(filled_by_true_depth(scene).images);
  if (!of_true_depth.images.defined()) {
    of_true_depth.missing[MetricNeed::kImages] = "a source view of the scene has no true depth";
  }
  set(Predictor::kFillByTrueDepth, std::move(of_true_depth));
  const EncodedPictures& pictures = metrics.pictures();
  const auto set_reconstruction = [&](const Predictor& predictor, std::optional<int64_t> alone) {
    MetricInputs inputs = metrics.of_images(torch::Tensor());
    const auto decoded = models.models.levels.decoded_levels();
    if (alone && std::find(decoded.begin(), decoded.end(), *alone) == decoded.end()) {
      inputs.missing[MetricNeed::kImages] = fmt::format("the decoder takes no level {}", *alone);
    } else if (pictures.images.defined()) {
      const auto images = reconstruction(models, pictures, alone);
      if (!alone || decoded.size() > 1)
        result.first_reconstructed.emplace_back(alone, images[scene.views.num_sources].clone());
      inputs = metrics.of_images(pictures.images, images);
    }
    set(predictor, std::move(inputs));
  };
  set_reconstruction(Predictor::kReconstruction, std::nullopt);
  for (const Predictor& of_level : level_predictors()) set_reconstruction(of_level, of_level.level);

  const auto& columns = evaluation_columns();
  std::vector<std::vector<MetricValue>> values(columns.size());
  std::vector<torch::Tensor> samples, generated_samples;
  for (const int64_t seed : noise_seeds) {
    PipelineResult sample =
        run(models, scene, sampling, models.photographs, seed,
            no_geometry_of_samples(models.bundle) ? DecodedViews::kNone : DecodedViews::kAll);
    set(Predictor::kSample, metrics.of_images(sample.images));
    MetricInputs generated = metrics.of_images(sample.generated_images);
    if (!sample.generated_images.defined()) {
      generated.missing[MetricNeed::kImages] =
          sample.carried_only.empty() ? "nothing of the photographs is kept in samples: they are generated"
                                      : kNothingGenerated;
    }
    set(Predictor::kGenerated, std::move(generated));
    samples.push_back(sample.images);
    if (sample.generated_images.defined()) generated_samples.push_back(sample.generated_images);
    const MetricInputs geometry = metrics.of_geometry(sample);
    for (size_t i = 0; i < columns.size(); ++i) {
      if (columns[i].metric.of_samples()) continue;
      if (!values[i].empty() && !depends_on_sample(columns[i])) continue;
      const bool of_sample_geometry = !columns[i].metric.of_images() && columns[i].of == Predictor::kSample;
      values[i].push_back(measure(
          columns[i].metric, of_sample_geometry ? geometry : by_predictor.at(predictor_name(columns[i].of))));
    }
    if (seed == noise_seeds.front()) result.sample = std::move(sample);
  }
  set(Predictor::kSample, metrics.of_samples(samples));
  if (generated_samples.size() == samples.size()) {
    set(Predictor::kGenerated, metrics.of_samples(generated_samples));
  }
  for (size_t i = 0; i < columns.size(); ++i) {
    if (!columns[i].metric.of_samples()) continue;
    values[i].push_back(measure(columns[i].metric, by_predictor.at(predictor_name(columns[i].of))));
  }
  SceneEvaluation& evaluation = result.evaluation;
  evaluation.scene = scene.name;
  evaluation.samples = static_cast<int64_t>(noise_seeds.size());
  const auto first_target = scene.view_names.begin() + static_cast<std::ptrdiff_t>(scene.views.num_sources);
  evaluation.sources.assign(scene.view_names.begin(), first_target);
  evaluation.targets.assign(first_target, scene.view_names.end());
  for (size_t i = 0; i < columns.size(); ++i) {
    evaluation.numbers.push_back(over_samples(values[i], columns[i], scene.views));
  }
  return result;
}

}  // namespace gld
