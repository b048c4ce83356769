#include "gld/photogrammetry/picture_warp.h"

#include "tests/support/striped_wall.h"
#include "tests/support/textured_plane.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

using Eigen::Vector3d;
using test::camera_before_plane;
using test::camera_between;
using test::two_views_of_plane;

// Returns how far the colours of what was carried are from those of a photograph taken there; at the border of what is
// seen only a part of a pixel's surface was.
double mean_error(const CarriedPicture& carried, const PicturedView& truth) {
  double sum = 0, count = 0;
  for (size_t pixel = 0; pixel < carried.seen.size(); ++pixel) {
    if (carried.seen[pixel] == 0) continue;
    for (size_t c = 0; c < 3; ++c) sum += std::abs(carried.rgb[3 * pixel + c] - truth.rgb[3 * pixel + c]);
    count += 3;
  }
  return sum / count;
}

void scale_depth(std::vector<PicturedView>& views, float factor) {
  for (PicturedView& view : views) {
    for (float& depth : view.depth.values) depth *= factor;
  }
}

TEST(PictureWarp, APlaneIsCarriedToWhereItIsSeen) {
  const test::TexturedPlane plane;
  const auto carried = carry_pictures(two_views_of_plane(), camera_between());
  ASSERT_EQ(carried.size(), 2U);
  for (const CarriedPicture& picture : carried) {
    EXPECT_EQ(picture.width, camera_between().width);
    EXPECT_EQ(picture.height, camera_between().height);
    EXPECT_GT(picture.seen_share(), 0.8);
    EXPECT_LT(mean_error(picture, plane.seen_by(camera_between(), 1)), 0.01);
  }
  EXPECT_LT(carried[0].seen_share(), 0.99);  // the target looks past the border of the first
}

// The error of a single photograph's depth moves it; two photographs tell where they belong.
TEST(PictureWarp, TwoPhotographsMendTheDepth) {
  const PicturedView truth = test::TexturedPlane().seen_by(camera_between(), 1);
  auto views = two_views_of_plane();
  scale_depth(views, 0.8F);
  const double alone = mean_error(carry_pictures({views[0]}, camera_between())[0], truth);
  EXPECT_GT(alone, 0.05);
  EXPECT_LT(mean_error(carry_pictures(views, camera_between())[0], truth), 0.2 * alone);
}

TEST(PictureWarp, TheSameCameraGivesTheSamePicture) {
  const PicturedView source = test::TexturedPlane().seen_by(camera_before_plane({0.3, -0.2, 0.4}, 0.2), 1);
  CarryOptions options;
  for (const ColourSampling colours : {ColourSampling::kBilinear, ColourSampling::kCubic}) {
    options.colours = colours;
    const CarriedPicture carried = carry_pictures({source}, source.camera, options)[0];
    EXPECT_EQ(carried.seen_share(), 1);
    for (size_t i = 0; i < carried.rgb.size(); ++i) ASSERT_NEAR(carried.rgb[i], source.rgb[i], 1e-4) << i;
  }
}

// Returns the wall carried to where it is seen half a pixel further.
CarriedPicture half_a_pixel_on(ColourSampling colours, double (*brightness)(double)) {
  const PicturedView source = test::striped_wall(brightness);
  const auto pixels = static_cast<size_t>(source.width * source.height);
  CarryOptions options;
  options.colours = colours;
  const TargetDepth depth{source.width, source.height, std::vector<double>(pixels, 1.0),
                          std::vector<uint8_t>(pixels, 1)};
  return carry_pictures_to({source}, test::half_a_pixel_beside(source.camera), depth, options)[0];
}

constexpr double kWave = 2 * 3.14159265358979323846 / 6;  // radians a pixel

// Between two pixels a wave keeps cos(w/2) of its height where the two are averaged, and (9 cos(w/2) - cos(3w/2)) / 8
// by the spline: .866 and .974 of a wave six pixels long.
TEST(PictureWarp, ColoursBetweenPixelsKeepWhatTheirSamplingKeeps) {
  const auto wave = [](double x) { return 0.5 + 0.4 * std::sin(kWave * x); };
  const double bilinear = std::cos(kWave / 2),
               cubic = (9 * std::cos(kWave / 2) - std::cos(3 * kWave / 2)) / 8;
  for (const auto& [colours, kept] :
       {std::pair(ColourSampling::kBilinear, bilinear), {ColourSampling::kCubic, cubic}}) {
    const CarriedPicture carried = half_a_pixel_on(colours, wave);
    for (int64_t column = 2; column < carried.width - 3; ++column) {
      const auto pixel = static_cast<size_t>(3 * (10 * carried.width + column));
      ASSERT_NEAR(carried.rgb[pixel],
                  0.5 + 0.4 * kept * std::sin(kWave * (static_cast<double>(column) + 0.5)), 2e-5)
          << column;
    }
  }
}

TEST(PictureWarp, ColoursAtAnEdgeStayColours) {
  const CarriedPicture carried =
      half_a_pixel_on(ColourSampling::kCubic, [](double x) { return x < 40 ? 0.0 : 1.0; });
  for (const float colour : carried.rgb) {
    ASSERT_GE(colour, 0);
    ASSERT_LE(colour, 1);
  }
  EXPECT_NEAR(carried.rgb[static_cast<size_t>(3 * 39)], 0.5, 1e-5);
}

TEST(PictureWarp, TheDepthOfASourceAsATargetSeesIt) {
  const test::TexturedPlane plane;
  const PicturedView truth = plane.seen_by(camera_between(), 1);
  const PlanarDepth depth = depth_seen_from(two_views_of_plane()[0], camera_between());
  ASSERT_EQ(depth.width, camera_between().width);
  ASSERT_EQ(depth.height, camera_between().height);
  double error = 0;
  for (size_t i = 0; i < depth.values.size(); ++i) {
    ASSERT_GT(depth.values[i], 0) << i;  // past the border the nearest one counts
    error += std::abs(depth.values[i] / truth.depth.values[i] - 1) / static_cast<double>(depth.values.size());
  }
  EXPECT_LT(error, 0.02);
  // Seen from behind nothing lies in front.
  const PlanarDepth none =
      depth_seen_from(two_views_of_plane()[0], camera_before_plane({0, 0, 0}, std::acos(-1.0)));
  for (const float value : none.values) ASSERT_EQ(value, 0);
}

// Twice as near every pixel covers four, and none stays empty.
TEST(PictureWarp, ANearerViewHasNoGaps) {
  test::TexturedPlane plane;
  plane.normal = Vector3d(0, 0, 1);
  const PicturedView source = plane.seen_by(camera_before_plane({0, 0, 0}, 0), 1);
  EXPECT_EQ(carry_pictures({source}, camera_before_plane({0, 0, 2}, 0))[0].seen_share(), 1);
}

// Half of the picture is a white wall close by, the other half black and far: moved to the side, the wall hides what is
// behind it, and what it hid before is not seen.
TEST(PictureWarp, WhatIsNearerHidesWhatIsBehind) {
  PicturedView source = test::TexturedPlane().seen_by(camera_before_plane({0, 0, 0}, 0), 1);
  for (int64_t y = 0; y < source.height; ++y) {
    for (int64_t x = 0; x < source.width; ++x) {
      const auto pixel = static_cast<size_t>(y * source.width + x);
      const bool wall = x < source.width / 2;
      source.depth.values[pixel] = wall ? 1 : 10;
      for (size_t c = 0; c < 3; ++c) source.rgb[3 * pixel + c] = wall ? 1 : 0;
    }
  }
  // The wall moves 0.25 x 96 pixels, the far half 2.4.
  const auto row_of = [&](double moved) {
    const CarriedPicture carried = carry_pictures({source}, camera_before_plane({moved, 0, 0}, 0))[0];
    std::string row;
    for (int64_t x = 0; x < source.width; ++x) {
      const auto pixel = static_cast<size_t>(source.height / 2 * source.width + x);
      row += carried.seen[pixel] == 0 ? '.' : carried.rgb[3 * pixel] > 0.5F ? 'w' : 'b';
    }
    return row;
  };
  const std::string right = row_of(-0.25), back = row_of(0.25);
  EXPECT_NEAR(static_cast<double>(std::count(right.begin(), right.end(), 'w')), 48, 3);
  EXPECT_EQ(right.substr(0, 20), std::string(20, '.'));
  EXPECT_EQ(right.substr(76), std::string(20, 'b'));
  EXPECT_EQ(back.substr(0, 22), std::string(22, 'w'));
  EXPECT_GE(std::count(back.begin(), back.end(), '.'), 14);  // what the wall hid
}

TEST(PictureWarp, UnknownDepthAndOtherSidesCarryNothing) {
  auto views = two_views_of_plane();
  for (const CarriedPicture& picture :
       carry_pictures(views, camera_before_plane({0, 0, 0}, std::acos(-1.0)))) {
    EXPECT_EQ(picture.seen_share(), 0);
  }
  for (const float unknown :
       {0.0F, -1.0F, std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()}) {
    for (PicturedView& view : views) {
      std::fill(view.depth.values.begin(), view.depth.values.end(), unknown);
    }
    const auto carried = carry_pictures(views, camera_between());
    for (const CarriedPicture& picture : carried) {
      EXPECT_EQ(picture.seen_share(), 0) << unknown;
      EXPECT_EQ(*std::max_element(picture.rgb.begin(), picture.rgb.end()), 0);
    }
    EXPECT_EQ(completed_picture(carried).seen_share(), 0);
  }
  // Numbers too large for any picture are not taken for one of its places.
  scale_depth(views, 0);
  for (PicturedView& view : views) std::fill(view.depth.values.begin(), view.depth.values.end(), 1e-38F);
  EXPECT_EQ(carry_pictures(views, camera_before_plane({1e30, 0, 0}, 0))[0].seen_share(), 0);
}

TEST(PictureWarp, ACompletedPictureIsTheMeanAndHasNoGaps) {
  CarriedPicture first;
  first.width = 4;
  first.height = 1;
  first.rgb = {0.2F, 0.2F, 0.2F, 0.4F, 0.4F, 0.4F, 0, 0, 0, 0, 0, 0};
  first.seen = {1, 1, 0, 0};
  CarriedPicture second = first;
  second.rgb = {0, 0, 0, 0.8F, 0.6F, 0.4F, 0, 0, 0, 0, 0, 0};
  second.seen = {0, 1, 0, 0};
  const CarriedPicture completed = completed_picture({first, second});
  EXPECT_EQ(completed.seen, (std::vector<uint8_t>{1, 1, 0, 0}));
  const std::vector<float> expected{0.2F, 0.2F, 0.2F, 0.6F, 0.5F, 0.4F, 0.6F, 0.5F, 0.4F, 0.6F, 0.5F, 0.4F};
  for (size_t i = 0; i < expected.size(); ++i) EXPECT_NEAR(completed.rgb[i], expected[i], 1e-6) << i;
}

}  // namespace
}  // namespace gld
