#include "datasets/registration/feature_registration.h"

#include "datasets/images/image_file.h"
#include "datasets/images/image_probe.h"
#include "gld/cameras/angles.h"
#include "gld/cameras/pose_alignment.h"
#include "tests/datasets/registration/drawn_box.h"
#include "tests/support/error_of.h"
#include "tests/support/exif_jpeg.h"
#include "tests/support/temporary_folder.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::camera_in_box;
using test::DrawnBox;
using testing::HasSubstr;
using testing::StartsWith;

class FeatureRegistration : public testing::Test {
 protected:
  void add(const Image& picture, const Camera& camera, int64_t lens = 0) {
    UnregisteredPhotograph photograph;
    photograph.name = "photo_" + std::to_string(photographs_.size());
    photograph.file = folder_.path() / (photograph.name + ".png");
    photograph.width = picture.width;
    photograph.height = picture.height;
    photograph.lens = lens;
    write_png(photograph.file, picture);
    photographs_.push_back(photograph);
    cameras_.push_back(camera);
  }
  void add(const Camera& camera) { add(DrawnBox().seen_by(camera), camera); }
  Registration found() const { return register_by_features(photographs_, {}, "--photos"); }
  std::string refusal() const {
    return test::error_of([&] { found(); });
  }
  // A place is known to about 0.3 of 480 pixels, 0.05 degrees of its ray; hundreds of points leave a camera much
  // less, and the lens, which trades with it, a few times more.
  void expect_right(const Registration& registration, const std::vector<size_t>& numbers) const {
    for (const size_t i : numbers) {
      ASSERT_TRUE(registration.photographs[i].registered) << registration.photographs[i].reason;
      const auto pose = [&](size_t k) { return registration.photographs[k].world_from_camera; };
      const Eigen::Isometry3d a = pose(numbers[0]).inverse() * pose(i);
      const Eigen::Isometry3d b = cameras_[numbers[0]].camera_from_world() * cameras_[i].world_from_camera;
      EXPECT_LT(rotation_angle(a.linear(), b.linear()), 0.3) << i;
      if (i == numbers[0]) continue;
      const double along = a.translation().normalized().dot(b.translation().normalized());
      EXPECT_LT(std::acos(std::min(1.0, along)) * kDegreesPerRadian, 1.5) << i;
      const double f = registration.photographs[i].camera.intrinsics(0, 0) / cameras_[i].intrinsics(0, 0);
      EXPECT_NEAR(f, 1, 0.03) << i;
    }
  }

  test::TemporaryFolder folder_;
  std::vector<UnregisteredPhotograph> photographs_;
  std::vector<Camera> cameras_;
};

TEST_F(FeatureRegistration, FindsTheCamerasOfARoomAndLeavesOutWhatIsElsewhere) {
  for (int i = 0; i < 4; ++i) add(camera_in_box({0.5 * i - 0.7, 0.1 * (i % 2), 0.2 * i}, 0.12 * (1 - i)));
  add(DrawnBox{77}.seen_by(camera_in_box({0, 0, 0}, 0)), camera_in_box({0, 0, 0}, 0));
  Image blank(480, 360);
  std::fill(blank.rgb.begin(), blank.rgb.end(), uint8_t{120});
  add(blank, camera_in_box({0, 0, 0}, 0));
  const Registration registration = found();
  expect_right(registration, {0, 1, 2, 3});
  EXPECT_EQ(registration.registered(), 4);
  EXPECT_EQ(registration.photographs[0].world_from_camera.matrix(), Eigen::Matrix4d::Identity());
  EXPECT_THAT(registration.photographs[4].reason, StartsWith("it shows nothing that another one shows ("));
  EXPECT_EQ(registration.photographs[5].reason, "it shows too little to recognise (0 places with texture)");
  // Places are found to a fraction of a pixel.
  EXPECT_LT(registration.reprojection_error, 0.6);
  EXPECT_GT(registration.points_in_world.size(), 200U);
  const auto warnings = registration_warnings(registration, photographs_);
  ASSERT_EQ(warnings.size(), 2U);
  EXPECT_EQ(warnings[1],
            "photograph 'photo_5' is left out: it shows too little to recognise (0 places with texture)");
  EXPECT_THAT(registration_text(registration, photographs_),
              HasSubstr("cameras of 4 of 6 photographs by features"));
  const auto json = registration_json(registration, photographs_);
  EXPECT_EQ(json.at("from"), "features");
  EXPECT_EQ(json.at("cameras").at(5).at("registered"), false);
}

TEST_F(FeatureRegistration, OneLensTakesPicturesOfSeveralSizes) {
  for (int i = 0; i < 2; ++i) add(camera_in_box({0.5 * i - 0.5, 0.1 * (i % 2), 0.1 * i}, 0.1 * (1 - i)));
  add(camera_in_box({0.9, 0.1, 0.5}, -0.1, 0.8, 320, 240));
  add(camera_in_box({-0.8, -0.1, 0.4}, 0.1, 0.8, 360, 480));  // held upright
  const Registration registration = found();
  expect_right(registration, {0, 1, 2, 3});
  EXPECT_EQ(registration.lenses.size(), 1U);
  EXPECT_EQ(registration.photographs[2].camera.width, 320);
}

TEST_F(FeatureRegistration, PicturesAreUprightAsExifSays) {
  for (int i = 0; i < 2; ++i) add(camera_in_box({0.5 * i - 0.5, 0.1 * (i % 2), 0.1 * i}, 0.1 * (1 - i)));
  // Stored lying on its side: column x of the file, from the left, is row x of the picture from the top.
  const Camera camera = camera_in_box({-0.8, -0.1, 0.4}, 0.1, 0.8, 360, 480);
  const Image upright = DrawnBox().seen_by(camera);
  Image stored(480, 360);
  for (int64_t y = 0; y < 480; ++y) {
    for (int64_t x = 0; x < 360; ++x) {
      for (int c = 0; c < 3; ++c) stored.pixel(y, 359 - x)[c] = upright.pixel(x, y)[c];
    }
  }
  add(upright, camera);
  photographs_[2].file = folder_.path() / "turned.jpg";
  write_jpeg(photographs_[2].file, stored, 95);
  test::ExifEntries exif;
  exif.orientation = 6;
  test::add_exif(photographs_[2].file, exif);
  ASSERT_TRUE(probe_image_file(photographs_[2].file).turned());
  const Registration registration = found();
  expect_right(registration, {0, 1, 2});
  // The same is found again.
  EXPECT_EQ(found().photographs[2].world_from_camera.matrix(),
            registration.photographs[2].world_from_camera.matrix());
}

TEST_F(FeatureRegistration, WhatHasNoDepthIsRefused) {
  const std::string expected =
      "--photos: expected at least two photographs that show one place from several places in it, found none of 2 "
      "that fit together (photo_0: ";
  add(camera_in_box({0, 0, 0}, 0));
  EXPECT_EQ(
      refusal(),
      "--photos: expected two photographs or more, which show something in common, found one; add photographs "
      "of the same place from other places in it.");
  add(camera_in_box({0, 0, 0}, 0));  // the same picture again
  EXPECT_THAT(refusal(), StartsWith(expected));
  EXPECT_THAT(refusal(), HasSubstr("seen from one place"));
  photographs_.pop_back();
  add(camera_in_box({0, 0, 0}, 0.1));  // turned where it stands
  EXPECT_THAT(refusal(), StartsWith(expected));
  photographs_.pop_back();
  add(DrawnBox{5}.seen_by(camera_in_box({0, 0, 0}, 0)), camera_in_box({0, 0, 0}, 0));
  EXPECT_THAT(refusal(), HasSubstr("it shows nothing that another one shows ("));
}

}  // namespace
}  // namespace gld
