#include "gld/cameras/view_visibility.h"

#include "gld/base/error.h"
#include "gld/cameras/convex_piece.h"
#include "gld/cameras/relative_cameras.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

namespace gld {
namespace {

// Cameras, crops and depth are never exact, and what lies beside an image still says something about it.
constexpr double kImageMargin = 0.1;  // of the image's sides, on every side
// Cameras alone: the nearest and farthest depth that is looked at, in largest distances between camera centres.
constexpr double kNear = 0.01;
constexpr double kFar = 100;
// With depth: how far behind its surface a source's space ends, and what a target may see, in depths of the sources.
constexpr double kBehindSurface = 1.25;
constexpr double kTargetFar = 2;
// Nearer than this share of the sources' nearest surface there is nothing but air, also for targets.
constexpr double kOnlyAir = 0.1;
// Share of a depth map's pixels that may be outliers on either side.
constexpr double kOutliers = 0.01;
// Cells along the longer side of a depth map.
constexpr int64_t kCells = 12;

// What one view can see, as a union of convex solids.
struct SeenSpace {
  ConvexPiece whole;                // contains all of them
  std::vector<ConvexPiece> pieces;  // empty: `whole` itself
};

// The nearest and farthest known depth without outliers; {infinity, 0} when nothing is known.
struct DepthRange {
  double nearest = std::numeric_limits<double>::infinity();
  double farthest = 0;
};

DepthRange depth_range(const PlanarDepth& depth) {
  std::vector<float> values;
  std::copy_if(depth.values.begin(), depth.values.end(), std::back_inserter(values), PlanarDepth::known);
  if (values.empty()) return {};
  std::sort(values.begin(), values.end());
  const auto last = static_cast<double>(values.size() - 1);
  return {values[static_cast<size_t>(kOutliers * last)], values[static_cast<size_t>((1 - kOutliers) * last)]};
}

// Depths between which views are compared, in the unit of the poses.
struct SceneDepths {
  double near = kNear;  // of views without depth
  double far = kFar;
  std::vector<DepthRange> sources;  // empty without depth
};

double largest_distance(const Views& views) {
  double largest = 0;
  for (const Camera& a : views.cameras) {
    for (const Camera& b : views.cameras) {
      const Eigen::Vector3d between = a.world_from_camera.translation() - b.world_from_camera.translation();
      largest = std::max(largest, between.norm());
    }
  }
  return largest;
}

// Without a baseline every length is as good as another: all pyramids have one apex.
SceneDepths depths_from_cameras(const Views& views) {
  const double extent = largest_distance(views);
  SceneDepths depths;
  if (extent > 0) {
    depths.near *= extent;
    depths.far *= extent;
  }
  return depths;
}

// Also where a depth map knows nothing: what the others say of the scene's size is better than the cameras' guess.
SceneDepths with_source_depth(const SceneDepths& from_cameras, const std::vector<PlanarDepth>& source_depth) {
  SceneDepths depths = from_cameras;
  DepthRange all;
  for (const auto& depth : source_depth) {
    depths.sources.push_back(depth_range(depth));
    all.nearest = std::min(all.nearest, depths.sources.back().nearest);
    all.farthest = std::max(all.farthest, depths.sources.back().farthest);
  }
  if (all.farthest == 0) return from_cameras;
  depths.near = kOnlyAir * all.nearest;
  depths.far = std::max(kTargetFar, kBehindSurface) * all.farthest;
  return depths;
}

FrustumPart whole_image(double near, double far) {
  return {-kImageMargin, 1 + kImageMargin, -kImageMargin, 1 + kImageMargin, near, far};
}

SeenSpace space_without_depth(const Camera& camera, const SceneDepths& depths) {
  return {frustum_piece(camera, whole_image(depths.near, depths.far)), {}};
}

// The largest depth of a block of pixels; `unknown` where one of them is not known.
double farthest_in(const PlanarDepth& depth, const int64_t (&columns)[2], const int64_t (&rows)[2],
                   double unknown) {
  double farthest = 0;
  for (int64_t row = rows[0]; row < rows[1]; ++row) {
    for (int64_t column = columns[0]; column < columns[1]; ++column) {
      const float value = depth.values[static_cast<size_t>(row * depth.width + column)];
      if (!PlanarDepth::known(value)) return unknown;
      farthest = std::max(farthest, static_cast<double>(value));
    }
  }
  return farthest;
}

SeenSpace space_with_depth(const Camera& camera, const PlanarDepth& depth, const DepthRange& range,
                           const SceneDepths& depths) {
  if (range.farthest == 0) return space_without_depth(camera, depths);
  const double near = kOnlyAir * range.nearest;
  const int64_t longer = std::max(depth.width, depth.height);
  const auto cells = [&](int64_t side) {
    return std::min(side, std::max<int64_t>(1, (kCells * side + longer - 1) / longer));
  };
  const int64_t cell_columns = cells(depth.width), cell_rows = cells(depth.height);
  // Outermost cells reach into the margin.
  const auto border = [](int64_t index, int64_t count) {
    const double inside = static_cast<double>(index) / static_cast<double>(count);
    return index == 0 ? -kImageMargin : index == count ? 1 + kImageMargin : inside;
  };
  SeenSpace space;
  double farthest = 0;
  for (int64_t row = 0; row < cell_rows; ++row) {
    for (int64_t column = 0; column < cell_columns; ++column) {
      const int64_t columns[2] = {column * depth.width / cell_columns,
                                  (column + 1) * depth.width / cell_columns};
      const int64_t rows[2] = {row * depth.height / cell_rows, (row + 1) * depth.height / cell_rows};
      FrustumPart part{border(column, cell_columns), border(column + 1, cell_columns), border(row, cell_rows),
                       border(row + 1, cell_rows)};
      part.near = near;
      part.far = std::clamp(kBehindSurface * farthest_in(depth, columns, rows, depths.far), near, depths.far);
      farthest = std::max(farthest, part.far);
      space.pieces.push_back(frustum_piece(camera, part));
    }
  }
  space.whole = frustum_piece(camera, whole_image(near, farthest));
  return space;
}

bool share_space(const SeenSpace& a, const SeenSpace& b) {
  if (!intersects(a.whole, b.whole)) return false;
  const auto any_piece = [](const SeenSpace& space, const ConvexPiece& other) {
    if (space.pieces.empty()) return intersects(space.whole, other);
    return std::any_of(space.pieces.begin(), space.pieces.end(),
                       [&](const ConvexPiece& piece) { return intersects(piece, other); });
  };
  if (a.pieces.empty()) return any_piece(b, a.whole);
  return std::any_of(a.pieces.begin(), a.pieces.end(), [&](const ConvexPiece& piece) {
    return intersects(piece, b.whole) && any_piece(b, piece);
  });
}

// The source view that stands nearest and looks most alike.
int64_t most_alike_source(const Views& views, int64_t target) {
  const auto& pose = views.cameras[static_cast<size_t>(target)].world_from_camera;
  const double extent = largest_distance(views);
  int64_t best = 0;
  double smallest = std::numeric_limits<double>::infinity();
  for (int64_t source = 0; source < views.num_sources; ++source) {
    const auto& other = views.cameras[static_cast<size_t>(source)].world_from_camera;
    const double distance = (pose.translation() - other.translation()).norm();
    const double unlike =
        1 - pose.linear().col(2).dot(other.linear().col(2)) + (extent > 0 ? distance / extent : 0);
    if (unlike < smallest) {
      smallest = unlike;
      best = source;
    }
  }
  return best;
}

std::vector<PlanarDepth> scaled(std::vector<PlanarDepth> depths, double factor) {
  for (auto& depth : depths) {
    for (float& value : depth.values) value = static_cast<float>(value * factor);
  }
  return depths;
}

void check_source_depth(const Views& views, const std::vector<PlanarDepth>& source_depth) {
  if (source_depth.empty()) return;
  if (static_cast<int64_t>(source_depth.size()) != views.num_sources) {
    fail({"source depth", fmt::format("one map for each of {} source views", views.num_sources),
          fmt::format("{} maps", source_depth.size()), "give depth of all source views, or of none"});
  }
  for (const auto& depth : source_depth) {
    if (depth.width > 0 && depth.height > 0 &&
        static_cast<int64_t>(depth.values.size()) == depth.width * depth.height) {
      continue;
    }
    fail({"source depth", "a map with width x height values",
          fmt::format("{} values for {} x {}", depth.values.size(), depth.width, depth.height),
          "check what makes the maps"});
  }
}

}  // namespace

bool ViewVisibility::all() const {
  return std::all_of(attends.begin(), attends.end(), [](uint8_t value) { return value != 0; });
}

double ViewVisibility::kept() const {
  const auto count = std::count_if(attends.begin(), attends.end(), [](uint8_t value) { return value != 0; });
  return attends.empty() ? 1 : static_cast<double>(count) / static_cast<double>(attends.size());
}

ViewVisibility view_visibility(const Views& views, const std::vector<PlanarDepth>& source_depth) {
  check_source_depth(views, source_depth);
  ViewVisibility visibility;
  visibility.views = views.size();
  if (views.size() == 0) return visibility;
  const RelativeCameras relative = relative_cameras(views);
  const Views& near_origin = relative.views;
  const auto depth = scaled(source_depth, relative.translation_scale);
  const SceneDepths from_cameras = depths_from_cameras(near_origin);
  const SceneDepths depths = depth.empty() ? from_cameras : with_source_depth(from_cameras, depth);
  visibility.used_depth = !depths.sources.empty();

  std::vector<SeenSpace> spaces;
  for (size_t view = 0; view < near_origin.cameras.size(); ++view) {
    const Camera& camera = near_origin.cameras[view];
    spaces.push_back(view < depths.sources.size()
                         ? space_with_depth(camera, depth[view], depths.sources[view], depths)
                         : space_without_depth(camera, depths));
  }
  const auto count = static_cast<size_t>(views.size());
  visibility.attends.assign(count * count, 0);
  const auto set = [&](size_t a, size_t b) {
    visibility.attends[a * count + b] = visibility.attends[b * count + a] = 1;
  };
  for (size_t a = 0; a < count; ++a) {
    set(a, a);
    for (size_t b = 0; b < a; ++b) {
      if (share_space(spaces[a], spaces[b])) set(a, b);
    }
  }
  for (int64_t target = views.num_sources; target < views.size(); ++target) {
    bool sees_source = false;
    for (int64_t source = 0; source < views.num_sources; ++source) {
      sees_source = sees_source || visibility.attends_to(target, source);
    }
    if (sees_source || views.num_sources == 0) continue;
    set(static_cast<size_t>(target), static_cast<size_t>(most_alike_source(near_origin, target)));
    visibility.lonely_targets.push_back(target);
  }
  return visibility;
}

std::string view_visibility_text(const ViewVisibility& visibility) {
  const int64_t pairs = visibility.views * visibility.views;
  const auto kept = static_cast<int64_t>(std::lround(visibility.kept() * static_cast<double>(pairs)));
  std::string text = fmt::format("view pairs that attend: {} of {} ({:.0f} %), by {}\n", kept, pairs,
                                 100 * visibility.kept(),
                                 visibility.used_depth ? "cameras and the sources' depth" : "cameras alone");
  if (visibility.all()) return text;
  for (int64_t a = 0; a < visibility.views; ++a) {
    text += fmt::format("  view {:>3} ", a);
    for (int64_t b = 0; b < visibility.views; ++b) text += visibility.attends_to(a, b) ? '#' : '.';
    text += '\n';
  }
  return text;
}

}  // namespace gld
