#include "datasets/pictures/camera_layout_picture.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <fmt/format.h>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace gld {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kPanel = 600;
constexpr int kHeight = 640;
constexpr int kPanelMargin = 60;

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
  Panel(cv::Mat& paper, int left, const Frame3& axes, const Vector3d& vertical, double shown)
      : paper_(paper),
        left_(left),
        axes_(axes),
        vertical_(vertical),
        scale_((0.5 * kPanel - kPanelMargin) / shown) {}
  cv::Point at(const Vector3d& world) const {
    const Vector3d offset = world - axes_.centre;
    const double x = left_ + 0.5 * kPanel + scale_ * offset.dot(axes_.right);
    const double y = 0.5 * kHeight - scale_ * offset.dot(vertical_);
    return {static_cast<int>(std::lround(std::clamp(x, -1e4, 1e4))),
            static_cast<int>(std::lround(std::clamp(y, -1e4, 1e4)))};
  }
  void point(const Vector3d& world) const {
    const cv::Point p = at(world);
    if (p.x > left_ && p.x < left_ + kPanel) cv::circle(paper_, p, 1, cv::Scalar(200, 200, 200), cv::FILLED);
  }
  void camera(const Camera& camera, double length, const cv::Scalar& colour) const {
    const Eigen::Isometry3d& pose = camera.world_from_camera;
    const Eigen::Matrix3d& k = camera.intrinsics;
    std::vector<cv::Point> outline{at(pose.translation())};
    const double w = static_cast<double>(camera.width);
    const double h = static_cast<double>(camera.height);
    std::vector<cv::Point> corners;
    for (const Vector2d& corner : {Vector2d(0, 0), Vector2d(w, 0), Vector2d(w, h), Vector2d(0, h)}) {
      const Vector3d ray((corner.x() - k(0, 2)) / k(0, 0), (corner.y() - k(1, 2)) / k(1, 1), 1);
      corners.push_back(at(pose * (length * ray)));
    }
    for (size_t i = 0; i < 4; ++i) {
      cv::line(paper_, outline[0], corners[i], colour, 1, cv::LINE_AA);
      cv::line(paper_, corners[i], corners[(i + 1) % 4], colour, 1, cv::LINE_AA);
    }
    cv::circle(paper_, outline[0], 3, colour, cv::FILLED, cv::LINE_AA);
  }
  void text(const std::string& words, int y) const {
    cv::putText(paper_, words, {left_ + 20, y}, cv::FONT_HERSHEY_SIMPLEX, 0.5, cv::Scalar(60, 60, 60), 1,
                cv::LINE_AA);
  }
  void scale_bar(const std::string& unit) const {
    const double wanted = 120 / scale_;
    const double power = std::pow(10, std::floor(std::log10(wanted)));
    const double length = wanted > 5 * power ? 5 * power : wanted > 2 * power ? 2 * power : power;
    const int pixels = static_cast<int>(std::lround(length * scale_));
    cv::line(paper_, {left_ + 20, kHeight - 30}, {left_ + 20 + pixels, kHeight - 30}, cv::Scalar(60, 60, 60),
             2);
    text(fmt::format("{:g}{}", length, unit), kHeight - 38);
  }

 private:
  cv::Mat& paper_;
  int left_;
  const Frame3& axes_;
  Vector3d vertical_;
  double scale_;
};

}  // namespace

Image draw_camera_layout(const Scene& scene) {
  Image picture(2 * kPanel, kHeight);
  cv::Mat paper(kHeight, 2 * kPanel, CV_8UC3, picture.rgb.data());
  paper.setTo(cv::Scalar(255, 255, 255));
  if (scene.frames.empty()) return picture;
  const Frame3 axes = natural_axes(scene);
  const double reach = extent(scene, axes.centre);
  const Panel panels[] = {{paper, 0, axes, axes.away, 1.3 * reach},
                          {paper, kPanel, axes, axes.up, 1.3 * reach}};
  for (const Panel& panel : panels) {
    const size_t point_step = std::max<size_t>(1, scene.points_in_world.size() / 3000);
    for (size_t i = 0; i < scene.points_in_world.size(); i += point_step)
      panel.point(scene.points_in_world[i]);
    const size_t step = std::max<size_t>(1, scene.frames.size() / 80);
    for (size_t i = 0; i < scene.frames.size(); i += step) {
      const double t = scene.frames.size() > 1
                           ? static_cast<double>(i) / static_cast<double>(scene.frames.size() - 1)
                           : 0.0;
      panel.camera(scene.frames[i].camera, 0.18 * reach, cv::Scalar(40 + 190 * t, 60, 230 - 190 * t));
    }
    panel.scale_bar(scene.metric ? " m" : "");
  }
  panels[0].text("from above", 30);
  panels[1].text("from the side", 30);
  panels[0].text(fmt::format("{}: {} frames, first blue, last red", scene.name, scene.frames.size()), 52);
  cv::line(paper, {kPanel, 10}, {kPanel, kHeight - 10}, cv::Scalar(220, 220, 220), 1);
  return picture;
}

}  // namespace gld
