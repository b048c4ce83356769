#include "gld/photogrammetry/plane_sweep_stereo.h"

#include "tests/support/error_of.h"
#include "tests/support/textured_plane.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

using Eigen::Vector3d;
using test::camera_before_plane;

StereoOptions few_planes() {
  StereoOptions options;
  options.planes = 96;
  options.coarse_side = 48;
  return options;
}

// Returns a plane painted finely enough for windows of 7 pixels, with its exact depth.
std::vector<PicturedView> plane_views(const std::vector<Camera>& cameras) {
  const test::TexturedPlane plane;
  std::vector<PicturedView> views;
  views.reserve(cameras.size());
  for (const Camera& camera : cameras) views.push_back(plane.seen_by(camera, 1));
  return views;
}

std::vector<PicturedView> without_depth(std::vector<PicturedView> views) {
  for (PicturedView& view : views) view.depth = {};
  return views;
}

std::vector<Camera> cameras_aside(size_t count, double apart) {
  std::vector<Camera> cameras;
  for (size_t i = 0; i < count; ++i) {
    const auto place = static_cast<double>(i);
    cameras.push_back(
        camera_before_plane({apart * place, 0.1 * std::sin(place), 0.05 * place}, -0.05 * place));
  }
  return cameras;
}

struct Errors {
  double mean = 0;  // of confident pixels, relative
  double confident = 0;
  double mean_of_all = 0;
};

Errors errors_of(const StereoScene& scene, const std::vector<PicturedView>& truth) {
  Errors errors;
  double count = 0, all = 0;
  for (size_t view = 0; view < truth.size(); ++view) {
    for (size_t i = 0; i < truth[view].depth.values.size(); ++i) {
      const double known = truth[view].depth.values[i];
      const double error = std::abs(scene.views[view].depth.values[i] - known) / known;
      all += 1;
      errors.mean_of_all += error;
      if (scene.views[view].confidence.values[i] < kConfidentStereo) continue;
      count += 1;
      errors.mean += error;
    }
  }
  errors.mean /= count;
  errors.mean_of_all /= all;
  errors.confident = count / all;
  return errors;
}

double most_confidence(const StereoScene& scene) {
  float most = 0;
  for (const StereoDepth& view : scene.views) {
    for (const float value : view.confidence.values) most = std::max(most, value);
  }
  return most;
}

// An eighth of a pixel of the largest parallax (0.4 of 96 pixels' focal length at 4 units: 10 pixels) is 1.25 % of
// depth.
constexpr double kEighthOfAPixel = 0.0125;

TEST(PlaneSweepStereo, FindsTheDepthOfASlantedPlane) {
  const auto views = plane_views(cameras_aside(3, 0.4));
  const auto scene = stereo_depth(without_depth(views), {}, few_planes());
  const Errors errors = errors_of(scene, views);
  EXPECT_LT(errors.mean, kEighthOfAPixel);
  EXPECT_GT(errors.confident, 0.6);
  EXPECT_FALSE(scene.prior.has_value());
  ASSERT_EQ(scene.views.size(), 3U);
  EXPECT_EQ(scene.views[1].compared.size(), 2U);
  EXPECT_EQ(scene.views[0].depth.width, 96);
}

TEST(PlaneSweepStereo, TakesItsRangeFromPoints) {
  const auto views = plane_views(cameras_aside(2, 0.4));
  const test::TexturedPlane plane;
  std::vector<Vector3d> points;
  for (int i = 0; i < 40; ++i) {
    const Vector3d direction(0.01 * (i - 20), 0.3 * std::sin(i), 1);
    points.push_back(direction * (plane.distance / plane.normal.dot(direction)));
  }
  // With few planes only a narrow range has them close enough.
  StereoOptions options = few_planes();
  options.planes = 24;
  const Errors errors = errors_of(stereo_depth(without_depth(views), points, options), views);
  EXPECT_LT(errors.mean, 2 * kEighthOfAPixel);
  EXPECT_GT(errors.confident, 0.5);
}

// A model that has seen rooms says that the sky is a wall, and the points of a reconstruction end at the last thing
// that has corners.
TEST(PlaneSweepStereo, WhatIsSeenToBeFarStaysFar) {
  constexpr float kWall = 6, kParallaxOfAPixel = 0.4F * 96;
  const auto views = test::wall_before_sky(cameras_aside(3, 0.4), kWall);
  std::vector<Vector3d> points;
  for (int i = 0; i < 60; ++i) {
    const test::TexturedPlane plane;
    const Vector3d direction(-0.01 * i, 0.3 * std::sin(i), 1);
    points.push_back(direction * (plane.distance / plane.normal.dot(direction)));
  }
  for (const auto& of_reconstruction : {std::vector<Vector3d>(), points}) {
    const auto scene = stereo_depth(views, of_reconstruction, few_planes());
    for (const size_t view : {0, 1, 2}) {
      const StereoDepth& found = scene.views[view];
      int64_t far = 0, of_sky = 0;
      for (int64_t y = 8; y < 64; ++y) {
        for (int64_t x = 8; x < 88; ++x) {
          const auto i = static_cast<size_t>(y * 96 + x);
          const float prior = views[view].depth.values[i];
          if (prior != kWall) {
            EXPECT_EQ(found.least.values[i] > 2 * prior, false) << x << ' ' << y;
            continue;
          }
          ++of_sky;
          EXPECT_GE(found.depth.values[i], found.least.values[i]);
          if (found.depth.values[i] > 0.5F * kParallaxOfAPixel) ++far;
        }
      }
      // The middle one sees both others' sky.
      EXPECT_GT(static_cast<double>(far), (view == 1 ? 0.7 : 0.3) * static_cast<double>(of_sky)) << view;
    }
  }
  // Nothing is far in a room.
  const auto room = stereo_depth(plane_views(cameras_aside(3, 0.4)), {}, few_planes());
  for (const StereoDepth& view : room.views) {
    EXPECT_TRUE(
        std::all_of(view.least.values.begin(), view.least.values.end(), [](float v) { return v == 0; }));
  }
}

TEST(PlaneSweepStereo, MovesForward) {
  std::vector<Camera> cameras;
  for (const double z : {0.0, 0.7, 1.4}) cameras.push_back(camera_before_plane({0, 0, z}, 0, 224, 168));
  const auto views = plane_views(cameras);
  const auto scene = stereo_depth(without_depth(views), {}, few_planes());
  const Errors errors = errors_of(scene, views);
  EXPECT_LT(errors.mean, 3 * kEighthOfAPixel);  // parallax falls to nothing towards the middle
  EXPECT_GT(errors.confident, 0.2);
  // Where it moves to, nothing moves.
  const auto middle = static_cast<size_t>(84 * 224 + 112);
  EXPECT_LT(scene.views[0].confidence.values[middle], kConfidentStereo);
  EXPECT_EQ(scene.views[0].doubt[middle], StereoDoubt::kFar);
  // And nothing is far.
  for (const StereoDepth& view : scene.views) {
    EXPECT_TRUE(
        std::all_of(view.least.values.begin(), view.least.values.end(), [](float v) { return v == 0; }));
  }
}

TEST(PlaneSweepStereo, SaysThatOnePlaceTellsNothing) {
  for (const double turn : {0.0, 0.1}) {  // identical cameras, and a pure rotation
    const auto views =
        plane_views({camera_before_plane({5, -3, 1}, 0), camera_before_plane({5, -3, 1}, turn)});
    const auto scene = stereo_depth(without_depth(views), {}, few_planes());
    EXPECT_EQ(most_confidence(scene), 0);
    for (const StereoDepth& view : scene.views) {
      EXPECT_TRUE(view.compared.empty());
      EXPECT_TRUE(
          std::all_of(view.depth.values.begin(), view.depth.values.end(), [](float d) { return d == 0; }));
      EXPECT_TRUE(std::all_of(view.doubt.begin(), view.doubt.end(),
                              [](StereoDoubt doubt) { return doubt == StereoDoubt::kUnseen; }));
    }
    // A prior is then the result as it is.
    const auto with_prior = stereo_depth(views, {}, few_planes());
    EXPECT_EQ(most_confidence(with_prior), 0);
    ASSERT_TRUE(with_prior.prior.has_value());
    EXPECT_EQ(with_prior.prior->pixels, 0);
    EXPECT_LT(errors_of(with_prior, views).mean_of_all, 1e-6);
  }
}

TEST(PlaneSweepStereo, SaysThatViewsDoNotOverlap) {
  std::vector<PicturedView> views = plane_views({camera_before_plane({0, 0, 0}, 0)});
  PicturedView away = views[0];
  away.camera.world_from_camera.linear() = Eigen::AngleAxisd(3.1, Vector3d::UnitY()).toRotationMatrix();
  away.camera.world_from_camera.translation() = Vector3d(0.5, 0, -1);
  views.push_back(away);
  EXPECT_EQ(most_confidence(stereo_depth(without_depth(views), {}, few_planes())), 0);
}

TEST(PlaneSweepStereo, ExposureAndOffsetDoNotMatter) {
  auto views = plane_views(cameras_aside(3, 0.4));
  const auto truth = views;
  // Four times as dark and lifted, without clipping.
  for (float& value : views[1].rgb) value = 0.25F * value + 0.3F;
  const Errors errors = errors_of(stereo_depth(without_depth(views), {}, few_planes()), truth);
  EXPECT_LT(errors.mean, kEighthOfAPixel);
  EXPECT_GT(errors.confident, 0.6);
}

TEST(PlaneSweepStereo, ABlackPictureTellsNothingAndSpoilsNothing) {
  auto views = plane_views(cameras_aside(4, 0.4));
  const auto truth = views;
  std::fill(views[1].rgb.begin(), views[1].rgb.end(), 0.0F);
  const auto scene = stereo_depth(without_depth(views), {}, few_planes());
  EXPECT_EQ(scene.views[1].confident_share(), 0);
  for (const size_t view : {0U, 2U, 3U}) EXPECT_GT(scene.views[view].confident_share(), 0.3) << view;
  EXPECT_LT(errors_of(scene, truth).mean, kEighthOfAPixel);
}

TEST(PlaneSweepStereo, PrincipalPointsMayLieAside) {
  auto cameras = cameras_aside(3, 0.4);
  for (Camera& camera : cameras) {
    camera.intrinsics(0, 2) += 0.3 * static_cast<double>(camera.width);
    camera.intrinsics(1, 2) -= 0.4 * static_cast<double>(camera.height);
    camera.intrinsics(1, 1) *= 1.2;
  }
  const auto views = plane_views(cameras);
  const Errors errors = errors_of(stereo_depth(without_depth(views), {}, few_planes()), views);
  EXPECT_LT(errors.mean, kEighthOfAPixel);
  EXPECT_GT(errors.confident, 0.5);
}

TEST(PlaneSweepStereo, WhatIsNotANumberIsNotThere) {
  auto views = plane_views(cameras_aside(3, 0.4));
  const auto truth = views;
  for (int64_t y = 20; y < 40; ++y) {
    for (int64_t x = 30; x < 60; ++x) {
      views[0].rgb[static_cast<size_t>(3 * (y * 96 + x))] = std::numeric_limits<float>::quiet_NaN();
      views[2].rgb[static_cast<size_t>(3 * (y * 96 + x) + 1)] = std::numeric_limits<float>::infinity();
    }
  }
  const auto scene = stereo_depth(without_depth(views), {}, few_planes());
  EXPECT_EQ(scene.views[0].confidence.at(45, 30), 0);
  EXPECT_EQ(scene.views[0].doubt[static_cast<size_t>(30 * 96 + 45)], StereoDoubt::kUnseen);
  const Errors errors = errors_of(scene, truth);
  EXPECT_LT(errors.mean, kEighthOfAPixel);
  EXPECT_GT(errors.confident, 0.4);
}

TEST(PlaneSweepStereo, SixteenViewsAreComparedWithFourEach) {
  const auto views = plane_views(cameras_aside(16, 0.1));
  StereoOptions options = few_planes();
  options.memory_limit = 4;  // a few views at a time
  const auto scene = stereo_depth(without_depth(views), {}, options);
  for (const StereoDepth& view : scene.views) EXPECT_EQ(view.compared.size(), 4U);
  // Neighbours stand half as far apart.
  EXPECT_LT(errors_of(scene, views).mean, 2 * kEighthOfAPixel);
}

TEST(PlaneSweepStereo, IsTheSameOnAnyNumberOfThreads) {
  const auto views = without_depth(plane_views(cameras_aside(3, 0.4)));
  KernelSettings three;
  three.threads = 3;
  const auto one = stereo_depth(views, {}, few_planes()),
             other = stereo_depth(views, {}, few_planes(), three);
  for (size_t view = 0; view < views.size(); ++view) {
    EXPECT_EQ(one.views[view].depth.values, other.views[view].depth.values);
    EXPECT_EQ(one.views[view].confidence.values, other.views[view].confidence.values);
  }
}

// A wall of which only the left third is painted: the rest has no texture at all.
std::vector<PicturedView> half_painted() {
  auto views = plane_views(cameras_aside(3, 0.4));
  const test::TexturedPlane plane;
  for (PicturedView& view : views) {
    const Vector3d centre = view.camera.world_from_camera.translation();
    for (int64_t y = 0; y < view.height; ++y) {
      for (int64_t x = 0; x < view.width; ++x) {
        const auto pixel = static_cast<size_t>(y * view.width + x);
        const Vector3d ray = view.camera.world_from_camera.linear() *
                             (view.camera.intrinsics.inverse() *
                              Vector3d(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5, 1));
        const Vector3d point = centre + static_cast<double>(view.depth.values[pixel]) * ray;
        if (point.x() > 0.3) std::fill_n(view.rgb.begin() + static_cast<std::ptrdiff_t>(3 * pixel), 3, 0.5F);
      }
    }
  }
  return views;
}

// The prior is the depth times a common factor, and smooth waves of that standard deviation.
std::vector<PicturedView> with_wrong_prior(std::vector<PicturedView> views, double factor, double spread) {
  for (PicturedView& view : views) {
    for (int64_t y = 0; y < view.depth.height; ++y) {
      for (int64_t x = 0; x < view.depth.width; ++x) {
        const double u = 6.3 * static_cast<double>(x) / 96, v = 6.3 * static_cast<double>(y) / 72;
        const double wave = std::sin(1.3 * u + 0.7 * v) + std::sin(2.1 * v - 1.1 * u);
        view.depth.values[static_cast<size_t>(y * view.depth.width + x)] *=
            static_cast<float>(factor * std::exp(spread * wave));
      }
    }
  }
  return views;
}

TEST(PlaneSweepStereo, AGoodPriorRulesWhereNothingIsPainted) {
  const auto truth = half_painted();
  const auto views = with_wrong_prior(truth, 1, 0.05);
  StereoScene prior_alone;
  for (const PicturedView& view : views) {
    prior_alone.views.emplace_back();
    prior_alone.views.back().depth = view.depth;
    prior_alone.views.back().confidence = ConfidenceMap(96, 72);
  }
  const auto fused = stereo_depth(views, {}, few_planes()),
             alone = stereo_depth(without_depth(views), {}, few_planes());
  ASSERT_TRUE(fused.prior.has_value());
  EXPECT_GT(fused.prior->pixels, 0);
  EXPECT_LT(errors_of(fused, truth).mean_of_all, errors_of(prior_alone, truth).mean_of_all);
  EXPECT_LT(errors_of(fused, truth).mean_of_all, errors_of(alone, truth).mean_of_all);
}

TEST(PlaneSweepStereo, ABadPriorCountsForNothing) {
  const auto truth = plane_views(cameras_aside(3, 0.4));
  const auto fused = stereo_depth(with_wrong_prior(truth, 1, 0.4), {}, few_planes());
  const auto alone = stereo_depth(without_depth(truth), {}, few_planes());
  EXPECT_GT(fused.prior->spread, 0.2);
  EXPECT_LT(errors_of(fused, truth).mean, 1.2 * errors_of(alone, truth).mean);
}

TEST(PlaneSweepStereo, ThePriorsScaleIsMended) {
  const auto truth = plane_views(cameras_aside(3, 0.4));
  const auto fused = stereo_depth(with_wrong_prior(truth, 1.6, 0), {}, few_planes());
  EXPECT_NEAR(fused.prior->scale, 1 / 1.6, 0.02);
  EXPECT_LT(fused.prior->spread, 0.03);
  EXPECT_LT(errors_of(fused, truth).mean_of_all, 0.03);
}

TEST(PlaneSweepStereo, AViewThatNoneOverlapsHasTheUnitOfTheOthers) {
  auto cameras = cameras_aside(2, 0.4);
  cameras.push_back(camera_before_plane({0.5, 0, -1}, 3.1));
  auto truth = plane_views(cameras);
  // Behind that camera the plane has no depth; a wall of 3 units stands there.
  std::fill(truth[2].depth.values.begin(), truth[2].depth.values.end(), 3.0F);
  const auto fused = stereo_depth(with_wrong_prior(truth, 1.6, 0), {}, few_planes());
  EXPECT_TRUE(fused.views[2].compared.empty());
  EXPECT_EQ(fused.views[2].confident_pixels(), 0U);
  EXPECT_NEAR(fused.prior->scale, 1 / 1.6, 0.02);
  for (const float depth : fused.views[2].depth.values) ASSERT_NEAR(depth, 3, 0.1);
}

// What nearly every pixel of a prior says lies so near that no other photograph shows it there.
TEST(PlaneSweepStereo, APriorThatWidensTheRangeLeavesDepthKnown) {
  const auto truth = plane_views(cameras_aside(3, 0.4));
  auto views = truth;
  for (PicturedView& view : views) {
    for (size_t i = 0; i < view.depth.values.size() / 50; ++i) view.depth.values[i] = 0.05F;
  }
  const auto fused = stereo_depth(views, {}, few_planes());
  ASSERT_GT(fused.prior->pixels, 0);
  for (const StereoDepth& view : fused.views) {
    EXPECT_FALSE(view.compared.empty());
    for (const float depth : view.depth.values) ASSERT_TRUE(std::isfinite(depth) && depth > 0) << depth;
  }
}

// Grain hides the plane at the photographs' own size, and is a quarter as large, by area, at half of it: the first pass
// matches, the second does not.
TEST(PlaneSweepStereo, AUnitThatTheSecondPassDoesNotConfirmIsNone) {
  const auto truth = plane_views(cameras_aside(2, 0.4));
  const auto grainy = [&](double grain) {
    std::mt19937 random(5);
    std::normal_distribution<double> noise(0, grain);
    auto views = with_wrong_prior(truth, 1.6, 0);
    for (PicturedView& view : views) {
      for (float& value : view.rgb) value += static_cast<float>(noise(random));
    }
    return views;
  };
  // So little more grain takes few of the thousands of pixels from the first pass.
  const auto seen = stereo_depth(grainy(0.22), {}, few_planes());
  EXPECT_GT(seen.prior->pixels, 2000);
  EXPECT_NEAR(seen.prior->scale, 1 / 1.6, 0.05);
  EXPECT_GT(errors_of(seen, truth).confident, 0.05);
  const auto views = grainy(0.3);
  const auto hidden = stereo_depth(views, {}, few_planes());
  ASSERT_TRUE(hidden.prior.has_value());
  EXPECT_EQ(hidden.prior->pixels, 0);
  EXPECT_EQ(most_confidence(hidden), 0);
  // The prior as it is, in its own unit.
  EXPECT_EQ(hidden.views[0].depth.values, views[0].depth.values);
}

TEST(PlaneSweepStereo, RefusesAViewWithoutAPhotograph) {
  auto views = without_depth(plane_views(cameras_aside(2, 0.4)));
  views[1].rgb.clear();
  EXPECT_EQ(
      test::error_of([&] { stereo_depth(views); }),
      "stereo depth, view 1: expected a photograph of at least 2 x 2 pixels, found 0 values for 96 x 72; give only views "
      "that were photographed.");
}

}  // namespace
}  // namespace gld
