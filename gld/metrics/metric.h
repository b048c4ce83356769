#pragma once

#include "gld/base/bootstrap.h"
#include "gld/cameras/camera.h"

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

enum class Better { kHigher, kLower, kNearOne };
const std::string& better_name(Better better);  // "higher", "lower", "near 1"

// What a metric may need of a scene.
enum class MetricNeed {
  kImages,              // true and predicted images of the target views
  kPerceptualDistance,  // a network that measures how alike two images look
  kTrueDepth,
  kDepth,
  kDepthScale,        // what brings the predicted depth into the scene's unit
  kCloud,             // the point cloud in the scene, and the true surface
  kRays,              // predicted rays of all views, and the cameras that fit them
  kPhotoCameras,      // the cameras that were estimated from the true pictures of all views
  kEstimatedCameras,  // the cameras that an estimator of the user's choice finds in the sample
  kCameraScale,       // the scale of a similarity that brings estimated cameras to the scene's
  kPseudoDepth,       // depth that the model's own head reads off the true pictures
  kViewGeometry,      // pictures, depth and cameras of all views, all predicted
  kViewFeatures,      // features of all views' pictures, each alone
  kTrueFeatures,      // features of all views' true pictures, each alone
  kAllTrueDepth,      // true depth of all views
  kTrueLevels,        // a backbone's levels of the true pictures of all views
  kLatents,           // generated levels of the target views, and the same of their true pictures
  kShownPixels,       // which pixels of the target views photographs show
  kSamples,           // several predictions of the same target views, measured together
};

// A scene's truth beside what was predicted. A quantity that is not known stays as it is here; `missing` says why.
struct MetricInputs {
  torch::Tensor true_images;  // (targets, 3, height, width), RGB in [0, 1]
  torch::Tensor images;       // of the same shape; metrics clamp it to [0, 1]
  // (samples, targets, 3, height, width): all that was drawn of the scene; one for who predicts without chance.
  torch::Tensor samples;
  // Two batches of images in [0, 1], (targets, 3, height, width) -> (targets): LPIPS, where its weights are there.
  std::function<torch::Tensor(const torch::Tensor&, const torch::Tensor&)> perceptual_distance;
  torch::Tensor shown;                // (targets, height, width), bool: what photographs show
  torch::Tensor true_depth;           // (targets, height, width) in the scene's unit, 0 where unknown
  torch::Tensor depth;                // (targets, height, width) in the model's own unit
  std::optional<double> depth_scale;  // scene units in one of the model's
  bool depth_scale_is_told =
      true;                    // false: nothing tells it, and depth is in the scene's unit by photographs
  torch::Tensor cloud;         // (points, 3) in the scene
  torch::Tensor true_surface;  // (points, 3) in the scene, as dense as the true depth maps
  Views views;                 // the scene's cameras, sources first
  torch::Tensor rays;          // (views, rows, columns, 6): direction, then origin, in the model's frame
  std::vector<Camera> predicted_cameras;  // the cameras that fit the rays best, one a view
  std::vector<Camera> photo_cameras;      // estimated from the pictures alone, one a view
  // Of the sample, sources first, one a view; in a frame and unit of their own.
  std::vector<Camera> estimated_cameras;
  std::optional<double> camera_scale;  // scene units in one of the estimated cameras'
  torch::Tensor pseudo_depth;          // (targets, height, width) in the model's own unit, 0 where unknown
  // What the head alone says where `depth` has more in it (photographs), in the same unit: it is compared with
  // pseudo_depth. Undefined where `depth` is that.
  torch::Tensor head_depth;
  torch::Tensor
      view_images;  // (views, 3, height, width): the sources' pictures and the targets' predicted ones
  torch::Tensor view_depth;                // (views, height, width) in the unit of estimated_cameras
  torch::Tensor view_features;             // (views, channels, rows, columns) of view_images
  torch::Tensor true_features;             // the same of the true pictures
  torch::Tensor all_true_depth;            // (views, height, width) in the scene's unit, 0 where unknown
  std::vector<torch::Tensor> true_levels;  // by level, (views, channels, rows, columns) of the true pictures
  // By generated level, normalised: (targets, channels, rows, columns).
  std::map<int64_t, torch::Tensor> latents, true_latents;
  std::map<MetricNeed, std::string> missing;  // one phrase each

  bool has(MetricNeed need) const;
};

// A metric of the target views of one scene, or why there is none: never 0 in its place.
struct MetricValue {
  torch::Tensor per_view;  // (targets), float64; NaN for a view without one; undefined where absent
  std::string absent;      // one phrase; empty where there is a value

  // Returns the mean over the views that have a value; it is NaN where absent. One perfect view makes a mean PSNR
  // infinite.
  double mean() const;
};

MetricValue absent_metric(std::string reason);
// The value is absent for that reason where no view has a value.
MetricValue metric_of_views(const torch::Tensor& per_view, const std::string& reason_without_any);

// One number that is the same thing wherever the program reports it.
struct Metric {
  std::string name;  // as columns and reports call it
  std::string unit;  // empty for ratios
  Better better = Better::kHigher;
  std::vector<MetricNeed> needs;
  std::function<MetricValue(const MetricInputs&)> compute;  // called only with everything in needs

  // Returns whether it compares images, so that any picture can be measured by it.
  bool of_images() const;
  // Returns whether it compares all samples of a scene with its truth, together: their number is one of the scene and
  // not a mean over samples.
  bool of_samples() const;
};

// Files have columns for so many levels, as many as the published backbones have; of a level that a backbone lacks, or
// that is not generated, a metric is absent.
constexpr int64_t kLevelColumns = 4;
// Returns one metric a level.
std::vector<Metric> metrics_of_levels(const std::function<Metric(int64_t level)>& of_level);

// The value is absent, with the reason, where something is missing that the metric needs.
MetricValue measure(const Metric& metric, const MetricInputs& inputs);

// Does the same for a metric that needs nothing but images, (views, 3, height, width) each.
MetricValue measure_images(const Metric& metric, const torch::Tensor& truth, const torch::Tensor& images);

// A metric over scenes (docs/FILES.md), of the finite values.
struct SceneStatistics {
  double mean = 0;       // NaN without a finite value
  double deviation = 0;  // of the population
  // 95 % of the mean, by the bootstrap over scenes; NaN with fewer than 2, which say nothing of how scenes differ.
  Interval interval;
  int64_t count = 0;     // finite values
  int64_t infinite = 0;  // left out: PSNRs of perfect predictions
};
SceneStatistics statistics_over_scenes(const std::vector<double>& values);

}  // namespace gld
