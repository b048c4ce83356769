#include "datasets/pictures/camera_layout_picture.h"

#include "datasets/pictures/drawing.h"
#include "gld/report/cairo_text.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <cairo.h>
#include <fmt/format.h>

namespace gld {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kPanel = 600;
constexpr int kHeight = 640;
constexpr int kPanelMargin = 60;
constexpr Rgb kInk{60, 60, 60};
constexpr Rgb kPointGrey{200, 200, 200};
constexpr Rgb kRule{220, 220, 220};
constexpr TextFont kFont{14, TextWeight::kRegular};

// Right, away and up as seen in the pictures.
struct Frame3 {
  Vector3d centre = Vector3d::Zero();
  Vector3d right = Vector3d::UnitX();
  Vector3d away = Vector3d::UnitY();
  Vector3d up = Vector3d::UnitZ();
};

Frame3 natural_axes(const Scene& scene) {
  Frame3 axes;
  Vector3d up = Vector3d::Zero();
  for (const Frame& frame : scene.frames) {
    axes.centre += frame.camera.world_from_camera.translation();
    up -= frame.camera.world_from_camera.linear().col(1);
  }
  axes.centre /= static_cast<double>(scene.frames.size());
  axes.up = up.norm() > 1e-6 ? up.normalized() : Vector3d::UnitZ();
  Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();
  for (const Frame& frame : scene.frames) {
    Vector3d offset = frame.camera.world_from_camera.translation() - axes.centre;
    offset -= offset.dot(axes.up) * axes.up;
    spread += offset * offset.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(spread);
  Vector3d right = solver.eigenvectors().col(2);
  right -= right.dot(axes.up) * axes.up;
  if (right.norm() < 1e-6) right = axes.up.unitOrthogonal();
  axes.right = right.normalized();
  axes.away = axes.up.cross(axes.right);
  return axes;
}

double extent(const Scene& scene, const Vector3d& centre) {
  double largest = 0;
  for (const Frame& frame : scene.frames) {
    largest = std::max(largest, (frame.camera.world_from_camera.translation() - centre).norm());
  }
  return largest > 0 ? largest : 1;
}

// One of the two pictures: horizontal and vertical world directions on the paper.
class Panel {
 public:
  Panel(cairo_t* cairo, double left, const Frame3& axes, const Vector3d& vertical, double shown)
      : cairo_(cairo),
        left_(left),
        axes_(axes),
        vertical_(vertical),
        scale_((0.5 * kPanel - kPanelMargin) / shown) {}
  // Returns pixels, clamped to what cairo's fixed-point numbers take.
  Vector2d at(const Vector3d& world) const {
    const Vector3d offset = world - axes_.centre;
    const double x = left_ + 0.5 * kPanel + scale_ * offset.dot(axes_.right);
    const double y = 0.5 * kHeight - scale_ * offset.dot(vertical_);
    return {std::clamp(x, -1e4, 1e4), std::clamp(y, -1e4, 1e4)};
  }
  void point(const Vector3d& world) const {
    const Vector2d p = at(world);
    if (!(p.x() > left_ && p.x() < left_ + kPanel)) return;
    set_source(cairo_, kPointGrey);
    cairo_rectangle(cairo_, std::floor(p.x()) - 1, std::floor(p.y()), 3, 1);
    cairo_rectangle(cairo_, std::floor(p.x()), std::floor(p.y()) - 1, 1, 3);
    cairo_fill(cairo_);
  }
  void camera(const Camera& camera, double length, const Rgb& colour) const {
    const Eigen::Isometry3d& pose = camera.world_from_camera;
    const Eigen::Matrix3d& k = camera.intrinsics;
    const Vector2d centre = at(pose.translation());
    const double w = static_cast<double>(camera.width);
    const double h = static_cast<double>(camera.height);
    std::vector<Vector2d> corners;
    for (const Vector2d& corner : {Vector2d(0, 0), Vector2d(w, 0), Vector2d(w, h), Vector2d(0, h)}) {
      const Vector3d ray((corner.x() - k(0, 2)) / k(0, 0), (corner.y() - k(1, 2)) / k(1, 1), 1);
      corners.push_back(at(pose * (length * ray)));
    }
    set_source(cairo_, colour);
    cairo_set_line_width(cairo_, 1.2);
    for (size_t i = 0; i < 4; ++i) {
      cairo_move_to(cairo_, centre.x(), centre.y());
      cairo_line_to(cairo_, corners[i].x(), corners[i].y());
      cairo_line_to(cairo_, corners[(i + 1) % 4].x(), corners[(i + 1) % 4].y());
    }
    cairo_stroke(cairo_);
    cairo_arc(cairo_, centre.x(), centre.y(), 3, 0, 2 * M_PI);
    cairo_fill(cairo_);
  }
  void text(const std::string& words, double y) const {
    set_source(cairo_, kInk);
    show_text(cairo_, left_ + 20, y, shortened_text(words, kPanel - 40, kFont), kFont);
  }
  void scale_bar(const std::string& unit) const {
    const double wanted = 120 / scale_;
    const double power = std::pow(10, std::floor(std::log10(wanted)));
    const double length = wanted > 5 * power ? 5 * power : wanted > 2 * power ? 2 * power : power;
    set_source(cairo_, kInk);
    cairo_rectangle(cairo_, left_ + 20, kHeight - 31, length * scale_, 2);
    cairo_fill(cairo_);
    text(fmt::format("{:g}{}", length, unit), kHeight - 38);
  }

 private:
  cairo_t* cairo_;
  double left_;
  const Frame3& axes_;
  Vector3d vertical_;
  double scale_;
};

void paint_layout(cairo_t* cairo, const Scene& scene) {
  const Frame3 axes = natural_axes(scene);
  const double reach = extent(scene, axes.centre);
  const Panel panels[] = {{cairo, 0, axes, axes.away, 1.3 * reach},
                          {cairo, kPanel, axes, axes.up, 1.3 * reach}};
  for (const Panel& panel : panels) {
    const size_t point_step = std::max<size_t>(1, scene.points_in_world.size() / 3000);
    for (size_t i = 0; i < scene.points_in_world.size(); i += point_step)
      panel.point(scene.points_in_world[i]);
    const size_t step = std::max<size_t>(1, scene.frames.size() / 80);
    for (size_t i = 0; i < scene.frames.size(); i += step) {
      const double t = scene.frames.size() > 1
                           ? static_cast<double>(i) / static_cast<double>(scene.frames.size() - 1)
                           : 0.0;
      const Rgb colour{static_cast<uint8_t>(40 + 190 * t), 60, static_cast<uint8_t>(230 - 190 * t)};
      panel.camera(scene.frames[i].camera, 0.18 * reach, colour);
    }
    panel.scale_bar(scene.metric ? " m" : "");
  }
  panels[0].text("from above", 30);
  panels[1].text("from the side", 30);
  const std::string frames = fmt::format(": {} frames, first blue, last red", scene.frames.size());
  const double room = kPanel - 40 - text_extent(frames, kFont).width;
  panels[0].text(shortened_text(scene.name, room, kFont) + frames, 52);
  set_source(cairo, kRule);
  cairo_rectangle(cairo, kPanel, 10, 1, kHeight - 20);
  cairo_fill(cairo);
}

}  // namespace

Image draw_camera_layout(const Scene& scene) {
  Image picture = filled_image(2 * kPanel, kHeight, {255, 255, 255});
  if (scene.frames.empty()) return picture;
  paint_with_cairo(picture, {0, 0, picture.width, picture.height},
                   [&](cairo_t* cairo) { paint_layout(cairo, scene); });
  return picture;
}

}  // namespace gld
