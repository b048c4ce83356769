#include "gld/photogrammetry/depth_hypotheses.h"

#include "gld/cameras/resized_camera.h"
#include "tests/support/textured_plane.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::camera_before_plane;
using test::camera_between;
using test::TexturedPlane;
using test::two_views_of_plane;

// A plane whose depth is known, laid into the view between by depths that are `off` times the true ones.
PlacedPhotographs placed_plane(double off) {
  PlacedPhotographs placed;
  placed.photographs = two_views_of_plane();
  placed.target = camera_between();
  const PicturedView truth = TexturedPlane().seen_by(placed.target, 1);
  placed.depth.width = truth.width;
  placed.depth.height = truth.height;
  for (const float depth : truth.depth.values) {
    placed.depth.values.push_back(off * static_cast<double>(depth));
    placed.depth.reached.push_back(1);
  }
  return placed;
}

struct HypothesisErrors {
  double colour = 0;  // mean absolute, where it is shown
  double disagreement = 0;
  double shown = 0;  // share of pixels
};

HypothesisErrors errors_of(const DepthHypothesis& hypothesis, const std::vector<float>& truth) {
  HypothesisErrors errors;
  double count = 0;
  for (size_t pixel = 0; pixel < hypothesis.shown.size(); ++pixel) {
    if (hypothesis.shown[pixel] < 1) continue;
    count += 1;
    errors.disagreement += hypothesis.disagreement[pixel];
    for (size_t c = 0; c < 3; ++c)
      errors.colour += std::abs(hypothesis.rgb[3 * pixel + c] - truth[3 * pixel + c]) / 3;
  }
  errors.colour /= count;
  errors.disagreement /= count;
  errors.shown = count / static_cast<double>(hypothesis.shown.size());
  return errors;
}

TEST(DepthHypotheses, WhereDepthIsWrongTheFactorThatMendsItShowsTheTruth) {
  const std::vector<float> truth = TexturedPlane().seen_by(camera_between(), 1).rgb;
  for (const double factor : {0.94, 1.0, 1.06}) {
    const PlacedPhotographs placed = placed_plane(1 / factor);
    const HypothesisErrors right = errors_of(depth_hypothesis(placed, factor), truth);
    EXPECT_GT(right.shown, 0.8) << factor;
    EXPECT_LT(right.colour, 0.01) << factor;
    EXPECT_LT(right.disagreement, 0.01) << factor;
    const HypothesisErrors wrong = errors_of(depth_hypothesis(placed, factor * 1.13), truth);
    EXPECT_GT(wrong.colour, 5 * right.colour) << factor;
    EXPECT_GT(wrong.disagreement, 3 * right.disagreement) << factor;
  }
}

TEST(DepthHypotheses, WhatNoPhotographShowsIsZero) {
  PlacedPhotographs placed = placed_plane(1);
  placed.depth.reached.assign(placed.depth.reached.size(), 0);
  const DepthHypothesis none = depth_hypothesis(placed, 1);
  for (const std::vector<float>* values : {&none.rgb, &none.disagreement, &none.shown})
    EXPECT_EQ(*values, std::vector<float>(values->size(), 0.0F));
  placed = placed_plane(1);
  placed.photographs.resize(1);
  const DepthHypothesis one = depth_hypothesis(placed, 1);
  EXPECT_EQ(*std::max_element(one.shown.begin(), one.shown.end()), 0.5F);
  EXPECT_EQ(one.disagreement, std::vector<float>(one.disagreement.size(), 0.0F));
}

TEST(DepthHypotheses, TheNearestPhotographsAreAsked) {
  PlacedPhotographs placed = placed_plane(1);
  placed.photographs.insert(placed.photographs.begin(),
                            TexturedPlane().seen_by(camera_before_plane({-3, 0, 0}, 0.4), 1));
  const PlacedPhotographs nearest = nearest_photographs(placed);
  ASSERT_EQ(nearest.photographs.size(), kHypothesisPhotographs);
  EXPECT_EQ(nearest.depth.values, placed.depth.values);
  for (const PicturedView& photograph : nearest.photographs)
    EXPECT_GT(photograph.camera.world_from_camera.translation().x(), -1);
}

TEST(DepthHypotheses, ReducedPhotographsLieWhereTheLargeOnesDo) {
  const PlacedPhotographs small = reduced(placed_plane(1), 48);
  EXPECT_EQ(small.target.width, 48);
  EXPECT_EQ(small.depth.values.size(), static_cast<size_t>(small.target.width * small.target.height));
  const Camera camera = resized_camera(camera_between(), small.target.width, small.target.height);
  const HypothesisErrors errors =
      errors_of(depth_hypothesis(small, 1), TexturedPlane().seen_by(camera, 1).rgb);
  EXPECT_GT(errors.shown, 0.8);
  EXPECT_LT(errors.colour, 0.03);  // area means beside the plane's own colours
  EXPECT_TRUE(reduced(PlacedPhotographs{{}, camera_between(), {}, {}}, 48).photographs.empty());
}

}  // namespace
}  // namespace gld
