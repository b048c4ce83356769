#include "gld/metrics/metric_list.h"

#include "gld/base/error.h"

#include <algorithm>
#include <iterator>

namespace gld {

// One line a metric.
#define GLD_METRICS(METRIC)                 \
  METRIC(psnr)                              \
  METRIC(ssim)                              \
  METRIC(lpips)                             \
  METRIC(sharpness)                         \
  METRIC(depth_abs_rel_unscaled)            \
  METRIC(depth_sq_rel_unscaled)             \
  METRIC(depth_rmse_unscaled)               \
  METRIC(depth_delta1_unscaled)             \
  METRIC(depth_abs_rel_median_scaled)       \
  METRIC(depth_sq_rel_median_scaled)        \
  METRIC(depth_rmse_median_scaled)          \
  METRIC(depth_delta1_median_scaled)        \
  METRIC(depth_scale_ratio)                 \
  METRIC(cloud_distance)                    \
  METRIC(rotation_error)                    \
  METRIC(translation_direction_error)       \
  METRIC(ray_angle_error)                   \
  METRIC(ray_origin_error)                  \
  METRIC(photo_rotation_error)              \
  METRIC(photo_translation_direction_error) \
  METRIC(photo_centre_error)

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
