#include "gld/metrics/metric_list.h"

#include "gld/base/error.h"

#include <algorithm>
#include <iterator>

namespace gld {

// One line a metric.
#define GLD_METRICS(METRIC)                           \
  METRIC(psnr)                                        \
  METRIC(ssim)                                        \
  METRIC(lpips)                                       \
  METRIC(random_features)                             \
  METRIC(sharpness)                                   \
  METRIC(depth_abs_rel_unscaled)                      \
  METRIC(depth_sq_rel_unscaled)                       \
  METRIC(depth_rmse_unscaled)                         \
  METRIC(depth_delta1_unscaled)                       \
  METRIC(depth_delta2_unscaled)                       \
  METRIC(depth_delta3_unscaled)                       \
  METRIC(depth_abs_rel_median_scaled)                 \
  METRIC(depth_sq_rel_median_scaled)                  \
  METRIC(depth_rmse_median_scaled)                    \
  METRIC(depth_delta1_median_scaled)                  \
  METRIC(depth_delta2_median_scaled)                  \
  METRIC(depth_delta3_median_scaled)                  \
  METRIC(depth_abs_rel_median_scaled_per_view)        \
  METRIC(depth_sq_rel_median_scaled_per_view)         \
  METRIC(depth_rmse_median_scaled_per_view)           \
  METRIC(depth_delta1_median_scaled_per_view)         \
  METRIC(depth_delta2_median_scaled_per_view)         \
  METRIC(depth_delta3_median_scaled_per_view)         \
  METRIC(depth_abs_rel_least_squares_scaled_per_view) \
  METRIC(depth_sq_rel_least_squares_scaled_per_view)  \
  METRIC(depth_rmse_least_squares_scaled_per_view)    \
  METRIC(depth_delta1_least_squares_scaled_per_view)  \
  METRIC(depth_delta2_least_squares_scaled_per_view)  \
  METRIC(depth_delta3_least_squares_scaled_per_view)  \
  METRIC(depth_abs_rel_camera_scaled)                 \
  METRIC(depth_sq_rel_camera_scaled)                  \
  METRIC(depth_rmse_camera_scaled)                    \
  METRIC(depth_delta1_camera_scaled)                  \
  METRIC(depth_delta2_camera_scaled)                  \
  METRIC(depth_delta3_camera_scaled)                  \
  METRIC(pseudo_depth_abs_rel)                        \
  METRIC(pseudo_depth_rmse)                           \
  METRIC(pseudo_depth_delta1)                         \
  METRIC(depth_scale_ratio)                           \
  METRIC(cloud_distance)                              \
  METRIC(rotation_error)                              \
  METRIC(translation_direction_error)                 \
  METRIC(ray_angle_error)                             \
  METRIC(ray_origin_error)                            \
  METRIC(photo_rotation_error)                        \
  METRIC(photo_translation_direction_error)           \
  METRIC(photo_centre_error)                          \
  METRIC(ate)                                         \
  METRIC(ate_over_spread)                             \
  METRIC(rpe_translation)                             \
  METRIC(rpe_rotation)                                \
  METRIC(ate_of_all_views)                            \
  METRIC(ate_of_all_views_over_spread)                \
  METRIC(rotation_accuracy_15)                        \
  METRIC(translation_accuracy_15)                     \
  METRIC(pose_auc_3)                                  \
  METRIC(pose_auc_30)                                 \
  METRIC(pose_maa_30)                                 \
  METRIC(reprojection_mse)                            \
  METRIC(reprojection_perceptual)                     \
  METRIC(reprojection_score)                          \
  METRIC(reprojection_pixels)                         \
  METRIC(reprojection_agreement)                      \
  METRIC(reprojection_baseline_ratio)                 \
  METRIC(met3r_like)                                  \
  METRIC(met3r_like_coverage)                         \
  METRIC(met3r_like_true_geometry)                    \
  METRIC(met3r_like_of_truth)                         \
  METRIC(pck_level0)                                  \
  METRIC(pck_level1)                                  \
  METRIC(pck_level2)                                  \
  METRIC(pck_level3)

#define GLD_DECLARE_METRIC(name) Metric name##_metric();
GLD_METRICS(GLD_DECLARE_METRIC)
#undef GLD_DECLARE_METRIC

const std::vector<Metric>& metric_list() {
#define GLD_LIST_METRIC(name) name##_metric(),
  static const std::vector<Metric> metrics{GLD_METRICS(GLD_LIST_METRIC)};
#undef GLD_LIST_METRIC
  return metrics;
}

const std::vector<Metric>& image_metric_list() {
  static const std::vector<Metric> metrics = [] {
    std::vector<Metric> of_images;
    std::copy_if(metric_list().begin(), metric_list().end(), std::back_inserter(of_images),
                 [](const Metric& metric) { return metric.of_images(); });
    return of_images;
  }();
  return metrics;
}

const Metric& metric_named(const std::string& name) {
  for (const Metric& metric : metric_list()) {
    if (metric.name == name) return metric;
  }
  fail({"metrics", "the name of a metric", "'" + name + "'", "choose among gld/metrics/metric_list.cpp"});
}

}  // namespace gld
