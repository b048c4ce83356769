#include "datasets/splats/splat_start.h"

#include "gld/base/error.h"
#include "gld/splatting/spherical_harmonics.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>

namespace gld {
namespace {

// A place on a surface.
struct SurfacePoint {
  Eigen::Vector3d x;  // from the reach's middle
  double footprint;   // of its pixel, there
  std::array<float, 3> colour;
};

// Returns the depths that are known, of pixels that say something.
std::vector<float> depths_said(const SplatPicture& picture) {
  std::vector<float> depths;
  for (size_t pixel = 0; pixel < picture.depth.metres.size(); ++pixel) {
    const float depth = picture.depth.metres[pixel];
    if (is_known_depth(depth) && (picture.valid.empty() || picture.valid[pixel] != 0))
      depths.push_back(depth);
  }
  return depths;
}

std::vector<SurfacePoint> surface_points(const std::vector<SplatPicture>& pictures,
                                         const Eigen::Vector3d& middle) {
  std::vector<SurfacePoint> points;
  for (const SplatPicture& picture : pictures) {
    if (picture.depth.empty()) continue;
    const Camera& camera = picture.camera;
    const double fx = camera.intrinsics(0, 0), fy = camera.intrinsics(1, 1);
    for (int64_t y = 0; y < picture.depth.height; ++y) {
      for (int64_t x = 0; x < picture.depth.width; ++x) {
        const double depth = picture.depth.at(x, y);
        if (!is_known_depth(picture.depth.at(x, y)) || !picture.says(x, y)) continue;
        const Eigen::Vector3d in_camera((static_cast<double>(x) + 0.5 - camera.intrinsics(0, 2)) / fx * depth,
                                        (static_cast<double>(y) + 0.5 - camera.intrinsics(1, 2)) / fy * depth,
                                        depth);
        SurfacePoint point;
        point.x =
            camera.world_from_camera.linear() * in_camera + (camera.world_from_camera.translation() - middle);
        point.footprint = depth / std::sqrt(fx * fy);
        const uint8_t* rgb = picture.image.pixel(x, y);
        for (size_t c = 0; c < 3; ++c) point.colour[c] = static_cast<float>(rgb[c]) / 255;
        points.push_back(point);
      }
    }
  }
  return points;
}

// Points by the voxel that they lie in; 21 bits an axis.
struct Voxelled {
  uint64_t voxel;
  uint32_t point;
};
std::vector<Voxelled> by_voxel(const std::vector<SurfacePoint>& points, double side) {
  std::vector<Voxelled> result(points.size());
  constexpr double kHalf = 1 << 20;
  for (size_t i = 0; i < points.size(); ++i) {
    uint64_t voxel = 0;
    for (int axis = 0; axis < 3; ++axis) {
      const double cell = std::clamp(std::floor(points[i].x[axis] / side), -kHalf, kHalf - 1);
      voxel = voxel << 21 | static_cast<uint64_t>(cell + kHalf);
    }
    result[i] = {voxel, static_cast<uint32_t>(i)};
  }
  std::sort(result.begin(), result.end(), [](const Voxelled& a, const Voxelled& b) {
    return a.voxel != b.voxel ? a.voxel < b.voxel : a.point < b.point;
  });
  return result;
}

int64_t voxels_of(const std::vector<Voxelled>& sorted) {
  int64_t count = 0;
  for (size_t i = 0; i < sorted.size(); ++i) count += i == 0 || sorted[i].voxel != sorted[i - 1].voxel;
  return count;
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

float logit(double opacity) { return static_cast<float>(std::log(opacity / (1 - opacity))); }

struct NewGaussian {
  Eigen::Vector3d mean;
  double scale;
  std::array<double, 3> colour;
  double opacity;
};
void add(GaussianSet& set, const NewGaussian& one) {
  for (int k = 0; k < 3; ++k) {
    set.means.push_back(static_cast<float>(one.mean[k]));
    set.log_scales.push_back(static_cast<float>(std::log(one.scale)));
    set.colours.push_back(static_cast<float>(coefficient_of_colour(one.colour[static_cast<size_t>(k)])));
  }
  for (const float k : {1.0F, 0.0F, 0.0F, 0.0F}) set.rotations.push_back(k);
  set.logit_opacities.push_back(logit(one.opacity));
}

GaussianSet start_from_depth(const std::vector<SurfacePoint>& points, int64_t most_gaussians,
                             const SplatStartOptions& options) {
  std::vector<double> footprints;
  footprints.reserve(points.size());
  for (const SurfacePoint& point : points) footprints.push_back(point.footprint);
  double side = 0.5 * median(std::move(footprints));
  std::vector<Voxelled> sorted = by_voxel(points, side);
  for (int64_t voxels = voxels_of(sorted); voxels > most_gaussians; voxels = voxels_of(sorted)) {
    // Surfaces fill voxels as the square of their side; a few per cent more, so that this ends.
    side *=
        1.03 * std::max(1.0, std::sqrt(static_cast<double>(voxels) / static_cast<double>(most_gaussians)));
    sorted = by_voxel(points, side);
  }
  GaussianSet set;
  for (size_t begin = 0; begin < sorted.size();) {
    size_t end = begin;
    NewGaussian one{Eigen::Vector3d::Zero(), 0, {0, 0, 0}, options.opacity};
    for (; end < sorted.size() && sorted[end].voxel == sorted[begin].voxel; ++end) {
      const SurfacePoint& point = points[sorted[end].point];
      one.mean += point.x;
      one.scale += std::max(point.footprint, side);
      for (size_t c = 0; c < 3; ++c) one.colour[c] += point.colour[c];
    }
    const double share = 1 / static_cast<double>(end - begin);
    one.mean *= share;
    one.scale *= share * options.spread;
    for (double& colour : one.colour) colour *= share;
    add(set, one);
    begin = end;
  }
  return set;
}

// Gives the root mean square distance of a point from its three nearest neighbours, among those in the cells around it.
class Neighbours {
 public:
  explicit Neighbours(const std::vector<Eigen::Vector3d>& points) : points_(points), order_(points.size()) {
    for (size_t i = 0; i < order_.size(); ++i) order_[i] = i;
    std::sort(order_.begin(), order_.end(),
              [&](size_t a, size_t b) { return points_[a].x() < points_[b].x(); });
  }

  // Points are sorted by x: this looks outwards until x alone is farther away than what was found.
  double distance(size_t place) const {
    const Eigen::Vector3d& here = points_[order_[place]];
    std::array<double, 3> best;
    best.fill(1e300);
    const auto look = [&](size_t other) {
      const double apart = (points_[order_[other]] - here).squaredNorm();
      if (apart >= best[2]) return;
      best[2] = apart;
      std::sort(best.begin(), best.end());
    };
    const auto far = [&](size_t other) {
      const double dx = points_[order_[other]].x() - here.x();
      return dx * dx >= best[2];
    };
    for (size_t i = place; i-- > 0 && !far(i);) look(i);
    for (size_t i = place + 1; i < order_.size() && !far(i); ++i) look(i);
    double sum = 0, count = 0;
    for (const double apart : best) {
      if (apart > 1e299) continue;
      sum += apart;
      count += 1;
    }
    return count > 0 ? std::sqrt(sum / count) : 0;
  }
  size_t point(size_t place) const { return order_[place]; }

 private:
  const std::vector<Eigen::Vector3d>& points_;
  std::vector<size_t> order_;
};

std::array<double, 3> colour_of(const std::vector<SplatPicture>& pictures,
                                const Eigen::Vector3d& x_in_world) {
  std::array<double, 3> sum{};
  double count = 0;
  for (const SplatPicture& picture : pictures) {
    const Eigen::Vector3d x = picture.camera.intrinsics * (picture.camera.camera_from_world() * x_in_world);
    if (x.z() <= 0) continue;
    const double column = std::floor(x.x() / x.z()), row = std::floor(x.y() / x.z());
    if (!(column >= 0 && column < static_cast<double>(picture.image.width) && row >= 0 &&
          row < static_cast<double>(picture.image.height)))
      continue;
    if (!picture.says(static_cast<int64_t>(column), static_cast<int64_t>(row))) continue;
    const uint8_t* rgb = picture.image.pixel(static_cast<int64_t>(column), static_cast<int64_t>(row));
    for (size_t c = 0; c < 3; ++c) sum[c] += rgb[c] / 255.0;
    count += 1;
  }
  for (double& value : sum) value = count > 0 ? value / count : 0.5;
  return sum;
}

GaussianSet start_from_points(const std::vector<SplatPicture>& pictures,
                              const std::vector<Eigen::Vector3d>& all, const SceneReach& reach,
                              int64_t most_gaussians, const SplatStartOptions& options) {
  std::vector<Eigen::Vector3d> points;
  const size_t step =
      (all.size() + static_cast<size_t>(most_gaussians) - 1) / static_cast<size_t>(most_gaussians);
  for (size_t i = 0; i < all.size(); i += step) points.push_back(all[i]);
  const Neighbours neighbours(points);
  GaussianSet set;
  for (size_t place = 0; place < points.size(); ++place) {
    const Eigen::Vector3d& point = points[neighbours.point(place)];
    // Coincident points, and one alone, are given a size that can be seen and shrink.
    const double apart = std::max(neighbours.distance(place), 1e-4 * reach.extent);
    add(set,
        {point - reach.middle, apart * options.spread, colour_of(pictures, point), options.sparse_opacity});
  }
  return set;
}

}  // namespace

void SplatStartOptions::visit(FieldVisitor& visitor) {
  visit_choice(
      visitor,
      {"from",
       "what Gaussians begin on: depth, of the scene; match, what its pictures agree on; points, sparse ones; "
       "auto: depth, else points, else match"},
      from, splat_start_names());
  visitor.real({"opacity", "of Gaussians that depth puts on a surface"}, opacity, {0.01, 0.99});
  visitor.real({"sparse_opacity", "of Gaussians at sparse points"}, sparse_opacity, {0.01, 0.99});
  visitor.real({"spread", "their standard deviation, in the distance to the next one"}, spread, {0.01, 10});
}

SceneReach scene_reach(const std::vector<SplatPicture>& pictures,
                       const std::vector<Eigen::Vector3d>& points_in_world) {
  SceneReach reach;
  for (const SplatPicture& picture : pictures)
    reach.middle += picture.camera.world_from_camera.translation() / static_cast<double>(pictures.size());
  double farthest = 0;
  for (const SplatPicture& picture : pictures)
    farthest = std::max(farthest, (picture.camera.world_from_camera.translation() - reach.middle).norm());
  std::vector<double> distances;
  for (const SplatPicture& picture : pictures) {
    for (const float depth : depths_said(picture)) distances.push_back(depth);
  }
  for (const Eigen::Vector3d& point : points_in_world) distances.push_back((point - reach.middle).norm());
  const double typical = distances.empty() ? 0 : median(std::move(distances));
  // Cameras that stand together to their poses' rounding tell no length.
  constexpr double kTogether = 1e-6;
  reach.extent = farthest > kTogether * std::max(typical, reach.middle.norm()) ? 1.1 * farthest : typical;
  if (!(reach.extent > 0)) reach.extent = 1;
  return reach;
}

namespace {

[[noreturn]] void fail_without_start(const std::string& where, const std::string& expected,
                                     const std::string& found) {
  fail(
      {where, expected + " to start from", found,
       "give the scene depth files or pictures that overlap, taken with steps to the side, reconstruct it with "
       "COLMAP, or fit a run of gld sample --outputs image,depth"});
}

bool have_depth(const std::vector<SplatPicture>& pictures) {
  return std::any_of(pictures.begin(), pictures.end(),
                     [](const SplatPicture& picture) { return !depths_said(picture).empty(); });
}

}  // namespace

SplatStartFrom start_of(const std::vector<SplatPicture>& pictures,
                        const std::vector<Eigen::Vector3d>& points_in_world, SplatStartFrom from,
                        const std::string& where) {
  const bool depth = have_depth(pictures), points = !points_in_world.empty(), match = pictures.size() > 1;
  const SplatStartFrom start = settled_start(from, depth, points);
  if (start == SplatStartFrom::kDepth && !depth) fail_without_start(where, "pixels of known depth", "none");
  if (start == SplatStartFrom::kPoints && !points) fail_without_start(where, "sparse points", "none");
  if (start == SplatStartFrom::kMatch && !match) {
    if (from == SplatStartFrom::kMatch) fail_without_start(where, "several pictures", "one");
    fail_without_start(where, "measured or predicted depth, sparse points, or several pictures", "none");
  }
  return start;
}

SplatStartFrom settled_start(SplatStartFrom from, bool has_depth, bool has_points) {
  if (from != SplatStartFrom::kAuto) return from;
  if (has_depth) return SplatStartFrom::kDepth;
  return has_points ? SplatStartFrom::kPoints : SplatStartFrom::kMatch;
}

GaussianSet start_gaussians(const std::vector<SplatPicture>& pictures,
                            const std::vector<Eigen::Vector3d>& points_in_world, const SceneReach& reach,
                            int64_t most_gaussians, const SplatStartOptions& options,
                            const std::string& where) {
  GaussianSet set;
  if (options.from == SplatStartFrom::kPoints) {
    set = start_from_points(pictures, points_in_world, reach, most_gaussians, options);
  } else {
    const std::vector<SurfacePoint> surface = surface_points(pictures, reach.middle);
    if (surface.empty()) {
      fail_without_start(where,
                         options.from == SplatStartFrom::kMatch ? "pixels whose depth the pictures agree on"
                                                                : "pixels of known depth",
                         "none");
    }
    set = start_from_depth(surface, most_gaussians, options);
  }
  set.origin = reach.middle;
  return set;
}

}  // namespace gld
