#include "gld/photogrammetry/fused_view_depth.h"

#include "gld/cameras/resized_camera.h"
#include "gld/photogrammetry/depth_between.h"
#include "gld/photogrammetry/membrane.h"
#include "gld/photogrammetry/percentile.h"
#include "gld/photogrammetry/picture_warp.h"
#include "gld/photogrammetry/plane_sweep_stereo.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/LU>

namespace gld {
namespace {

// This tells how far the sources confirm depths of a target view: the confidence of the surest one that shows the place
// at that depth.
class Confirmation {
 public:
  Confirmation(const std::vector<ConfirmedDepth>& sources, const Camera& target)
      : sources_(sources), rays_(target.intrinsics.inverse()) {
    for (const ConfirmedDepth& source : sources)
      source_from_target_.push_back(source.view.camera.camera_from_world() * target.world_from_camera);
  }

  // Returns that of the target's pixel (x, y), counted from the picture's corner.
  float operator()(double x, double y, double depth) const {
    const Eigen::Vector3d in_target = depth * (rays_ * Eigen::Vector3d(x, y, 1));
    float surest = 0;
    for (size_t i = 0; i < sources_.size(); ++i) surest = std::max(surest, of_source(i, in_target));
    return surest;
  }

 private:
  float of_source(size_t source, const Eigen::Vector3d& in_target) const {
    const PlanarDepth& depth = sources_[source].view.depth;
    const ConfidenceMap& confidence = sources_[source].confidence;
    if (confidence.empty()) return 0;
    const Camera& camera = sources_[source].view.camera;
    const Eigen::Vector3d in_source = source_from_target_[source] * in_target;
    if (!(in_source.z() > 0)) return 0;
    const Eigen::Vector3d place = camera.intrinsics * in_source;
    const double u = place.x() / (place.z() * static_cast<double>(camera.width));
    const double v = place.y() / (place.z() * static_cast<double>(camera.height));
    if (!(u >= 0 && v >= 0 && u <= 1 && v <= 1)) return 0;
    const double column = u * static_cast<double>(depth.width) - 0.5;
    const double row = v * static_cast<double>(depth.height) - 0.5;
    const float shown = depth_between(depth, column, row);
    // Two depths are of one surface up to this, as the match tells them apart.
    constexpr double kSameDepth = 0.05;
    if (shown == 0.0F || std::abs(std::log(in_source.z() / static_cast<double>(shown))) > kSameDepth)
      return 0;
    return confidence.values[BilinearNeighbours(depth.width, depth.height, column, row).nearest()];
  }

  const std::vector<ConfirmedDepth>& sources_;
  Eigen::Matrix3d rays_;
  std::vector<Eigen::Isometry3d> source_from_target_;
};

// What the sources say of a view, pixel by pixel of the predicted map: 0 where nothing.
struct SeenDepth {
  std::vector<double> values;
  std::vector<float> confirmed;  // from 0 to 1
};

FusedViewDepth fused(const SeenDepth& seen, const PredictedDepth& prediction) {
  const PlanarDepth& predicted = prediction.depth;
  const size_t pixels = predicted.values.size();
  // Logarithms: of what is seen, and of that over the prediction; with weights where they are known and certain.
  std::vector<float> log_seen(pixels, 0.0F), shown(pixels, 0.0F);
  std::vector<float> ratio(pixels, 0.0F), certain(pixels, 0.0F), ratios;
  size_t certain_pixels = 0;
  for (size_t pixel = 0; pixel < pixels; ++pixel) {
    if (seen.values[pixel] == 0) continue;
    log_seen[pixel] = static_cast<float>(std::log(seen.values[pixel]));
    shown[pixel] = 1;
    if (!PlanarDepth::known(predicted.values[pixel])) continue;
    ratio[pixel] = log_seen[pixel] - std::log(predicted.values[pixel]);
    ratios.push_back(ratio[pixel]);
    if (seen.confirmed[pixel] < kConfidentStereo) continue;
    certain[pixel] = seen.confirmed[pixel];
    ++certain_pixels;
  }
  if (ratios.empty()) return {};
  const float usual = median(ratios);
  // A hundredth of the picture tells how the prediction is bent; fewer pixels tell its unit alone.
  const std::vector<float> bend = 100 * certain_pixels >= pixels
                                      ? membrane(predicted.width, predicted.height, 1, ratio, certain)
                                      : std::vector<float>(pixels, usual);
  const std::vector<float> around = membrane(predicted.width, predicted.height, 1, log_seen, shown);
  FusedViewDepth result;
  result.depth = {predicted.width, predicted.height, std::vector<float>(pixels, 0.0F)};
  result.confirmed = seen.confirmed;
  result.unit = std::exp(static_cast<double>(usual));
  for (size_t pixel = 0; pixel < pixels; ++pixel) {
    const float known = predicted.values[pixel];
    const bool is_known = PlanarDepth::known(known);
    const float moved = is_known ? std::log(known) + bend[pixel] : around[pixel];
    const float belief = is_known ? static_cast<float>(prediction.believed) : 0.0F;
    // A source that nothing confirms counts like a prediction that is believed.
    const float share = shown[pixel] == 0 ? 0.0F : 1 - 0.5F * belief * (1 - seen.confirmed[pixel]);
    const float other = shown[pixel] == 0 ? belief * moved + (1 - belief) * around[pixel] : moved;
    result.depth.values[pixel] = std::exp(share * log_seen[pixel] + (1 - share) * other);
  }
  return result;
}

}  // namespace

double belief_in_prior(const std::optional<PriorAgreement>& prior) {
  if (!prior || prior->pixels == 0) return 1;
  constexpr double kHalfBelieved = 0.25;
  const double spread = prior->spread / kHalfBelieved;
  return 1 / (1 + spread * spread * spread * spread);
}

FusedViewDepth fused_target_depth(const std::vector<ConfirmedDepth>& sources, double reach,
                                  const Camera& target, const PredictedDepth& predicted) {
  std::vector<PicturedView> views;
  views.reserve(sources.size());
  for (const ConfirmedDepth& source : sources) views.push_back(source.view);
  const Camera camera = resized_camera(target, predicted.depth.width, predicted.depth.height);
  CarryOptions carry;
  carry.depth_reach = reach;
  const TargetDepth carried = matched_target_depth(views, camera, carry);
  const Confirmation confirmation(sources, camera);
  SeenDepth seen{std::vector<double>(carried.values.size(), 0.0),
                 std::vector<float>(carried.values.size(), 0.0F)};
  for (int64_t row = 0; row < camera.height; ++row) {
    for (int64_t column = 0; column < camera.width; ++column) {
      const auto pixel = static_cast<size_t>(row * camera.width + column);
      if (carried.reached[pixel] == 0) continue;
      seen.values[pixel] = carried.values[pixel];
      seen.confirmed[pixel] = confirmation(static_cast<double>(column) + 0.5, static_cast<double>(row) + 0.5,
                                           carried.values[pixel]);
    }
  }
  return fused(seen, predicted);
}

FusedViewDepth fused_source_depth(const ConfirmedDepth& source, const PredictedDepth& prediction) {
  const PlanarDepth& predicted = prediction.depth;
  const PlanarDepth& depth = source.view.depth;
  const size_t pixels = predicted.values.size();
  SeenDepth seen{std::vector<double>(pixels, 0.0), std::vector<float>(pixels, 0.0F)};
  for (int64_t row = 0; row < predicted.height; ++row) {
    for (int64_t column = 0; column < predicted.width; ++column) {
      const auto pixel = static_cast<size_t>(row * predicted.width + column);
      const auto cell = [](int64_t at, int64_t side, int64_t cells) {
        return (static_cast<double>(at) + 0.5) * static_cast<double>(cells) / static_cast<double>(side) - 0.5;
      };
      const double x = cell(column, predicted.width, depth.width),
                   y = cell(row, predicted.height, depth.height);
      seen.values[pixel] = static_cast<double>(depth_between(depth, x, y));
      if (seen.values[pixel] == 0 || source.confidence.empty()) continue;
      seen.confirmed[pixel] =
          source.confidence.values[BilinearNeighbours(depth.width, depth.height, x, y).nearest()];
    }
  }
  return fused(seen, prediction);
}

}  // namespace gld
