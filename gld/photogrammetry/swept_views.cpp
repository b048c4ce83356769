#include "gld/photogrammetry/swept_views.h"

#include "gld/photogrammetry/percentile.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace gld {
namespace {

// Baselines below this share of the largest one are none; nor are those that are rounding of a position.
constexpr double kBaselineOfLargest = 1e-4;
constexpr double kPositionRounding = 1e-9;
// The nearest plane is where this share of the picture is inside of another photograph.
constexpr double kLeastOverlap = 0.25;
constexpr int64_t kFewestPoints = 20;
// Points lie all over a view where so many of the cells, of so many a side, that it is cut into have one.
constexpr size_t kPointCells = 8;
constexpr double kToldCells = 0.9;
// What is found is not all there is: ranges of points, and of confident pixels of the first pass, are widened.
constexpr double kPointMargin = 1.6;
constexpr double kFoundMargin = 1.25;
constexpr double kPriorMargin = 1.1;
constexpr double kPixelsOfMinimum = 1.5;
constexpr int64_t kSampledSide = 12;

double baseline(const Camera& a, const Camera& b) {
  return (a.world_from_camera.translation() - b.world_from_camera.translation()).norm();
}

// The share of the view's pixels (of some of them) that lie inside of the other view on a plane of that inverse depth,
// and how far they move there from where they would be at infinity, pixels.
struct Overlap {
  double share = 0;
  double parallax = 0;
};
Overlap overlap_at(const StereoPicture& view, const StereoPicture& other, double inverse_depth) {
  const BetweenViews to_other(view.camera, other.camera);
  Overlap overlap;
  for (int64_t row = 0; row < kSampledSide; ++row) {
    for (int64_t column = 0; column < kSampledSide; ++column) {
      const double x =
          (static_cast<double>(column) + 0.5) / kSampledSide * static_cast<double>(view.width) - 0.5;
      const double y =
          (static_cast<double>(row) + 0.5) / kSampledSide * static_cast<double>(view.height) - 0.5;
      const Eigen::Vector3d far = to_other.turned * Eigen::Vector3d(x, y, 1);
      const Eigen::Vector3d place = far + inverse_depth * to_other.moved;
      if (!lies_inside(place, other)) continue;
      overlap.share += 1;
      if (far.z() > 0) {
        overlap.parallax += (place.head<2>() / place.z() - far.head<2>() / far.z()).norm();
      } else {
        overlap.parallax += static_cast<double>(other.width);
      }
    }
  }
  if (overlap.share > 0) overlap.parallax /= overlap.share;
  overlap.share /= kSampledSide * kSampledSide;
  return overlap;
}

}  // namespace

BetweenViews::BetweenViews(const Camera& from, const Camera& to) {
  Eigen::Matrix3d middle = Eigen::Matrix3d::Identity();
  middle(0, 2) = middle(1, 2) = 0.5;
  const Eigen::Isometry3d relative = to.camera_from_world() * from.world_from_camera;
  const Eigen::Matrix3d pixels = middle.inverse() * to.intrinsics;
  turned = pixels * relative.linear() * from.intrinsics.inverse() * middle;
  moved = pixels * relative.translation();
}

bool lies_inside(const Eigen::Vector3d& place, const StereoPicture& picture) {
  if (!(place.z() > 0)) return false;
  const double x = place.x() / place.z(), y = place.y() / place.z();
  return x >= -0.5 && y >= -0.5 && x < static_cast<double>(picture.width) - 0.5 &&
         y < static_cast<double>(picture.height) - 0.5;
}

Baselines::Baselines(const std::vector<PicturedView>& views) : views_(views) {
  double largest = 0, position = 0;
  for (const PicturedView& a : views) {
    position = std::max(position, a.camera.world_from_camera.translation().norm());
    for (const PicturedView& b : views) largest = std::max(largest, baseline(a.camera, b.camera));
  }
  least_ = std::max(kBaselineOfLargest * largest, kPositionRounding * position);
}

bool Baselines::apart(size_t a, size_t b) const {
  return baseline(views_[a].camera, views_[b].camera) > least_;
}

bool hardly_any(size_t confident, size_t of) {
  constexpr double kHardlyAny = 0.01, kFewest = 50;
  return static_cast<double>(confident) < std::max(kFewest, kHardlyAny * static_cast<double>(of));
}

bool shows_something_far(const StereoDepth& found) {
  return !hardly_any(found.far_pixels(), found.least.values.size());
}

PointRange range_of_points(const StereoPicture& view, const std::vector<Eigen::Vector3d>& points) {
  std::vector<double> inverse;
  std::vector<bool> told(kPointCells * kPointCells);
  const Eigen::Isometry3d camera_from_world = view.camera.camera_from_world();
  for (const Eigen::Vector3d& point : points) {
    const Eigen::Vector3d seen = camera_from_world * point;
    if (!(seen.z() > 0)) continue;
    const Eigen::Vector3d pixel = view.camera.intrinsics * seen;
    if (pixel.x() < 0 || pixel.y() < 0 || pixel.x() > pixel.z() * static_cast<double>(view.width) ||
        pixel.y() > pixel.z() * static_cast<double>(view.height)) {
      continue;
    }
    inverse.push_back(1 / seen.z());
    const auto cell = [](double place, int64_t size) {
      const auto number = static_cast<size_t>(place * kPointCells / static_cast<double>(size));
      return std::min<size_t>(number, kPointCells - 1);
    };
    told[cell(pixel.y() / pixel.z(), view.height) * kPointCells + cell(pixel.x() / pixel.z(), view.width)] =
        true;
  }
  if (static_cast<int64_t>(inverse.size()) < kFewestPoints) return {};
  const auto cells = std::count(told.begin(), told.end(), true);
  PointRange range;
  range.depths = {percentile(inverse, 0.01) / kPointMargin, percentile(inverse, 0.99) * kPointMargin};
  range.all_over = static_cast<double>(cells) >= kToldCells * kPointCells * kPointCells;
  return range;
}

InverseDepths range_of_visibility(size_t view, const std::vector<StereoPicture>& pictures,
                                  const Baselines& baselines) {
  InverseDepths range;
  for (size_t other = 0; other < pictures.size(); ++other) {
    if (other == view || !baselines.apart(view, other)) continue;
    const double unit = baseline(pictures[view].camera, pictures[other].camera);
    // The search goes from a hundred baselines away to a tenth of one, in steps of a tenth.
    for (double inverse = 10 / unit; inverse > 0.01 / unit && inverse > range.most; inverse /= 1.1) {
      if (overlap_at(pictures[view], pictures[other], inverse).share >= kLeastOverlap) {
        range.most = inverse;
        break;
      }
    }
  }
  return range;
}

InverseDepths range_of_found(const StereoDepth& found) {
  std::vector<double> inverse;
  for (size_t i = 0; i < found.depth.values.size(); ++i) {
    if (found.confidence.values[i] >= kConfidentStereo)
      inverse.push_back(1 / static_cast<double>(found.depth.values[i]));
  }
  if (hardly_any(inverse.size(), found.depth.values.size())) return {};
  return {!shows_something_far(found) ? percentile(inverse, 0.005) / kFoundMargin : 0,
          percentile(inverse, 0.995) * kFoundMargin};
}

InverseDepths range_of_prior(const std::vector<float>& prior, double scale) {
  std::vector<double> inverse;
  for (const float depth : prior) {
    if (PlanarDepth::known(depth)) inverse.push_back(1 / (scale * static_cast<double>(depth)));
  }
  if (inverse.empty()) return {};
  return {percentile(inverse, 0.005) / kPriorMargin, percentile(inverse, 0.995) * kPriorMargin};
}

SweptPlanes planes_over(const InverseDepths& range, int64_t count) {
  SweptPlanes planes;
  planes.count = count;
  planes.farthest = std::max(range.least, range.most / static_cast<double>(2 * count));
  planes.step = (range.most - planes.farthest) / static_cast<double>(count - 1);
  return planes;
}

std::vector<size_t> photographs_for(size_t view, const std::vector<StereoPicture>& pictures,
                                    const Baselines& baselines, const InverseDepths& range, int64_t most) {
  std::vector<std::pair<double, size_t>> ranked;
  for (size_t other = 0; other < pictures.size(); ++other) {
    if (other == view || !baselines.apart(view, other)) continue;
    double value = 0;
    for (int i = 1; i <= 3; ++i) {
      const double inverse = range.least + (range.most - range.least) * 0.2 * i;
      const Overlap overlap = overlap_at(pictures[view], pictures[other], inverse);
      // A twentieth of the picture's width of parallax is enough to tell depth, and three tenths is much for a window.
      const double parallax = overlap.parallax / static_cast<double>(pictures[view].width);
      value += overlap.share * std::min(1.0, parallax / 0.05) * std::min(1.0, 0.3 / std::max(parallax, 1e-9));
    }
    if (value > 0) ranked.emplace_back(-value, other);
  }
  std::sort(ranked.begin(), ranked.end());
  if (static_cast<int64_t>(ranked.size()) > most) ranked.resize(static_cast<size_t>(most));
  std::vector<size_t> result;
  result.reserve(ranked.size());
  for (const auto& entry : ranked) result.push_back(entry.second);
  return result;
}

int64_t planes_of_one_minimum(size_t view, const std::vector<StereoPicture>& pictures,
                              const SweptView& swept) {
  const double middle = swept.planes.inverse_depth(0.5 * static_cast<double>(swept.planes.count));
  double pixels = 0;
  for (const size_t other : swept.compared)
    pixels += overlap_at(pictures[view], pictures[other], middle).parallax;
  const double of_plane = pixels / static_cast<double>(swept.compared.size()) * swept.planes.step / middle;
  return std::clamp<int64_t>(std::lround(kPixelsOfMinimum / std::max(of_plane, 1e-6)), 3,
                             std::max<int64_t>(3, swept.planes.count / 4));
}

}  // namespace gld
