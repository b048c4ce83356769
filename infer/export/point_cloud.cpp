#include "infer/export/point_cloud.h"

#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include <Eigen/Geometry>

namespace gld {
namespace {

constexpr double kLargestCoordinate = 1e30;  // far inside float's range, so that no file overflows

void check_view(const PointView& view, size_t index, PointLifting lifting) {
  const std::string where = "point cloud, view " + std::to_string(index);
  if (view.image.empty()) fail({where, "an image to colour the points", "none", "decode the image as well"});
  if (view.camera.width < 1 || view.camera.height < 1) {
    fail({where, "a camera with a size", size_text(view.camera.width, view.camera.height),
          "check the camera"});
  }
  if (!view.confidence.empty() &&
      (view.confidence.width != view.depth.width || view.confidence.height != view.depth.height)) {
    fail({where, "confidences of the depth's size " + size_text(view.depth.width, view.depth.height),
          size_text(view.confidence.width, view.confidence.height), "check what made them"});
  }
  if (lifting == PointLifting::kRays && view.rays.empty()) {
    fail({where, "a ray map to lift the depth with", "none", "predict rays as well"});
  }
  if (lifting == PointLifting::kPointMaps &&
      (view.points.width != view.depth.width || view.points.height != view.depth.height)) {
    fail({where, "a point map of the depth's size " + size_text(view.depth.width, view.depth.height),
          view.points.empty() ? "none" : size_text(view.points.width, view.points.height),
          "take a model whose head predicts points, or another points.lifting"});
  }
}

float confidence_at(const PointView& view, int64_t x, int64_t y) {
  return view.confidence.empty() ? 1.0F : view.confidence.at(x, y);
}

bool is_candidate(const PointView& view, int64_t x, int64_t y) {
  const float confidence = confidence_at(view, x, y);
  return is_known_depth(view.depth.at(x, y)) && confidence > 0 && std::isfinite(confidence);
}

template <class Value>
Value quantile(std::vector<Value>& values, double fraction) {
  const auto nth =
      values.begin() + static_cast<std::ptrdiff_t>(fraction * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), nth, values.end());
  return *nth;
}

struct Limits {
  float confidence = 0;
  double depth = std::numeric_limits<double>::infinity();  // in units of the depth maps
};

Limits find_limits(const std::vector<PointView>& views, const PointCloudOptions& options) {
  std::vector<float> confidences;
  std::vector<float> depths;
  for (const PointView& view : views) {
    for (int64_t y = 0; y < view.depth.height; ++y) {
      for (int64_t x = 0; x < view.depth.width; ++x) {
        if (!is_candidate(view, x, y)) continue;
        confidences.push_back(confidence_at(view, x, y));
        depths.push_back(view.depth.at(x, y));
      }
    }
  }
  Limits limits;
  if (depths.empty()) return limits;
  if (options.confidence_quantile > 0) limits.confidence = quantile(confidences, options.confidence_quantile);
  if (options.far_limit > 0) limits.depth = options.far_limit * static_cast<double>(quantile(depths, 0.5));
  return limits;
}

// Where a position lies between the middles of two neighbouring cells of a map; the share is outside 0..1 beyond the
// outermost middles.
struct Between {
  int64_t first = 0;
  int64_t second = 0;
  double share = 0;  // of the second
};

Between between_cells(double position, int64_t cells) {
  const double from_first_middle = position * static_cast<double>(cells) - 0.5;
  if (cells < 2) return {};
  const auto first = std::clamp<int64_t>(static_cast<int64_t>(std::floor(from_first_middle)), 0, cells - 2);
  return {first, first + 1, from_first_middle - static_cast<double>(first)};
}

// The points of one view.
class ViewLifter {
 public:
  ViewLifter(const PointView& view, double depth_scale, PointLifting lifting)
      : view_(view), depth_scale_(depth_scale), lifting_(lifting) {}

  // The result is not finite where the ray or the predicted point is not.
  Eigen::Vector3d x_in_world(int64_t x, int64_t y) const {
    if (lifting_ == PointLifting::kPointMaps) {
      return view_.world_from_rays *
             Eigen::Map<const Eigen::Vector3f>(view_.points.point(x, y)).cast<double>();
    }
    // Of the picture's width and height.
    const double right = (static_cast<double>(x) + 0.5) / static_cast<double>(view_.depth.width);
    const double down = (static_cast<double>(y) + 0.5) / static_cast<double>(view_.depth.height);
    const double z = static_cast<double>(view_.depth.at(x, y)) * depth_scale_;
    return lifting_ == PointLifting::kRays ? by_ray(right, down, z) : by_camera(right, down, z);
  }

  Rgb colour(int64_t x, int64_t y) const {
    const Image& image = view_.image;
    const uint8_t* pixel = image.pixel((2 * x + 1) * image.width / (2 * view_.depth.width),
                                       (2 * y + 1) * image.height / (2 * view_.depth.height));
    return {pixel[0], pixel[1], pixel[2]};
  }

 private:
  Eigen::Vector3d by_camera(double right, double down, double z) const {
    const Camera& camera = view_.camera;
    const Eigen::Matrix3d& k = camera.intrinsics;
    const double u = right * static_cast<double>(camera.width);
    const double v = down * static_cast<double>(camera.height);
    return camera.world_from_camera *
           Eigen::Vector3d((u - k(0, 2)) / k(0, 0) * z, (v - k(1, 2)) / k(1, 1) * z, z);
  }

  Eigen::Vector3d by_ray(double right, double down, double z) const {
    const Between column = between_cells(right, view_.rays.width);
    const Between row = between_cells(down, view_.rays.height);
    Eigen::Matrix<double, 6, 1> ray = Eigen::Matrix<double, 6, 1>::Zero();
    for (const bool lower : {false, true}) {
      for (const bool righter : {false, true}) {
        const double weight =
            (lower ? row.share : 1 - row.share) * (righter ? column.share : 1 - column.share);
        const float* corner =
            view_.rays.ray(righter ? column.second : column.first, lower ? row.second : row.first);
        ray += weight * Eigen::Map<const Eigen::Matrix<float, 6, 1>>(corner).cast<double>();
      }
    }
    return view_.world_from_rays * (ray.tail<3>() + z * ray.head<3>());
  }

  const PointView& view_;
  double depth_scale_;
  PointLifting lifting_;
};

void add_view(const PointView& view, double depth_scale, const Limits& limits,
              const PointCloudOptions& options, PointCloud& cloud) {
  const ViewLifter lifter(view, depth_scale, options.lifting);
  const std::vector<uint8_t> edges = depth_edges(view.depth, options.edge_step);
  PointCounts& counts = cloud.counts;
  for (int64_t y = 0; y < view.depth.height; ++y) {
    for (int64_t x = 0; x < view.depth.width; ++x) {
      ++counts.pixels;
      const float confidence = confidence_at(view, x, y);
      if (!is_candidate(view, x, y)) {
        ++counts.unknown_depth;
      } else if (confidence < limits.confidence) {
        ++counts.low_confidence;
      } else if (edges[static_cast<size_t>(y * view.depth.width + x)] != 0) {
        ++counts.depth_edges;
      } else {
        const Eigen::Vector3d point = lifter.x_in_world(x, y);
        if (view.depth.at(x, y) > limits.depth) {
          ++counts.too_far;
          continue;
        }
        if (!point.allFinite()) {
          ++counts.unknown_depth;
          continue;
        }
        if (point.cwiseAbs().maxCoeff() >= kLargestCoordinate) {
          ++counts.too_far;
          continue;
        }
        cloud.x_in_world.push_back(point);
        cloud.colours.push_back(lifter.colour(x, y));
        cloud.confidences.push_back(confidence);
      }
    }
  }
}

struct GridCell {
  uint64_t key = 0;
  size_t point = 0;
};

// Returns the cell of each point, with 21 bits an axis.
std::vector<GridCell> grid_cells(const PointCloud& cloud, const Eigen::Vector3d& corner, double cell_size) {
  constexpr double kLastCell = (1 << 21) - 1;
  std::vector<GridCell> cells(cloud.x_in_world.size());
  for (size_t i = 0; i < cells.size(); ++i) {
    cells[i].point = i;
    for (int axis = 0; axis < 3; ++axis) {
      const double cell = std::floor((cloud.x_in_world[i][axis] - corner[axis]) / cell_size);
      cells[i].key = (cells[i].key << 21) | static_cast<uint64_t>(std::clamp(cell, 0.0, kLastCell));
    }
  }
  return cells;
}

// Returns the surest point of each cell, the first of equals; they are in the order of the cloud.
std::vector<size_t> kept_points(const PointCloud& cloud, std::vector<GridCell> cells) {
  std::sort(cells.begin(), cells.end(), [&](const GridCell& a, const GridCell& b) {
    if (a.key != b.key) return a.key < b.key;
    if (cloud.confidences[a.point] != cloud.confidences[b.point]) {
      return cloud.confidences[a.point] > cloud.confidences[b.point];
    }
    return a.point < b.point;
  });
  std::vector<size_t> kept;
  for (size_t i = 0; i < cells.size(); ++i) {
    if (i == 0 || cells[i].key != cells[i - 1].key) kept.push_back(cells[i].point);
  }
  std::sort(kept.begin(), kept.end());
  return kept;
}

}  // namespace

const std::vector<std::string>& point_lifting_names() {
  static const std::vector<std::string> names{"cameras", "rays", "point_maps"};
  return names;
}

void PointCloudOptions::visit(FieldVisitor& visitor) {
  visit_choice(
      visitor,
      {"lifting",
       "what turns depth into points: the views' cameras, the predicted rays (the paper's way), or the "
       "predicted points themselves (VGGT's)"},
      lifting, point_lifting_names());
  visitor.real({"confidence_quantile", "fraction of the least sure pixels to leave out"}, confidence_quantile,
               {0, 1});
  visitor.real({"edge_step", "relative step of inverse depth that counts as an edge"}, edge_step,
               {1e-6, 1e6});
  visitor.real({"far_limit", "leave out what is deeper than this many median depths (0: nothing)"}, far_limit,
               {0, 1e30});
  visitor.integer({"max_points", "thin the cloud to at most this many points"}, max_points,
                  {1, 1'000'000'000});
}

std::vector<uint8_t> depth_edges(const DepthMap& depth, double step) {
  std::vector<uint8_t> edges(depth.metres.size(), 0);
  const auto bends = [&](int64_t x, int64_t y, int64_t dx, int64_t dy) {
    if (x < dx || y < dy || x + dx >= depth.width || y + dy >= depth.height) return false;
    const float before = depth.at(x - dx, y - dy);
    const float here = depth.at(x, y);
    const float after = depth.at(x + dx, y + dy);
    if (!is_known_depth(before) || !is_known_depth(here) || !is_known_depth(after)) return false;
    const double z = here;
    return std::abs(z / before - 2 + z / after) > step;
  };
  for (int64_t y = 0; y < depth.height; ++y) {
    for (int64_t x = 0; x < depth.width; ++x) {
      edges[static_cast<size_t>(y * depth.width + x)] = bends(x, y, 1, 0) || bends(x, y, 0, 1) ? 1 : 0;
    }
  }
  return edges;
}

PointCloud build_point_cloud(const std::vector<PointView>& views, double depth_scale,
                             const PointCloudOptions& options) {
  if (!(depth_scale > 0) || !std::isfinite(depth_scale)) {
    fail({"point cloud", "a positive depth scale", std::to_string(depth_scale), "check the cameras"});
  }
  for (size_t i = 0; i < views.size(); ++i) check_view(views[i], i, options.lifting);
  const Limits limits = find_limits(views, options);
  PointCloud cloud;
  for (const PointView& view : views) add_view(view, depth_scale, limits, options, cloud);
  thin_point_cloud(cloud, options.max_points);
  return cloud;
}

double thin_point_cloud(PointCloud& cloud, int64_t max_points) {
  if (cloud.size() <= max_points) return 0;
  Eigen::Vector3d corner = cloud.x_in_world.front();
  Eigen::Vector3d opposite = corner;
  for (const Eigen::Vector3d& point : cloud.x_in_world) {
    corner = corner.cwiseMin(point);
    opposite = opposite.cwiseMax(point);
  }
  const double diagonal = std::max((opposite - corner).norm(), 1e-30);
  double cell_size = diagonal / std::min(16 * std::sqrt(static_cast<double>(max_points)), 1e6);
  std::vector<size_t> kept = kept_points(cloud, grid_cells(cloud, corner, cell_size));
  while (static_cast<int64_t>(kept.size()) > max_points) {
    // Points of a surface become fewer with the square of the cell size.
    const double excess = static_cast<double>(kept.size()) / static_cast<double>(max_points);
    cell_size *= std::max(std::sqrt(excess), 1.02);
    kept = kept_points(cloud, grid_cells(cloud, corner, cell_size));
  }
  PointCloud thinned;
  thinned.counts = cloud.counts;
  thinned.counts.thinned += cloud.size() - static_cast<int64_t>(kept.size());
  for (const size_t point : kept) {
    thinned.x_in_world.push_back(cloud.x_in_world[point]);
    thinned.colours.push_back(cloud.colours[point]);
    thinned.confidences.push_back(cloud.confidences[point]);
  }
  cloud = std::move(thinned);
  return cell_size;
}

}  // namespace gld
