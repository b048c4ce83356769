#include "infer/run_export/depth_surface.h"

#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

namespace gld {
namespace {

// Relative difference of depth from a pixel to the next beyond which no surface is believed.
constexpr float kSteepest = 0.08F;
// So many pixels from a step count as its sides: predicted depth smears steps over a few.
constexpr int64_t kStepWidth = 4;
constexpr uint32_t kNoVertex = std::numeric_limits<uint32_t>::max();

// A step in a row or column of pixels.
struct Neighbour {
  int64_t dx = 0;
  int64_t dy = 0;
};

class SurfaceMaker {
 public:
  SurfaceMaker(const DepthMap& depth, const Camera& camera, const DepthSurfaceOptions& options)
      : options_(options), camera_(camera), full_width_(depth.width), full_height_(depth.height) {
    const int64_t step = options.step;
    around_ = std::max<int64_t>(2, (kStepWidth + step - 1) / step);
    grid_ = DepthMap((depth.width + step - 1) / step, (depth.height + step - 1) / step);
    for (int64_t y = 0; y < grid_.height; ++y) {
      for (int64_t x = 0; x < grid_.width; ++x) {
        const float value = depth.at(pixel(x, depth.width), pixel(y, depth.height));
        grid_.at(x, y) = is_known_depth(value) && value <= options.farthest ? value : 0;
      }
    }
    vertices_.assign(grid_.metres.size(), kNoVertex);
  }

  DepthSurface make() {
    for (int64_t y = 0; y + 1 < grid_.height; ++y) {
      for (int64_t x = 0; x + 1 < grid_.width; ++x) add_cell(x, y);
    }
    return std::move(surface_);
  }

 private:
  // Returns the pixel of a place of the grid; its last one is the picture's last.
  int64_t pixel(int64_t place, int64_t size) const {
    return std::min(place * options_.step + (options_.step - 1) / 2, size - 1);
  }

  // Returns how inverse depth changes from a place to the next one in that direction; nothing where one of them is not
  // known.
  std::optional<float> change(int64_t x, int64_t y, Neighbour next) const {
    if (x < 0 || y < 0 || x + next.dx >= grid_.width || y + next.dy >= grid_.height) return std::nullopt;
    const float a = grid_.at(x, y), b = grid_.at(x + next.dx, y + next.dy);
    if (!(a > 0) || !(b > 0)) return std::nullopt;
    return 1 / b - 1 / a;
  }

  // Returns the same some places away in that direction, or as far as the picture goes; where nothing is known there,
  // it is taken half as far on the other side.
  std::optional<float> change_near(int64_t x, int64_t y, Neighbour next, int64_t away) const {
    const int64_t here = next.dx > 0 ? x : y, last = (next.dx > 0 ? grid_.width : grid_.height) - 2;
    const auto change_at = [&](int64_t place) {
      return next.dx > 0 ? change(place, y, next) : change(x, place, next);
    };
    const int64_t there = std::clamp<int64_t>(here + away, 0, last);
    const auto found = there == here ? std::nullopt : change_at(there);
    return found ? found : change_at(here - away / 2);
  }

  // Returns whether a place and the next one in that direction are on one surface.
  bool joined(int64_t x, int64_t y, Neighbour next) const {
    const auto here = change(x, y, next);
    if (!here) return false;
    const float a = grid_.at(x, y), b = grid_.at(x + next.dx, y + next.dy), nearer = std::min(a, b);
    if (std::max(a, b) > (1 + kSteepest * static_cast<float>(options_.step)) * nearer) return false;
    // A step, smeared or not, is steeper than what lies on both its sides.
    double excess = std::numeric_limits<double>::infinity();
    for (const int64_t away : {-around_, around_}) {
      const auto there = change_near(x, y, next, away);
      if (there) excess = std::min(excess, static_cast<double>(std::abs(*here - *there) * nearer));
    }
    return !std::isfinite(excess) || excess <= options_.edge_step;
  }

  uint32_t vertex(int64_t x, int64_t y) {
    uint32_t& number = vertices_[static_cast<size_t>(y * grid_.width + x)];
    if (number != kNoVertex) return number;
    number = static_cast<uint32_t>(surface_.x_in_camera.size());
    const Eigen::Matrix3d& k = camera_.intrinsics;
    const double u = static_cast<double>(pixel(x, full_width_)) + 0.5;
    const double v = static_cast<double>(pixel(y, full_height_)) + 0.5;
    const double z = grid_.at(x, y);
    surface_.x_in_camera.push_back(
        Eigen::Vector3d((u - k(0, 2)) / k(0, 0) * z, (v - k(1, 2)) / k(1, 1) * z, z).cast<float>());
    surface_.texture.push_back(
        Eigen::Vector2d(u / static_cast<double>(full_width_), v / static_cast<double>(full_height_))
            .cast<float>());
    return number;
  }

  void add_triangle(uint32_t a, uint32_t b, uint32_t c) {
    surface_.corners.insert(surface_.corners.end(), {a, b, c});
  }

  // Adds the cell with that upper left corner: two triangles, or the one whose corners are joined, or none.
  void add_cell(int64_t x, int64_t y) {
    const bool top = joined(x, y, {1, 0}), bottom = joined(x, y + 1, {1, 0});
    const bool left = joined(x, y, {0, 1}), right = joined(x + 1, y, {0, 1});
    const auto upper_left = [&] { return vertex(x, y); };
    const auto upper_right = [&] { return vertex(x + 1, y); };
    const auto lower_left = [&] { return vertex(x, y + 1); };
    const auto lower_right = [&] { return vertex(x + 1, y + 1); };
    if (top && bottom && left && right) {
      // The cell is cut along the diagonal whose ends are nearer to each other, in inverse depth.
      const auto apart = [&](float a, float b) { return std::abs(1 / a - 1 / b); };
      if (apart(grid_.at(x, y), grid_.at(x + 1, y + 1)) < apart(grid_.at(x + 1, y), grid_.at(x, y + 1))) {
        add_triangle(upper_left(), lower_left(), lower_right());
        add_triangle(upper_left(), lower_right(), upper_right());
      } else {
        add_triangle(upper_left(), lower_left(), upper_right());
        add_triangle(upper_right(), lower_left(), lower_right());
      }
    } else if (top && left) {
      add_triangle(upper_left(), lower_left(), upper_right());
    } else if (top && right) {
      add_triangle(upper_left(), lower_right(), upper_right());
    } else if (bottom && left) {
      add_triangle(upper_left(), lower_left(), lower_right());
    } else if (bottom && right) {
      add_triangle(upper_right(), lower_left(), lower_right());
    }
  }

  const DepthSurfaceOptions& options_;
  const Camera& camera_;
  int64_t full_width_;
  int64_t full_height_;
  int64_t around_ = kStepWidth;  // places of the grid
  DepthMap grid_;
  std::vector<uint32_t> vertices_;  // of the grid's places
  DepthSurface surface_;
};

}  // namespace

DepthSurface depth_surface(const DepthMap& depth, const Camera& camera, const DepthSurfaceOptions& options) {
  if (options.step < 1) {
    fail({"depth surface", "a step of a pixel or more", std::to_string(options.step), "choose another"});
  }
  if (depth.width != camera.width || depth.height != camera.height) {
    fail({"depth surface", "depth of the camera's size " + size_text(camera.width, camera.height),
          size_text(depth.width, depth.height), "check what made it"});
  }
  return SurfaceMaker(depth, camera, options).make();
}

}  // namespace gld
