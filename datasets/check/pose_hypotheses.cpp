#include "datasets/check/pose_hypotheses.h"

#include "datasets/check/depth_warp.h"
#include "datasets/scenes/frame_checks.h"
#include "datasets/scenes/resize_crop.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <opencv2/core.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>

namespace gld {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr std::array<PoseMeaning, 4> kMeanings{PoseMeaning::kAsRead, PoseMeaning::kOpenGl,
                                               PoseMeaning::kInverted, PoseMeaning::kInvertedOpenGl};
constexpr int64_t kWorkingSide = 640;     // pixels; larger images are shrunk first
constexpr double kEpipolarTolerance = 2;  // pixels
constexpr double kDepthTolerance = 0.02;  // relative

// What one pair of frames says for each meaning.
struct Tally {
  int64_t comparisons = 0;
  std::array<double, 4> agreeing{};
  std::vector<double> depths;  // of points that agree as read
};

ImageSize working_size(const Camera& camera) {
  const int64_t larger = std::max(camera.width, camera.height);
  if (larger <= kWorkingSide) return {camera.width, camera.height};
  const double scale = static_cast<double>(kWorkingSide) / static_cast<double>(larger);
  return {std::max<int64_t>(2, std::llround(camera.width * scale)),
          std::max<int64_t>(2, std::llround(camera.height * scale))};
}

Tally compare_depth(const Frame& a, const Frame& b) {
  const SizedFrame first{a.camera, {}, a.depth(), {}};
  const SizedFrame second{b.camera, {}, b.depth(), {}};
  Tally tally;
  const auto pixels = static_cast<double>(first.depth.metres.size());
  tally.comparisons = static_cast<int64_t>(pixels);
  for (size_t i = 0; i < kMeanings.size(); ++i) {
    const WarpResult warp =
        warp_depth({reinterpreted(first.camera, kMeanings[i]), first.depth},
                   {reinterpreted(second.camera, kMeanings[i]), second.depth}, kDepthTolerance);
    tally.agreeing[i] = pixels * warp.share_in_view * warp.share_agreeing;
  }
  return tally;
}

struct Features {
  Camera camera;
  std::vector<cv::KeyPoint> points;
  cv::Mat descriptors;
};

Features detect(const Frame& frame) {
  const SizedFrame sized = load_sized(frame, working_size(frame.camera), FrameParts::kImage);
  const cv::Mat rgb(static_cast<int>(sized.image.height), static_cast<int>(sized.image.width), CV_8UC3,
                    const_cast<uint8_t*>(sized.image.rgb.data()));
  cv::Mat grey;
  cv::cvtColor(rgb, grey, cv::COLOR_RGB2GRAY);
  Features features;
  features.camera = sized.camera;
  const int border = static_cast<int>(std::min<int64_t>(31, std::min(grey.rows, grey.cols) / 4));
  cv::ORB::create(1500, 1.2F, 8, border, 0, 2, cv::ORB::HARRIS_SCORE, border, 10)
      ->detectAndCompute(grey, cv::noArray(), features.points, features.descriptors);
  return features;
}

// Returns pixel pairs that are each other's nearest descriptors.
std::vector<std::pair<Vector2d, Vector2d>> matched(const Features& a, const Features& b) {
  std::vector<std::pair<Vector2d, Vector2d>> pairs;
  if (a.descriptors.empty() || b.descriptors.empty()) return pairs;
  std::vector<cv::DMatch> matches;
  cv::BFMatcher(cv::NORM_HAMMING, true).match(a.descriptors, b.descriptors, matches);
  for (const cv::DMatch& match : matches) {
    if (match.distance > 48) continue;
    const cv::Point2f p = a.points[static_cast<size_t>(match.queryIdx)].pt;
    const cv::Point2f q = b.points[static_cast<size_t>(match.trainIdx)].pt;
    // Key points count from the centre of the first pixel.
    pairs.emplace_back(Vector2d(p.x + 0.5, p.y + 0.5), Vector2d(q.x + 0.5, q.y + 0.5));
  }
  return pairs;
}

constexpr double kVeryFar = 1e12;

// Gives the depth in a of the point that two pixels show, or 0 when they cannot be one point: off the epipolar line, or
// behind a camera.
class EpipolarTest {
 public:
  EpipolarTest(const Camera& a, const Camera& b) {
    const Eigen::Isometry3d b_from_a = b.world_from_camera.inverse() * a.world_from_camera;
    rotation_ = b_from_a.linear();
    translation_ = b_from_a.translation();
    ray_a_ = a.intrinsics.inverse();
    ray_b_ = b.intrinsics.inverse();
    Matrix3d cross;
    const Vector3d t = translation_.normalized();
    cross << 0, -t.z(), t.y(), t.z(), 0, -t.x(), -t.y(), t.x(), 0;
    fundamental_ = ray_b_.transpose() * cross * rotation_ * ray_a_;
  }
  double depth(const Vector2d& pixel_a, const Vector2d& pixel_b) const {
    const Vector3d a = pixel_a.homogeneous();
    const Vector3d b = pixel_b.homogeneous();
    const Vector3d line_b = fundamental_ * a;
    const Vector3d line_a = fundamental_.transpose() * b;
    const double slope = line_a.head<2>().squaredNorm() + line_b.head<2>().squaredNorm();
    if (slope <= 0) return 0;
    const double algebraic = b.dot(line_b);
    if (algebraic * algebraic / slope > kEpipolarTolerance * kEpipolarTolerance / 2) return 0;
    // Depths along both rays are found by least squares: depth_b * u = rotation * depth_a * v + translation.
    const Vector3d v = rotation_ * (ray_a_ * a);
    const Vector3d u = ray_b_ * b;
    Eigen::Matrix2d normal;
    normal << v.dot(v), -v.dot(u), -v.dot(u), u.dot(u);
    const Vector2d right(-v.dot(translation_), u.dot(translation_));
    if (std::abs(normal.determinant()) < 1e-12) return kVeryFar;  // depth has no sign there
    const Vector2d depths = normal.inverse() * right;
    return depths.x() > 0 && depths.y() > 0 ? depths.x() : 0;
  }

 private:
  Matrix3d rotation_;
  Vector3d translation_;
  Matrix3d ray_a_;
  Matrix3d ray_b_;
  Matrix3d fundamental_;
};

Tally compare_features(const Frame& a, const Frame& b) {
  const Features first = detect(a);
  const Features second = detect(b);
  Tally tally;
  const auto pairs = matched(first, second);
  tally.comparisons = static_cast<int64_t>(pairs.size());
  for (size_t i = 0; i < kMeanings.size(); ++i) {
    const EpipolarTest test(reinterpreted(first.camera, kMeanings[i]),
                            reinterpreted(second.camera, kMeanings[i]));
    for (const auto& [pixel_a, pixel_b] : pairs) {
      const double depth = test.depth(pixel_a, pixel_b);
      if (depth <= 0) continue;
      ++tally.agreeing[i];
      if (kMeanings[i] == PoseMeaning::kAsRead) tally.depths.push_back(depth);
    }
  }
  return tally;
}

// Returns frames far enough apart to show a convention and near enough to see the same things.
std::vector<std::pair<size_t, size_t>> chosen_pairs(const Scene& scene, int64_t most_pairs) {
  std::vector<std::pair<size_t, size_t>> pairs;
  const size_t count = scene.frames.size();
  if (count < 2) return pairs;
  const size_t step = std::max<size_t>(1, std::min<size_t>(count / 6, 5));
  const size_t usable = count - step;
  const size_t wanted = std::min<size_t>(usable, static_cast<size_t>(most_pairs));
  for (size_t i = 0; i < wanted; ++i) {
    const size_t first = i * usable / wanted;
    pairs.emplace_back(first, first + step);
  }
  return pairs;
}

}  // namespace

std::string pose_meaning_text(PoseMeaning meaning) {
  switch (meaning) {
    case PoseMeaning::kAsRead:
      return "world_from_camera with OpenCV axes (as read)";
    case PoseMeaning::kOpenGl:
      return "world_from_camera with OpenGL axes";
    case PoseMeaning::kInverted:
      return "camera_from_world with OpenCV axes";
    case PoseMeaning::kInvertedOpenGl:
      return "camera_from_world with OpenGL axes";
  }
  return {};
}

Camera reinterpreted(const Camera& camera, PoseMeaning meaning) {
  Camera result = camera;
  if (meaning == PoseMeaning::kInverted || meaning == PoseMeaning::kInvertedOpenGl) {
    result.world_from_camera = camera.world_from_camera.inverse();
  }
  if (meaning == PoseMeaning::kOpenGl || meaning == PoseMeaning::kInvertedOpenGl) {
    result.world_from_camera = opencv_from_opengl_pose(result.world_from_camera);
  }
  return result;
}

PoseMeaning PoseHypotheses::best() const {
  if (evidence.empty()) return PoseMeaning::kAsRead;
  const auto strongest = std::max_element(
      evidence.begin(), evidence.end(),
      [](const PoseEvidence& a, const PoseEvidence& b) { return a.agreement < b.agreement; });
  const double as_read = evidence.front().agreement;
  const bool clear = strongest->agreement > 0.3 && strongest->agreement > 1.4 * as_read + 0.05;
  return clear ? strongest->meaning : PoseMeaning::kAsRead;
}

PoseHypotheses test_pose_meanings(const Scene& scene, int64_t most_pairs) {
  PoseHypotheses result;
  const bool depth = std::all_of(scene.frames.begin(), scene.frames.end(),
                                 [](const Frame& frame) { return frame.has_depth(); });
  const bool images = std::all_of(scene.frames.begin(), scene.frames.end(),
                                  [](const Frame& frame) { return frame.has_image(); });
  Tally sum;
  for (const auto& [i, j] : chosen_pairs(scene, most_pairs)) {
    if (!depth && !images) break;
    const Tally pair = depth ? compare_depth(scene.frames[i], scene.frames[j])
                             : compare_features(scene.frames[i], scene.frames[j]);
    sum.comparisons += pair.comparisons;
    for (size_t k = 0; k < kMeanings.size(); ++k) sum.agreeing[k] += pair.agreeing[k];
    sum.depths.insert(sum.depths.end(), pair.depths.begin(), pair.depths.end());
  }
  if (!sum.depths.empty()) {
    const auto middle = sum.depths.begin() + static_cast<std::ptrdiff_t>(sum.depths.size() / 2);
    std::nth_element(sum.depths.begin(), middle, sum.depths.end());
    result.median_depth = *middle;
  }
  result.comparisons = sum.comparisons;
  if (sum.comparisons == 0) return result;
  result.method = depth ? "depth carried between views" : "epipolar lines of matched points";
  for (size_t k = 0; k < kMeanings.size(); ++k) {
    result.evidence.push_back({kMeanings[k], sum.agreeing[k] / static_cast<double>(sum.comparisons)});
  }
  return result;
}

}  // namespace gld
