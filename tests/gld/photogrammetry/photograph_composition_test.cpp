#include "gld/photogrammetry/photograph_composition.h"

#include "gld/cameras/resized_camera.h"
#include "tests/support/photograph_error.h"
#include "tests/support/striped_wall.h"
#include "tests/support/textured_plane.h"

#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::camera_before_plane;
using test::camera_between;
using test::mean_error;
using test::two_views_of_plane;

void brighten(PicturedView& view, float factor) {
  for (float& value : view.rgb) value *= factor;
}

TEST(PhotographComposition, AViewIsWhatItsPhotographsShow) {
  const auto sources = two_views_of_plane();
  const PhotographView view = view_from_photographs(sources, exposure_gains(sources), camera_between());
  EXPECT_GT(view.shown_share(), 0.95);
  EXPECT_LT(mean_error(view, test::TexturedPlane().seen_by(camera_between(), 1).rgb), 0.01);
}

// A larger target has the photographs' own resolution: depth is matched small, colours are not.
TEST(PhotographComposition, ColoursHaveTheSizeOfTheTarget) {
  const auto sources = two_views_of_plane();
  const Camera large =
      resized_camera(camera_between(), 3 * camera_between().width, 3 * camera_between().height);
  PhotographViewOptions options;
  options.matched_side = 48;
  const PhotographView view = view_from_photographs(sources, exposure_gains(sources), large, options);
  EXPECT_EQ(view.width, large.width);
  EXPECT_LT(mean_error(view, test::TexturedPlane().seen_by(large, 1).rgb), 0.02);
}

// Seen half a pixel further, a wave six pixels long keeps .974 of its height by the spline, and .866 where pixels are
// averaged.
TEST(PhotographComposition, WhatIsShownOfAPhotographIsNotAveragedBetweenPixels) {
  const auto wave = [](double column) { return 0.4 * std::sin(2 * std::acos(-1.0) / 6 * column); };
  const PicturedView source = test::striped_wall([&](double column) { return 0.5 + wave(column); });
  const Camera target = test::half_a_pixel_beside(source.camera);
  const PhotographView view = view_from_photographs({source}, {{1, 1, 1}}, target);
  for (int64_t column = 4; column < view.width - 5; ++column) {
    const double kept =
        static_cast<double>(view.rgb[static_cast<size_t>(3 * (10 * view.width + column))]) - 0.5;
    ASSERT_NEAR(kept, 0.974 * wave(static_cast<double>(column) + 0.5), 1e-3) << column;
  }
}

TEST(PhotographComposition, ExposureIsTheFactorBetweenPhotographs) {
  auto sources = two_views_of_plane();
  EXPECT_EQ(exposure_gains(sources)[0], (ColourGains{1, 1, 1}));
  brighten(sources[1], 0.5F);
  const auto gains = exposure_gains(sources);
  for (size_t c = 0; c < 3; ++c) {
    EXPECT_NEAR(gains[1][c] / gains[0][c], 2, 0.04)
        << c;  // the median of pixels that bilinear carrying moves a little
    EXPECT_NEAR(gains[0][c] * gains[1][c], 1, 1e-4) << c;
  }
  // Of one brightness they agree, and the view has that of the nearer one.
  const PhotographView matched = view_from_photographs(sources, gains, sources[0].camera);
  const PhotographView raw = view_from_photographs(sources, {{1, 1, 1}, {1, 1, 1}}, sources[0].camera);
  EXPECT_LT(mean_error(matched, sources[0].rgb), 0.02);
  EXPECT_GT(mean_error(raw, sources[0].rgb), 2 * mean_error(matched, sources[0].rgb));
}

TEST(PhotographComposition, PhotographsThatShareNothingKeepTheirExposure) {
  auto sources = two_views_of_plane();
  sources[1].camera = camera_before_plane({0, 0, 0}, std::acos(-1.0));  // looks away
  brighten(sources[1], 0.3F);
  EXPECT_EQ(exposure_gains(sources)[1], (ColourGains{1, 1, 1}));
  EXPECT_TRUE(exposure_gains({}).empty());
}

TEST(PhotographComposition, WhatContradictsIsDoubted) {
  auto sources = two_views_of_plane();
  for (float& value : sources[1].rgb) value = 1 - value;
  const std::vector<ColourGains> none{{1, 1, 1}, {1, 1, 1}};
  const PhotographView at_odds = view_from_photographs(sources, none, camera_between());
  const PhotographView agreed = view_from_photographs(two_views_of_plane(), none, camera_between());
  const auto middle =
      static_cast<size_t>(camera_between().height / 2 * camera_between().width + camera_between().width / 2);
  EXPECT_GT(at_odds.variance[middle], 10 * agreed.variance[middle]);
}

TEST(PhotographComposition, AViewIsCompleteWhereAllIsShownAndAgrees) {
  auto sources = two_views_of_plane();
  sources.push_back(test::TexturedPlane().seen_by(camera_before_plane({0.2, 0, -1.5}, -0.05), 1));
  sources.push_back(test::TexturedPlane().seen_by(camera_before_plane({0.8, 0, -1.5}, -0.15), 1));
  const std::vector<ColourGains> none(4, ColourGains{1, 1, 1});
  // From behind both of the first it would need what nobody saw; before the last two all is inside of both.
  PhotographView inside = view_from_photographs(sources, none, camera_before_plane({0.5, 0, 0}, -0.1));
  EXPECT_TRUE(inside.complete());
  EXPECT_FALSE(view_from_photographs(sources, none, camera_before_plane({0.5, 0, -4}, -0.1)).complete());
  // One pixel in a hundred that nobody shows is too much, and so is what contradicts.
  PhotographView holes = inside, doubtful = inside;
  for (size_t i = 0; i < holes.variance.size(); i += 100)
    holes.variance[i] = std::numeric_limits<float>::infinity();
  EXPECT_FALSE(holes.complete());
  for (float& variance : doubtful.variance) variance += 0.01F;
  EXPECT_FALSE(doubtful.complete());
}

TEST(PhotographComposition, NothingShownIsGreyOrGenerated) {
  const PhotographView none = view_from_photographs({}, {}, camera_between());
  EXPECT_EQ(none.shown_share(), 0);
  EXPECT_FALSE(none.complete());
  for (const float value : filled(none)) ASSERT_EQ(value, 0.5F);
  const std::vector<float> generated(none.rgb.size(), 0.25F);
  EXPECT_EQ(compose(none, generated, generated_variance(none, generated)).rgb, generated);
}

// Half of the view is shown, and the generated picture is a tenth too dark everywhere: kept pixels are the
// photographs', and the rest meets them without a step.
TEST(PhotographComposition, TheGeneratedPartMeetsThePhotographsWithoutAStep) {
  const int64_t width = 40, height = 20;
  PhotographView view{width, height, std::vector<float>(3 * width * height, 0.0F),
                      std::vector<float>(width * height, std::numeric_limits<float>::infinity())};
  std::vector<float> truth(view.rgb.size()), generated(view.rgb.size());
  for (int64_t y = 0; y < height; ++y) {
    for (int64_t x = 0; x < width; ++x) {
      const auto pixel = static_cast<size_t>(y * width + x);
      for (size_t c = 0; c < 3; ++c) {
        truth[3 * pixel + c] = 0.5F + 0.3F * std::sin(0.5F * static_cast<float>(x));
        generated[3 * pixel + c] = truth[3 * pixel + c] - 0.1F;
        if (x < width / 2) view.rgb[3 * pixel + c] = truth[3 * pixel + c];
      }
      if (x < width / 2) view.variance[pixel] = 1e-6F;
    }
  }
  EXPECT_NEAR(generated_variance(view, generated), 0.01, 1e-4);
  const ComposedPicture composed = compose(view, generated, 0.01);
  for (size_t i = 0; i < truth.size(); ++i) ASSERT_NEAR(composed.rgb[i], truth[i], 1e-3) << i;
  EXPECT_GT(composed.shown[0], 0.99);
  EXPECT_EQ(composed.shown[static_cast<size_t>(width - 1)], 0);
}

TEST(PhotographComposition, TheExpectedErrorIsThatOfTheMixture) {
  PhotographView view;
  view.width = 2;
  view.height = 1;
  view.rgb.assign(6, 0.5F);
  view.variance = {0.001F, std::numeric_limits<float>::infinity()};
  constexpr double kUnseen = 0.02;  // of what no photograph shows, whoever makes it up
  EXPECT_NEAR(expected_variance(view, 0.001), (0.0005 + kUnseen) / 2, 1e-9);
  EXPECT_NEAR(expected_variance(view, std::numeric_limits<double>::infinity()), (0.001 + kUnseen) / 2, 1e-9);
  EXPECT_NEAR(expected_variance(view, 0), kUnseen / 2, 1e-9);  // a generated picture that is never wrong
  EXPECT_NEAR(expected_variance({}, 1), kUnseen, 1e-12);
}

// Of two halves photographs show the left one alone. What is generated is too dark all over, off by `error` one way and
// the other on the left, and has an invention on the right.
TEST(PhotographComposition, AGeneratedPictureIsBelievedAsFarAsItIsRightWherePhotographsTell) {
  constexpr int64_t kWidth = 40, kHeight = 10;
  constexpr auto kLast = static_cast<size_t>(kWidth * kHeight - 1);
  PhotographView view;
  view.width = kWidth;
  view.height = kHeight;
  view.rgb.assign(3 * (kLast + 1), 0.0F);
  view.variance.assign(kLast + 1, std::numeric_limits<float>::infinity());
  const auto is_left = [](size_t pixel) { return static_cast<int64_t>(pixel) % kWidth < kWidth / 2; };
  for (size_t pixel = 0; pixel <= kLast; ++pixel) {
    if (!is_left(pixel)) continue;
    view.variance[pixel] = 1e-6F;
    for (size_t c = 0; c < 3; ++c) view.rgb[3 * pixel + c] = 0.5F;
  }
  const double half = std::sqrt(0.004);
  for (const auto& [error, belief] :
       {std::pair(0.0, 1.0), std::pair(half, 0.5), std::pair(3 * half, 1.0 / 82)}) {
    std::vector<float> generated(view.rgb.size(), 0.4F);
    for (size_t pixel = 0; pixel <= kLast; ++pixel) {
      for (size_t c = 0; is_left(pixel) && c < 3; ++c)
        generated[3 * pixel + c] += static_cast<float>(pixel % 2 == 0 ? error : -error);
      if (!is_left(pixel)) generated[3 * pixel] += 0.3F;
    }
    EXPECT_NEAR(belief_in_generated(view, generated), belief, 1e-4);
    const ComposedPicture composed = compose(view, generated, generated_variance(view, generated));
    EXPECT_NEAR(composed.rgb[3 * kLast], 0.5 + 0.3 * belief, 0.01) << error;
    EXPECT_NEAR(composed.rgb[3 * kLast + 1], 0.5, 0.01) << error;
    EXPECT_NEAR(composed.rgb[3 * 45], 0.5, 1e-3) << error;  // what is shown stays
    EXPECT_EQ(composed.shown[kLast], 0) << error;
  }
  // A single photograph shows each place: nothing tells how good the generated picture is.
  PhotographView single = view;
  for (float& variance : single.variance) variance = std::max(variance, PhotographView::kVarianceOfOne);
  EXPECT_EQ(belief_in_generated(single, view.rgb), 0.5);
  // Where photographs show nothing at all there is nothing but the generated picture.
  view.variance.assign(kLast + 1, std::numeric_limits<float>::infinity());
  const std::vector<float> grey(view.rgb.size(), 0.4F);
  EXPECT_EQ(compose(view, grey, 1.0).rgb, grey);
}

}  // namespace
}  // namespace gld
