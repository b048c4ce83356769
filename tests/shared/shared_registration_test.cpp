// Cameras of the shared data's real photographs, found from the pictures alone, beside the known ones.
#include "datasets/formats/file_listing.h"
#include "datasets/formats/scene_reader.h"
#include "datasets/images/image_probe.h"
#include "datasets/registration/colmap_registration.h"
#include "datasets/registration/feature_registration.h"
#include "gld/cameras/angles.h"
#include "tests/support/data_folders.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <iostream>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld::test {
namespace {

using testing::Le;

// What is known of the lens beside the photographs.
enum class KnownLens {
  kByExif,      // what the files' EXIF says, which may be nothing
  kAsIfByExif,  // the true focal length, of files without EXIF
};

// Returns the photographs of a scene by number, without what is known of their cameras.
std::vector<UnregisteredPhotograph> without_cameras(const Scene& scene, const std::vector<size_t>& numbers,
                                                    KnownLens lens) {
  std::vector<UnregisteredPhotograph> photographs;
  for (const size_t number : numbers) {
    UnregisteredPhotograph photograph;
    photograph.name = scene.frames[number].name;
    photograph.file = scene.frames[number].image_file;
    const ImageFileInfo header = probe_image_file(photograph.file);
    photograph.width = header.turned() ? header.height : header.width;
    photograph.height = header.turned() ? header.width : header.height;
    photograph.focal_length = header.focal_length;
    if (lens == KnownLens::kAsIfByExif) {
      const Camera& camera = scene.frames[number].camera;
      photograph.focal_length =
          camera.intrinsics(0, 0) / static_cast<double>(std::max(camera.width, camera.height));
    }
    photographs.push_back(photograph);
  }
  return photographs;
}

// Over all pairs of photographs, degrees.
struct PairErrors {
  std::vector<double> rotation, direction;
  double focal_length = 0;  // of the first photograph, over its true one

  static double median(std::vector<double> values) {
    std::sort(values.begin(), values.end());
    return values[values.size() / 2];
  }
  static double largest(const std::vector<double>& values) {
    return *std::max_element(values.begin(), values.end());
  }
};

double degrees_between(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b)) * kDegreesPerRadian;
}

PairErrors errors_of(const Registration& registration, const Scene& scene,
                     const std::vector<size_t>& numbers) {
  PairErrors errors;
  for (size_t i = 0; i < numbers.size(); ++i) {
    for (size_t j = i + 1; j < numbers.size(); ++j) {
      const Eigen::Isometry3d found = registration.photographs[i].world_from_camera.inverse() *
                                      registration.photographs[j].world_from_camera;
      const Eigen::Isometry3d known = scene.frames[numbers[i]].camera.camera_from_world() *
                                      scene.frames[numbers[j]].camera.world_from_camera;
      const Eigen::AngleAxisd turn(found.linear().transpose() * known.linear());
      errors.rotation.push_back(turn.angle() * kDegreesPerRadian);
      errors.direction.push_back(degrees_between(found.translation(), known.translation()));
    }
  }
  errors.focal_length =
      registration.photographs[0].camera.intrinsics(0, 0) / scene.frames[numbers[0]].camera.intrinsics(0, 0);
  return errors;
}

struct Case {
  const char* scene;
  std::vector<size_t> numbers;
  KnownLens lens;
};

void PrintTo(const Case& c, std::ostream* stream) {
  *stream << c.scene << " " << c.numbers.size() << (c.lens == KnownLens::kAsIfByExif ? " lens known" : "");
}

class SharedRegistrationCase : public testing::TestWithParam<Case> {
 protected:
  SharedRegistrationCase()
      : scene_(open_scene(shared_data() / "scenes" / GetParam().scene)),
        photographs_(without_cameras(scene_, GetParam().numbers, GetParam().lens)) {}

  void expect_right(const Registration& registration, double seconds) {
    ASSERT_EQ(registration.registered(), static_cast<int64_t>(photographs_.size()))
        << registration_text(registration, photographs_);
    const PairErrors errors = errors_of(registration, scene_, GetParam().numbers);
    std::cout << fmt::format(
        "{} {} photographs by {}: rotation {:.2f} (largest {:.2f}), direction {:.2f} ({:.2f}) degrees, focal "
        "length {:.3f} of the true one, {} points, {:.2f} pixels, {:.1f} s\n",
        GetParam().scene, photographs_.size(), registration.way, PairErrors::median(errors.rotation),
        PairErrors::largest(errors.rotation), PairErrors::median(errors.direction),
        PairErrors::largest(errors.direction), errors.focal_length, registration.points_in_world.size(),
        registration.reprojection_error, seconds);
    std::cout << registration_text(registration, photographs_);
    EXPECT_THAT(PairErrors::median(errors.rotation), Le(1));
    EXPECT_THAT(PairErrors::median(errors.direction), Le(3));
  }

  Scene scene_;
  std::vector<UnregisteredPhotograph> photographs_;
};

class SharedFeatures : public SharedRegistrationCase {};
class SharedColmap : public SharedRegistrationCase {};

TEST_P(SharedFeatures, FindWhereCamerasStand) {
  FeatureRegistrationOptions options;
  options.threads = 2;
  const auto start = std::chrono::steady_clock::now();
  const Registration found = register_by_features(photographs_, options, "--photos");
  expect_right(found, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
}

TEST_P(SharedColmap, FindsWhereCamerasStand) {
  ColmapRegistrationOptions options;
  options.program = found_colmap();
  options.threads = 2;
  ASSERT_FALSE(options.program.empty())
      << "expected the program colmap: scripts/setup.sh --development installs it";
  const auto start = std::chrono::steady_clock::now();
  const Registration found = register_by_colmap(photographs_, options, "--photos");
  expect_right(found, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
}

// TartanAir's files have no EXIF, and two or four of them do not tell their lens.
INSTANTIATE_TEST_SUITE_P(
    Scenes, SharedFeatures,
    testing::Values(Case{"colmap_lund_door", {3, 6}, KnownLens::kByExif},
                    Case{"colmap_lund_door", {2, 4, 6, 8}, KnownLens::kByExif},
                    Case{"colmap_lund_door", {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11}, KnownLens::kByExif},
                    Case{"tartanair_hospital", {0, 3}, KnownLens::kAsIfByExif},
                    Case{"tartanair_hospital", {0, 2, 4, 6}, KnownLens::kAsIfByExif},
                    Case{"tartanair_hospital", {0, 1, 2, 3, 4, 5, 6, 7}, KnownLens::kByExif}));

// Twelve of the door take it two and a half minutes.
INSTANTIATE_TEST_SUITE_P(
    Scenes, SharedColmap,
    testing::Values(Case{"colmap_lund_door", {3, 6}, KnownLens::kByExif},
                    Case{"colmap_lund_door", {2, 4, 6, 8}, KnownLens::kByExif},
                    Case{"tartanair_hospital", {0, 1, 2, 3, 4, 5, 6, 7}, KnownLens::kByExif}));

// Two or four photographs of a plain corridor with little way between them are too few for COLMAP: it gives cameras
// that are wrong by many degrees, and must not be taken at its word.
TEST(SharedColmapDoubts, TooFewSharedPointsAreSaid) {
  const Scene scene = open_scene(shared_data() / "scenes" / "tartanair_hospital");
  for (const std::vector<size_t>& numbers : {std::vector<size_t>{0, 3}, std::vector<size_t>{0, 2, 4, 6}}) {
    ColmapRegistrationOptions options;
    options.program = found_colmap();
    options.threads = 2;
    const auto photographs = without_cameras(scene, numbers, KnownLens::kAsIfByExif);
    const Registration found = register_by_colmap(photographs, options, "--photos");
    EXPECT_THAT(found.doubts, testing::Not(testing::IsEmpty())) << registration_text(found, photographs);
  }
}

}  // namespace
}  // namespace gld::test
