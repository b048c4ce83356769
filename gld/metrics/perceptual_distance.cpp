#include "gld/metrics/metric.h"

namespace gld {

namespace {

// The network is models/losses/lpips.h's; whoever has its weights hands it in.
Metric lpips_metric() {
  return {"lpips",
          "",
          Better::kLower,
          {MetricNeed::kImages, MetricNeed::kPerceptualDistance},
          [](const MetricInputs& inputs) {
            return metric_of_views(
                inputs.perceptual_distance(inputs.true_images.clamp(0, 1), inputs.images.clamp(0, 1)),
                "the perceptual distance is not a number");
          }};
}

}  // namespace

std::vector<Metric> perceptual_metrics() { return {lpips_metric()}; }

}  // namespace gld
