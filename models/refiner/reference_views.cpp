#include "models/refiner/reference_views.h"

#include <algorithm>
#include <limits>
#include <numeric>

namespace gld {
namespace {

// Returns the mean distance of a camera from the one nearest to it; 1 where all stand in one place.
double mean_spacing(const std::vector<Camera>& cameras) {
  double sum = 0;
  for (size_t i = 0; i < cameras.size(); ++i) {
    double nearest = std::numeric_limits<double>::infinity();
    for (size_t j = 0; j < cameras.size(); ++j) {
      if (i == j) continue;
      nearest = std::min(
          nearest,
          (cameras[i].world_from_camera.translation() - cameras[j].world_from_camera.translation()).norm());
    }
    sum += nearest;
  }
  const double mean = cameras.size() < 2 ? 0 : sum / static_cast<double>(cameras.size());
  return mean > 0 ? mean : 1;
}

}  // namespace

std::vector<int64_t> nearest_references(const Camera& of, const std::vector<Camera>& candidates,
                                        int64_t count, ReferenceUnit unit) {
  const double scale = unit == ReferenceUnit::kScene ? 1 : 1 / mean_spacing(candidates);
  std::vector<double> distances;
  distances.reserve(candidates.size());
  for (const Camera& camera : candidates) {
    const auto& there = camera.world_from_camera;
    distances.push_back(scale * (there.translation() - of.world_from_camera.translation()).norm() +
                        0.5 * (there.linear() - of.world_from_camera.linear()).norm());
  }
  std::vector<int64_t> order(candidates.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int64_t a, int64_t b) {
    return distances[static_cast<size_t>(a)] < distances[static_cast<size_t>(b)];
  });
  order.resize(static_cast<size_t>(std::min<int64_t>(count, static_cast<int64_t>(order.size()))));
  return order;
}

}  // namespace gld
