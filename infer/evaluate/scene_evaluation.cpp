#include "infer/evaluate/scene_evaluation.h"

#include "datasets/loading/batching.h"
#include "gld/base/error.h"
#include "gld/metrics/metric_list.h"
#include "infer/method/sampling_method.h"
#include "infer/pipeline/geometry_of_pictures.h"
#include "infer/pipeline/geometry_placement.h"
#include "infer/pipeline/photo_cameras.h"
#include "infer/pipeline/scene_request.h"

#include <algorithm>
#include <limits>

#include <fmt/format.h>

namespace gld {
namespace {

bool is_trivial(Predictor predictor) {
  const auto& trivial = trivial_predictors();
  return std::find(trivial.begin(), trivial.end(), predictor) != trivial.end();
}

std::string column_name(Predictor predictor, const Metric& metric) {
  return is_trivial(predictor) ? metric.name + "_" + predictor_name(predictor)
                               : predictor_name(predictor) + "_" + metric.name;
}

// For every target the image of the source whose camera centre is nearest.
torch::Tensor nearest_sources(const Views& views, const torch::Tensor& source_images) {
  std::vector<torch::Tensor> images;
  for (int64_t target = views.num_sources; target < views.size(); ++target) {
    const auto centre = views.cameras[static_cast<size_t>(target)].world_from_camera.translation();
    int64_t nearest = 0;
    double distance = std::numeric_limits<double>::infinity();
    for (int64_t source = 0; source < views.num_sources; ++source) {
      const auto& camera = views.cameras[static_cast<size_t>(source)];
      const double length = (camera.world_from_camera.translation() - centre).norm();
      if (length < distance) {
        distance = length;
        nearest = source;
      }
    }
    images.push_back(source_images[nearest]);
  }
  return torch::stack(images);
}

torch::Tensor reconstruction(const EvaluationModels& models, const torch::Tensor& images) {
  const auto backbone = models.models.backbone();
  const auto decoded = models.models.levels.decoded_levels();
  const auto encoded = backbone->encode(images.to(models.device), decoded.back());
  std::vector<torch::Tensor> levels;
  for (const int64_t level : decoded) {
    levels.push_back(backbone->decodable(encoded.at(static_cast<size_t>(level))).patches);
  }
  const auto grid = backbone->architecture().grid_of(images.size(0), images.size(2), images.size(3));
  return models.models.rgb_decoder()->decode(torch::cat(levels, 2), grid).to(torch::kCPU);
}

// Undefined unless every target view has a picture.
torch::Tensor true_images(const SamplingScene& scene) {
  const auto& images = scene.true_images;
  const bool complete = std::none_of(images.begin(), images.end(), [](const Image& i) { return i.empty(); });
  return complete ? stacked(images) : torch::Tensor();
}

// 0 where unknown; undefined where no target view has a depth map.
torch::Tensor true_depth(const SamplingScene& scene) {
  bool any = false;
  std::vector<torch::Tensor> maps;
  for (const DepthMap& depth : scene.true_depths) {
    any = any || !depth.empty();
    maps.push_back(depth.empty() ? torch::zeros({scene.size.height, scene.size.width}) : to_tensor(depth));
  }
  return any ? torch::stack(maps) : torch::Tensor();
}

torch::Tensor points_of(const PointCloud& cloud) {
  torch::Tensor points = torch::empty({cloud.size(), 3}, torch::kFloat64);
  for (int64_t i = 0; i < cloud.size(); ++i) {
    Eigen::Map<Eigen::Vector3d>(points.data_ptr<double>() + 3 * i) = cloud.x_in_world[static_cast<size_t>(i)];
  }
  return points;
}

// What the true depth of all views shows of the scene, (points, 3); undefined where a view has none.
torch::Tensor true_surface(const SamplingScene& scene) {
  std::vector<DepthMap> depths = scene.source_depths;
  depths.insert(depths.end(), scene.true_depths.begin(), scene.true_depths.end());
  const bool complete =
      static_cast<int64_t>(depths.size()) == scene.views.size() &&
      std::none_of(depths.begin(), depths.end(), [](const DepthMap& d) { return d.empty(); });
  if (!complete) return {};
  std::vector<PointView> views;
  for (size_t i = 0; i < depths.size(); ++i) {
    PointView view;
    view.camera = scene.views.cameras[i];
    view.image = Image(1, 1);
    view.depth = depths[i];
    views.push_back(std::move(view));
  }
  PointCloudOptions all;
  all.confidence_quantile = 0;
  all.edge_step = 1e6;
  all.far_limit = 0;
  return points_of(build_point_cloud(views, 1, all));
}

PipelineResult run(const EvaluationModels& models, const SamplingScene& scene, const FlowSettings& settings,
                   int64_t noise_seed, DecodedViews geometry_views) {
  PipelineRequest request = scene_request(scene, models.bundle, noise_seed, models.device);
  request.flow = settings;
  request.image_views = DecodedViews::kTargets;
  request.geometry_views = geometry_views;
  request.geometry_maps = GeometryMaps::kDepthAndRays;
  StageRecords stages;
  return run_pipeline(models.models, request, stages);
}

// A scene's truth as metrics take it, and how to measure images against it.
class SceneMetrics {
 public:
  // Both must outlive this object.
  SceneMetrics(const EvaluationModels& models, const SamplingScene& scene)
      : models_(models), scene_(scene), lpips_(models.lpips) {
    truth_.true_images = true_images(scene);
    truth_.true_depth = true_depth(scene);
    truth_.views = scene.views;
    truth_.missing[MetricNeed::kImages] = "a target view of the scene has no picture";
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

  // Of target views, or with the true images of the views that `images` are of.
  MetricInputs of_images(const torch::Tensor& images) const { return of_images(truth_.true_images, images); }
  MetricInputs of_images(const torch::Tensor& truth, const torch::Tensor& images) const {
    MetricInputs inputs = truth_;
    inputs.true_images = truth;
    inputs.images = images;
    return inputs;
  }

  // Of the geometry of all views of a sample.
  MetricInputs of_geometry(const PipelineResult& sample) const {
    const GeometryOutput& geometry = sample.geometry;
    MetricInputs inputs = truth_;
    const Views& views = truth_.views;
    if (!geometry.depth.defined()) {
      for (const MetricNeed need : {MetricNeed::kDepth, MetricNeed::kDepthScale, MetricNeed::kRays}) {
        inputs.missing[need] = "the model has no geometry head";
      }
      return inputs;
    }
    inputs.depth = geometry.depth.narrow(0, views.num_sources, views.num_targets());
    inputs.rays = geometry.rays;
    const GeometryPlacement placement =
        place_geometry(geometry, views.cameras, scale_evidence(scene_, usual_scale_evidence()));
    inputs.predicted_cameras = placement.predicted;
    inputs.missing[MetricNeed::kRays] = "no camera fits the predicted rays";
    inputs.missing[MetricNeed::kDepthScale] = "the scale of the predicted depth is not known";
    inputs.missing[MetricNeed::kCloud] =
        placement.scale ? "a view of the scene has no true depth" : inputs.missing[MetricNeed::kDepthScale];
    inputs.true_surface = true_surface(scene_);
    if (placement.scale) {
      inputs.depth_scale = placement.scale->scale;
      inputs.cloud = points_of(cloud_of(sample, placement));
    }
    set_photo_cameras(inputs);
    return inputs;
  }

  const torch::Tensor& target_images() const { return truth_.true_images; }

 private:
  // As gld sample writes it: the sources' pixels with their photographs, the targets' with the sample's images.
  PointCloud cloud_of(const PipelineResult& sample, const GeometryPlacement& placement) const {
    std::vector<Image> images = scene_.source_images;
    for (int64_t i = 0; i < sample.images.size(0); ++i) images.push_back(to_image(sample.images[i]));
    return point_cloud_of(sample.geometry, placement, scene_.views.cameras, images, PointCloudOptions());
  }

  // The cameras that the model finds when it is given the true pictures of all views and no cameras.
  void set_photo_cameras(MetricInputs& inputs) const {
    if (!truth_.true_images.defined()) {
      inputs.missing[MetricNeed::kPhotoCameras] = "a target view of the scene has no picture";
      return;
    }
    const auto photographs = torch::cat({stacked(scene_.source_images), truth_.true_images});
    // Of one size, so one lens, as gld sample --photos takes it.
    const std::vector<PhotographLens> one_lens(
        static_cast<size_t>(photographs.size(0)),
        {0, static_cast<double>(std::max(photographs.size(2), photographs.size(3)))});
    try {
      inputs.photo_cameras = photo_cameras(geometry_of_pictures(models_.models, photographs,
                                                                GeometryMaps::kDepthAndRays, models_.device),
                                           photographs, one_lens)
                                 .cameras;
    } catch (const Error&) {
      inputs.missing[MetricNeed::kPhotoCameras] = "no camera fits the rays of a picture";
    }
  }

  const EvaluationModels& models_;
  const SamplingScene& scene_;
  MetricInputs truth_;
  std::shared_ptr<Lpips> lpips_;
};

}  // namespace

const std::vector<Predictor>& all_predictors() {
  static const std::vector<Predictor> predictors{Predictor::kSample,        Predictor::kMeanPrediction,
                                                 Predictor::kNearestSource, Predictor::kMeanSource,
                                                 Predictor::kMeanColor,     Predictor::kReconstruction};
  return predictors;
}

const std::vector<Predictor>& trivial_predictors() {
  static const std::vector<Predictor> predictors{Predictor::kNearestSource, Predictor::kMeanSource,
                                                 Predictor::kMeanColor};
  return predictors;
}

std::string predictor_name(Predictor predictor) {
  static const std::vector<std::string> names{"sample",      "mean_prediction", "nearest_source",
                                              "mean_source", "mean_color",      "reconstruction"};
  return names.at(static_cast<size_t>(predictor));
}

const std::vector<EvaluationColumn>& evaluation_columns() {
  static const std::vector<EvaluationColumn> columns = [] {
    std::vector<EvaluationColumn> list;
    for (const Metric& metric : metric_list()) {
      if (!metric.of_images()) {
        list.push_back({metric.name, metric, Predictor::kSample});
        continue;
      }
      for (const Predictor predictor : all_predictors()) {
        list.push_back({column_name(predictor, metric), metric, predictor});
      }
    }
    return list;
  }();
  return columns;
}

const SceneNumber& SceneEvaluation::number(const std::string& column) const {
  const auto& columns = evaluation_columns();
  for (size_t i = 0; i < columns.size() && i < numbers.size(); ++i) {
    if (columns[i].name == column) return numbers[i];
  }
  fail({"evaluation of " + scene, "a column of eval.csv", "'" + column + "'", "choose among its first line"});
}

bool SceneEvaluation::sample_beats(Predictor trivial) const {
  const Metric& metric = metric_named("psnr");
  return number(column_name(Predictor::kSample, metric)).value > number(column_name(trivial, metric)).value;
}

bool SceneEvaluation::sample_beats_every_trivial() const {
  const auto& trivial = trivial_predictors();
  return std::all_of(trivial.begin(), trivial.end(),
                     [&](Predictor predictor) { return sample_beats(predictor); });
}

EvaluatedScene evaluate_scene(const EvaluationModels& models, const SamplingScene& scene,
                              const FlowSettings& sampling, int64_t noise_seed) {
  const torch::NoGradGuard no_gradients;
  EvaluatedScene result;
  result.sample = run(models, scene, sampling, noise_seed,
                      models.bundle.dpt_head.exists() ? DecodedViews::kAll : DecodedViews::kNone);
  result.mean_prediction =
      run(models, scene, mean_prediction_settings(models.bundle), noise_seed, DecodedViews::kNone);

  const SceneMetrics metrics(models, scene);
  const auto sources = stacked(scene.source_images);
  const int64_t targets = scene.views.num_targets();
  const auto for_every_target = [&](const torch::Tensor& image) {
    return image.expand({targets, 3, scene.size.height, scene.size.width});
  };
  std::vector<MetricInputs> by_predictor(all_predictors().size());
  const auto set = [&](Predictor predictor, MetricInputs inputs) {
    by_predictor[static_cast<size_t>(predictor)] = std::move(inputs);
  };
  set(Predictor::kSample, metrics.of_images(result.sample.images));
  set(Predictor::kMeanPrediction, metrics.of_images(result.mean_prediction.images));
  set(Predictor::kNearestSource, metrics.of_images(nearest_sources(scene.views, sources)));
  set(Predictor::kMeanSource, metrics.of_images(for_every_target(sources.mean(0, /*keepdim=*/true))));
  set(Predictor::kMeanColor, metrics.of_images(for_every_target(sources.mean({0, 2, 3}, /*keepdim=*/true))));
  if (metrics.target_images().defined()) {
    const auto all = torch::cat({sources, metrics.target_images()});
    set(Predictor::kReconstruction, metrics.of_images(all, reconstruction(models, all)));
  } else {
    set(Predictor::kReconstruction, metrics.of_images(torch::Tensor()));
  }
  const MetricInputs geometry = metrics.of_geometry(result.sample);

  result.evaluation.scene = scene.name;
  for (const EvaluationColumn& column : evaluation_columns()) {
    const auto& inputs = column.metric.of_images() ? by_predictor[static_cast<size_t>(column.of)] : geometry;
    const MetricValue value = measure(column.metric, inputs);
    result.evaluation.numbers.push_back({value.mean(), value.absent});
  }
  return result;
}

}  // namespace gld
