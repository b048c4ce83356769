#include "infer/paths/camera_path.h"

#include "datasets/formats/cameras_json.h"
#include "gld/cameras/pose_alignment.h"
#include "infer/paths/orbit_path.h"
#include "infer/paths/spline_path.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "tests/support/textured_plane.h"

#include <cmath>

#include <Eigen/Geometry>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using Eigen::Vector3d;

Camera camera_at(const Vector3d& centre, const Vector3d& target, const Vector3d& up = Vector3d::UnitZ()) {
  Camera camera;
  camera.width = 504;
  camera.height = 280;
  camera.intrinsics << 400, 0, 250, 0, 410, 141, 0, 0, 1;
  camera.world_from_camera.linear() = looking_along(target - centre, up);
  camera.world_from_camera.translation() = centre;
  return camera;
}

Vector3d centre_of(const Camera& camera) { return camera.world_from_camera.translation(); }
Vector3d axis_of(const Camera& camera) { return camera.world_from_camera.linear().col(2); }

// The path is of a scene of which nothing but the sources and perhaps a depth is known.
std::vector<Camera> path_of(const CameraPathOptions& options, const std::vector<Camera>& sources,
                            double typical_depth) {
  return make_camera_path(options, sources, {{}, typical_depth}).cameras;
}

void expect_rotation(const Camera& camera) {
  const Eigen::Matrix3d rotation = camera.world_from_camera.linear();
  EXPECT_LT((rotation * rotation.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff(), 1e-12);
  EXPECT_NEAR(rotation.determinant(), 1, 1e-12);
}

// Returns the distance of the point from the camera's optical axis.
double distance_from_axis(const Camera& camera, const Vector3d& point) {
  return (point - centre_of(camera)).cross(axis_of(camera)).norm();
}

// Returns four sources around (offset + (1, 2, 0.5)), 3 away from the vertical through it and 1 above it.
std::vector<Camera> ring(const Vector3d& offset) {
  const Vector3d target = offset + Vector3d(1, 2, 0.5);
  std::vector<Camera> cameras;
  for (const double angle : {-0.6, -0.1, 0.3, 0.4}) {
    cameras.push_back(camera_at(target + Vector3d(3 * std::cos(angle), 3 * std::sin(angle), 1), target));
  }
  return cameras;
}

TEST(LookingAlong, HasTheImageUpright) {
  const Eigen::Matrix3d rotation = looking_along(Vector3d(0, 5, 0), Vector3d::UnitZ());
  EXPECT_LT((rotation.col(0) - Vector3d::UnitX()).norm(), 1e-15);  // right
  EXPECT_LT((rotation.col(1) + Vector3d::UnitZ()).norm(), 1e-15);  // down
  EXPECT_LT((rotation.col(2) - Vector3d::UnitY()).norm(), 1e-15);  // forward
  const Eigen::Matrix3d down = looking_along(Vector3d(0, 0, -1), Vector3d::UnitZ());
  EXPECT_NEAR(down.determinant(), 1, 1e-12);
  EXPECT_LT((down.col(2) + Vector3d::UnitZ()).norm(), 1e-15);
}

TEST(LookAtPoint, IsWhereTheAxesMeet) {
  for (const double offset : {0.0, 1e6}) {
    const LookAtPoint point = look_at_point(ring(Vector3d(offset, -offset, 0)), 0);
    EXPECT_TRUE(point.from_axes);
    EXPECT_LT((point.x_in_world - Vector3d(offset + 1, 2 - offset, 0.5)).norm(), offset == 0 ? 1e-12 : 1e-8);
  }
}

TEST(LookAtPoint, AssumesADistanceWhereTheAxesAreParallelOrPart) {
  std::vector<Camera> parallel{camera_at({0, 0, 0}, {0, 9, 0}), camera_at({2, 0, 0}, {2, 9, 0})};
  LookAtPoint point = look_at_point(parallel, 0);
  EXPECT_FALSE(point.from_axes);
  EXPECT_LT((point.x_in_world - Vector3d(1, 6, 0)).norm(), 1e-12);  // three baselines ahead
  EXPECT_LT((look_at_point(parallel, 4).x_in_world - Vector3d(1, 4, 0)).norm(), 1e-12);
  // Axes that meet behind the cameras.
  const std::vector<Camera> apart{camera_at({-1, 0, 0}, {-2, 3, 0}), camera_at({1, 0, 0}, {2, 3, 0})};
  point = look_at_point(apart, 5);
  EXPECT_FALSE(point.from_axes);
  EXPECT_LT((point.x_in_world - Vector3d(0, 5, 0)).norm(), 1e-12);
  // One camera alone, and no baseline.
  point = look_at_point({camera_at({1, 1, 1}, {1, 2, 1})}, 0);
  EXPECT_FALSE(point.from_axes);
  EXPECT_LT((point.x_in_world - Vector3d(1, 2, 1)).norm(), 1e-12);
}

TEST(Orbit, LooksAtTheCentreAndKeepsRadiusHeightAndLens) {
  for (const double offset : {0.0, 1e6}) {
    const Vector3d shift(offset, 0, offset);
    const Vector3d target = shift + Vector3d(1, 2, 0.5);
    OrbitShape shape;
    shape.frames = 7;
    shape.degrees = 90;
    const std::vector<Camera> orbit = orbit_cameras(ring(shift), shape);
    ASSERT_EQ(orbit.size(), 7U);
    const double tolerance = offset == 0 ? 1e-12 : 1e-8;
    // The sources' mean up direction leans a little; radius and height refer to it.
    Vector3d up = Vector3d::Zero();
    for (const Camera& source : ring(shift)) up -= source.world_from_camera.linear().col(1);
    up.normalize();
    double radius = 0;
    double height = 0;
    for (const Camera& source : ring(shift)) {
      const Vector3d relative = centre_of(source) - target;
      height += relative.dot(up) / 4;
      radius += (relative - up * relative.dot(up)).norm() / 4;
    }
    for (const Camera& camera : orbit) {
      expect_rotation(camera);
      EXPECT_LT(distance_from_axis(camera, target), tolerance);
      EXPECT_GT((target - centre_of(camera)).dot(axis_of(camera)), 0);
      const Vector3d relative = centre_of(camera) - target;
      EXPECT_NEAR(relative.dot(up), height, tolerance);
      EXPECT_NEAR((relative - up * relative.dot(up)).norm(), radius, tolerance);
      EXPECT_NEAR(camera.world_from_camera.linear().col(0).dot(up), 0, 1e-12);  // the horizon is level
      EXPECT_GT(-camera.world_from_camera.linear().col(1).dot(up), 0);
      EXPECT_EQ(camera.intrinsics, ring(shift)[0].intrinsics);
      EXPECT_EQ(camera.width, 504);
    }
    const auto across = [&](size_t i) {
      const Vector3d relative = centre_of(orbit[i]) - target;
      return Vector3d(relative - up * relative.dot(up));
    };
    EXPECT_NEAR(std::acos(across(0).dot(across(6)) / (radius * radius)), std::acos(-1.0) / 2, 1e-7);
    EXPECT_NEAR(std::acos(across(2).dot(across(3)) / (radius * radius)), std::acos(-1.0) / 12, 1e-7);
  }
}

// 0 is what is usual; one frame stands where the sources do, whatever the angle.
TEST(Orbit, OfNoDegreesSweepsTheUsualOnes) {
  const std::vector<Camera> sources{test::camera_before_plane({0, 0, 0}, 0)};
  CameraPathOptions options;
  options.frames = 2;
  options.orbit_center = {0, 0, 4};
  EXPECT_EQ(options.orbit_degrees, 0);
  EXPECT_NO_THROW(options.check());
  const auto swept = [&] {
    const auto cameras = make_camera_path(options, sources, {}).cameras;
    const auto axis = [&](size_t i) { return cameras[i].world_from_camera.linear().col(2).eval(); };
    return std::acos(axis(0).dot(axis(1))) * 180 / std::acos(-1.0);
  };
  EXPECT_NEAR(swept(), kUsualOrbitDegrees, 1e-6);
  options.orbit_degrees = 25;
  EXPECT_NEAR(swept(), 25, 1e-6);
}

TEST(Orbit, AFullCircleHasNoFrameTwice) {
  OrbitShape shape;
  shape.frames = 8;
  shape.degrees = 360;
  const std::vector<Camera> orbit = orbit_cameras(ring(Vector3d::Zero()), shape);
  for (size_t i = 0; i < 8; ++i) {
    const double step = (centre_of(orbit[(i + 1) % 8]) - centre_of(orbit[i])).norm();
    EXPECT_NEAR(step, (centre_of(orbit[1]) - centre_of(orbit[0])).norm(), 1e-12);
    EXPECT_GT(step, 1);
  }
}

TEST(Orbit, StandsForCoincidentSourcesAndSingleFrames) {
  const Camera source = camera_at({1, 1, 1}, {1, 5, 1});
  OrbitShape shape;
  shape.frames = 1;
  shape.fallback_distance = 4;
  const Camera only = orbit_cameras({source, source}, shape)[0];
  EXPECT_LT((centre_of(only) - centre_of(source)).norm(), 1e-12);
  EXPECT_LT(rotation_angle(only.world_from_camera.linear(), source.world_from_camera.linear()), 1e-9);
  // It looks straight down onto a table: up is the mean of the sources' up, the circle has no radius, all stays finite.
  const Camera above = camera_at({0, 0, 3}, {0, 0, 0});
  shape.frames = 5;
  for (const Camera& camera : orbit_cameras({above}, shape)) {
    expect_rotation(camera);
    EXPECT_TRUE(camera.world_from_camera.matrix().allFinite());
  }
}

std::vector<Camera> winding(size_t count) {
  std::vector<Camera> cameras;
  for (size_t i = 0; i < count; ++i) {
    const auto s = static_cast<double>(i);
    Camera camera = camera_at({std::cos(s), std::sin(2 * s), 0.3 * s}, {4 * std::sin(s), 5, 1});
    camera.intrinsics(0, 0) = 300 * std::pow(1.2, s);
    camera.intrinsics(0, 2) = 250 + s;
    cameras.push_back(camera);
  }
  return cameras;
}

TEST(Orbit, ACentreAtTheSourceCameraIsNamed) {
  Camera source = ring(Vector3d::Zero()).front();
  OrbitShape shape;
  shape.centre = source.world_from_camera.translation();
  EXPECT_EQ(
      test::error_of([&] { orbit_cameras({source}, shape); }),
      "--orbit-center: expected a point away from the source cameras, found their own place; choose one in front "
      "of them, or add --orbit-radius.");
  shape.radius = 2;
  for (const Camera& camera : orbit_cameras({source}, shape))
    EXPECT_TRUE(camera.world_from_camera.matrix().allFinite());
}

TEST(Spline, PassesThroughTheGivenCameras) {
  for (const size_t count : {2U, 3U, 6U}) {
    const std::vector<Camera> keys = winding(count);
    for (size_t i = 0; i < count; ++i) {
      const Camera camera = spline_camera(keys, static_cast<double>(i));
      EXPECT_LT((centre_of(camera) - centre_of(keys[i])).norm(), 1e-12);
      EXPECT_LT(rotation_angle(camera.world_from_camera.linear(), keys[i].world_from_camera.linear()), 1e-6);
      EXPECT_LT((camera.intrinsics - keys[i].intrinsics).cwiseAbs().maxCoeff(), 1e-9);
    }
    for (const Camera& camera : spline_cameras(keys, 11)) expect_rotation(camera);
  }
}

// New views are no copies of photographs.
TEST(Spline, StandsBetweenTheGivenCamerasAndNotOnThem) {
  using testing::DoubleNear;
  using testing::ElementsAre;
  const auto near = [](double position) { return DoubleNear(position, 1e-12); };
  EXPECT_THAT(positions_between(2, 1), ElementsAre(near(0.5)));
  EXPECT_THAT(positions_between(3, 1), ElementsAre(near(0.5)));
  EXPECT_THAT(positions_between(5, 1), ElementsAre(near(1.5)));
  EXPECT_THAT(positions_between(2, 2), ElementsAre(near(1.0 / 3), near(2.0 / 3)));
  for (const int64_t cameras : {2, 3, 4, 5, 9}) {
    for (const int64_t frames : {2, 3, 4, 5, 7, 8, 60}) {
      const auto positions = positions_between(cameras, frames);
      ASSERT_EQ(positions.size(), static_cast<size_t>(frames));
      EXPECT_GT(positions.front(), 0);
      EXPECT_LT(positions.back(), static_cast<double>(cameras - 1));
      double nearest = 1;
      for (size_t i = 0; i < positions.size(); ++i) {
        nearest = std::min(nearest, std::abs(positions[i] - std::round(positions[i])));
        if (i < 2) continue;
        EXPECT_NEAR(positions[i] - positions[i - 1], positions[1] - positions[0], 1e-9);
      }
      if (frames < 6) {
        EXPECT_GT(nearest, 0.1) << cameras << ", " << frames;
      }
    }
  }
}

TEST(Spline, IsSmoothAcrossTheGivenCameras) {
  const std::vector<Camera> keys = winding(5);
  const double h = 1e-4;
  for (const double knot : {1.0, 2.0, 3.0}) {
    const Camera before = spline_camera(keys, knot - h);
    const Camera at = spline_camera(keys, knot);
    const Camera after = spline_camera(keys, knot + h);
    const Vector3d speed_in = (centre_of(at) - centre_of(before)) / h;
    const Vector3d speed_out = (centre_of(after) - centre_of(at)) / h;
    EXPECT_LT((speed_in - speed_out).norm(), 1e-2);
    const Eigen::AngleAxisd turn_in(before.world_from_camera.linear().transpose() *
                                    at.world_from_camera.linear());
    const Eigen::AngleAxisd turn_out(at.world_from_camera.linear().transpose() *
                                     after.world_from_camera.linear());
    EXPECT_LT((turn_in.axis() * turn_in.angle() - turn_out.axis() * turn_out.angle()).norm() / h, 1e-2);
    EXPECT_GT(turn_in.angle() / h, 0.05) << "the keys turn, so the test sees something";
  }
}

TEST(Spline, ReproducesStraightAndEvenMotion) {
  // Equal steps along a line with equal turns: everything in between is even, too.
  std::vector<Camera> keys;
  for (int i = 0; i < 4; ++i) {
    Camera camera = camera_at({1e6 + i, 2.0 * i, 0}, {1e6 + i, 2.0 * i + 5, 0});
    camera.world_from_camera.linear() = Eigen::AngleAxisd(1.0 * i, Vector3d::UnitZ()).toRotationMatrix();
    keys.push_back(camera);
  }
  for (const double s : {0.25, 0.5, 1.3, 2.75}) {
    const Camera camera = spline_camera(keys, s);
    EXPECT_LT((centre_of(camera) - Vector3d(1e6 + s, 2 * s, 0)).norm(), 1e-9);
    EXPECT_LT(rotation_angle(camera.world_from_camera.linear(),
                             Eigen::AngleAxisd(s, Vector3d::UnitZ()).toRotationMatrix()),
              1e-6);
  }
}

TEST(Spline, NeedsTwoCameras) {
  EXPECT_EQ(test::error_of([] { spline_cameras(winding(1), 5); }),
            "--path spline: expected at least two source cameras, found 1; add sources or use --path orbit.");
}

TEST(CameraPath, TakesEvenlySpreadCamerasOfAFile) {
  test::TemporaryFolder folder;
  const auto file = folder.path() / "cameras.json";
  CameraList list;
  for (const Camera& camera : winding(5)) {
    CameraRecord record;
    record.name = "camera_" + std::to_string(list.records.size());
    record.camera = camera;
    list.records.push_back(record);
  }
  write_cameras_json(file, list);
  CameraPathOptions options;
  options.path = file.string();
  EXPECT_EQ(path_of(options, winding(1), 0).size(), 5U);
  options.frames = 3;
  const std::vector<Camera> three = path_of(options, winding(1), 0);
  ASSERT_EQ(three.size(), 3U);
  for (size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(three[i].world_from_camera.matrix(), winding(5)[2 * i].world_from_camera.matrix());
    EXPECT_EQ(three[i].intrinsics, winding(5)[2 * i].intrinsics);
  }
  options.frames = 6;
  EXPECT_EQ(
      test::error_of([&] { path_of(options, winding(1), 0); }),
      "--frames: expected at most the 5 cameras of " + file.string() + ", found 6; ask for fewer frames.");
  options.path = "orbits";
  EXPECT_EQ(test::error_of([&] { path_of(options, winding(1), 0); }),
            "--path: expected orbit, spline or a cameras.json file, found \"orbits\", which is no file; "
            "check the name.");
}

// A phone capture whose neighbouring frames look almost the same way: the axes of two of them meet anywhere, those of
// all where the thing stands.
TEST(CameraPath, AnOrbitTurnsAboutWhatAllCamerasLookAt) {
  const Vector3d thing(1, 2, 3);
  std::vector<Camera> all;
  for (int i = 0; i < 12; ++i) {
    const double angle = 0.12 * i;
    const Vector3d away(7 * std::sin(angle), -7 * std::cos(angle), 0.2 * (i % 3));
    // The hand shakes by a degree.
    const Vector3d shake(0.06 * ((i * 7) % 5 - 2), 0, 0.06 * ((i * 3) % 5 - 2));
    all.push_back(camera_at(thing + away, thing + shake));
  }
  const std::vector<Camera> sources{all[5], all[6]};
  PathSurroundings surroundings;
  surroundings.cameras = all;
  const OrbitCentre centre = orbit_centre(sources, surroundings);
  EXPECT_LT((centre.x_in_world - thing).norm(), 0.15);
  EXPECT_EQ(centre.found_by, "where the axes of all 12 cameras meet");
  // A few cameras that look elsewhere do not move it.
  surroundings.cameras.push_back(camera_at({0, -9, 0}, {9, 9, 9}));
  surroundings.cameras.push_back(camera_at({0, -9, 0}, {-20, 3, -5}));
  EXPECT_LT((orbit_centre(sources, surroundings).x_in_world - thing).norm(), 0.15);
  // Sparse points at a tenth of that distance say that the axes meet behind what is seen.
  surroundings.typical_depth = 0.7;
  const OrbitCentre near = orbit_centre(sources, surroundings);
  EXPECT_EQ(near.found_by, "at the depth of what the source cameras see");
  EXPECT_NEAR((near.x_in_world - centre_of(sources[0])).norm(), 0.7, 0.2);
}

TEST(CameraPath, AnOrbitTurnsAsAsked) {
  CameraPathOptions options;
  options.orbit_center = {0, 5, 0};
  options.orbit_radius = 2;
  options.frames = 4;
  const CameraPath path = make_camera_path(options, ring(Vector3d::Zero()), {});
  EXPECT_THAT(path.note, testing::StartsWith("orbit about (0, 5, 0), "));
  EXPECT_THAT(path.note, testing::HasSubstr("as asked for"));
  for (const Camera& camera : path.cameras) {
    EXPECT_LT(distance_from_axis(camera, {0, 5, 0}), 1e-12);
    // The circle lies across the sources' mean up direction, which is nearly z.
    EXPECT_GE((centre_of(camera) - Vector3d(0, 5, 0)).norm(), 2 - 1e-12);
    EXPECT_NEAR((centre_of(camera) - Vector3d(0, 5, 0)).head<2>().norm(), 2, 0.3);
  }
  options.orbit_center = {1, 2};
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "--orbit-center: expected three numbers, x,y,z in the scene, found 2; "
            "write for example --orbit-center 0,0,2.5.");
}

TEST(CameraPath, WarnsOfCamerasThatTheSourcesCannotTellOf) {
  CameraPathOptions options;
  const auto warnings = [&](const std::vector<Camera>& sources) {
    return make_camera_path(options, sources, {}).warnings;
  };
  EXPECT_THAT(warnings(ring(Vector3d::Zero())), testing::IsEmpty());
  options.orbit_radius = 100;
  EXPECT_THAT(warnings(ring(Vector3d::Zero())), testing::IsEmpty());
  options.orbit_radius = 1e12;
  EXPECT_THAT(
      warnings(ring(Vector3d::Zero())),
      testing::ElementsAre(testing::AllOf(
          testing::HasSubstr(
              " of the path is 1e+12 away from the nearest source, where the scene is known to reach 2.95: "),
          testing::HasSubstr("look at --orbit-radius, --orbit-center and --orbit-distance."))));
  options.orbit_radius = 0;
  options.orbit_center = {0, 1e12, 0};
  EXPECT_EQ(warnings(ring(Vector3d::Zero())).size(), 1U);
  // One source alone has no unit.
  EXPECT_THAT(warnings({camera_at({0, 0, 0}, {0, 9, 0})}), testing::IsEmpty());
}

TEST(CameraPath, ChoosesByName) {
  CameraPathOptions options;
  options.orbit_degrees = 30;
  EXPECT_EQ(path_of(options, ring(Vector3d::Zero()), 0).size(), 6U);
  options.path = "spline";
  options.frames = 9;
  const std::vector<Camera> spline = path_of(options, ring(Vector3d::Zero()), 0);
  ASSERT_EQ(spline.size(), 9U);
  const Camera last = spline_camera(ring(Vector3d::Zero()), positions_between(4, 9).back());
  EXPECT_LT((centre_of(spline[8]) - centre_of(last)).norm(), 1e-12);
  EXPECT_EQ(test::error_of([&] { path_of(options, {}, 0); }),
            "camera path: expected at least one source camera, found none; name the sources.");
  // Parallel sources: the scene's typical depth is where an orbit looks, unless a distance is given.
  options.path = "orbit";
  options.frames = 3;
  const std::vector<Camera> parallel{camera_at({0, 0, 0}, {0, 9, 0}), camera_at({2, 0, 0}, {2, 9, 0})};
  for (const Camera& camera : path_of(options, parallel, 7)) {
    EXPECT_LT(distance_from_axis(camera, {1, 7, 0}), 1e-12);
  }
  options.orbit_distance = 3;
  for (const Camera& camera : path_of(options, parallel, 7)) {
    EXPECT_LT(distance_from_axis(camera, {1, 3, 0}), 1e-12);
  }
}

}  // namespace
}  // namespace gld
