#include "gld/metrics/metric_list.h"

#include "gld/base/error.h"

#include <algorithm>
#include <iterator>
#include <utility>

namespace gld {

// One line for each file of metrics, in the order of tables.
std::vector<Metric> pixel_metrics();
std::vector<Metric> perceptual_metrics();
std::vector<Metric> random_feature_metrics();
std::vector<Metric> sharpness_metrics();
std::vector<Metric> energy_score_metrics();
std::vector<Metric> depth_metrics();
std::vector<Metric> cloud_metrics();
std::vector<Metric> pose_metrics();
std::vector<Metric> trajectory_metrics();
std::vector<Metric> reprojection_metrics();
std::vector<Metric> feature_consistency_metrics();
std::vector<Metric> correspondence_metrics();
std::vector<Metric> latent_metrics();

const std::vector<Metric>& metric_list() {
  static const std::vector<Metric> metrics = [] {
    std::vector<Metric> all;
    for (const auto& of_file :
         {pixel_metrics, perceptual_metrics, random_feature_metrics, sharpness_metrics, energy_score_metrics,
          depth_metrics, cloud_metrics, pose_metrics, trajectory_metrics, reprojection_metrics,
          feature_consistency_metrics, correspondence_metrics, latent_metrics}) {
      for (Metric& metric : of_file()) all.push_back(std::move(metric));
    }
    return all;
  }();
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
