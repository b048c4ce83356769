#include "gld/latents/relative_latent_error.h"
#include "gld/metrics/metric.h"

#include <string>
#include <vector>

namespace gld {
namespace {

Metric latent_error_of_level(int64_t level) {
  return {"latent_error_level" + std::to_string(level),
          "",
          Better::kLower,
          {MetricNeed::kLatents},
          [level](const MetricInputs& inputs) {
            const auto found = inputs.latents.find(level), truth = inputs.true_latents.find(level);
            if (found == inputs.latents.end() || truth == inputs.true_latents.end()) {
              return absent_metric("level " + std::to_string(level) + " is not predicted");
            }
            const double error = relative_latent_error(found->second, truth->second);
            return metric_of_views(torch::full({1}, error, torch::kFloat64),
                                   "its true latents are all the same");
          }};
}

}  // namespace

// Of generated levels beside what the backbone sees in the true pictures of all views (gld/latents/
// relative_latent_error.h), over all target views together.
std::vector<Metric> latent_metrics() { return metrics_of_levels(latent_error_of_level); }

}  // namespace gld
