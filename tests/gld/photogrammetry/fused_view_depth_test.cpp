#include "gld/photogrammetry/fused_view_depth.h"

#include "tests/support/textured_plane.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::camera_before_plane;
using test::camera_between;
using test::two_views_of_plane;

constexpr double kExact = 0;  // depth of the sources that needs no match

// Returns two views of the plane with its exact depth, confirmed that far everywhere.
std::vector<ConfirmedDepth> sources_with(float confidence) {
  std::vector<ConfirmedDepth> sources;
  for (const PicturedView& view : two_views_of_plane()) {
    ConfidenceMap map(view.depth.width, view.depth.height);
    std::fill(map.values.begin(), map.values.end(), confidence);
    sources.push_back({view, map});
  }
  return sources;
}

PlanarDepth truth_of(const Camera& camera) { return test::TexturedPlane().seen_by(camera, 1).depth; }

PlanarDepth bent(PlanarDepth depth, double unit, double bend) {
  for (int64_t row = 0; row < depth.height; ++row) {
    for (int64_t column = 0; column < depth.width; ++column) {
      const double across = static_cast<double>(column) / static_cast<double>(depth.width) - 0.5;
      depth.values[static_cast<size_t>(row * depth.width + column)] *=
          static_cast<float>(std::exp(bend * across) / unit);
    }
  }
  return depth;
}

// Returns the mean of |log(depth / truth)| over the pixels of a range of columns.
double log_error(const PlanarDepth& depth, const PlanarDepth& truth, int64_t first, int64_t last) {
  double sum = 0, count = 0;
  for (int64_t row = 0; row < depth.height; ++row) {
    for (int64_t column = first; column < last; ++column) {
      const auto pixel = static_cast<size_t>(row * depth.width + column);
      sum += std::abs(std::log(static_cast<double>(depth.values[pixel] / truth.values[pixel])));
      count += 1;
    }
  }
  return sum / count;
}

double log_error(const PlanarDepth& depth, const PlanarDepth& truth) {
  return log_error(depth, truth, 0, depth.width);
}

TEST(FusedViewDepth, WhatPhotographsConfirmStandsWhateverThePredictionSays) {
  const PlanarDepth truth = truth_of(camera_between());
  const FusedViewDepth fused =
      fused_target_depth(sources_with(1), kExact, camera_between(), {bent(truth, 7, 0.8)});
  // Carrying smooths depth over three pixels.
  EXPECT_LT(log_error(fused.depth, truth), 0.005);
  EXPECT_NEAR(fused.unit, 7, 0.7);
  EXPECT_GT(*std::max_element(fused.confirmed.begin(), fused.confirmed.end()), 0.99F);
}

// Unconfirmed, and with a unit of its own, the prediction keeps its shape by half: the mean of both.
TEST(FusedViewDepth, WhatNoneConfirmsCountsLikeThePrediction) {
  const PlanarDepth truth = truth_of(camera_between());
  const PlanarDepth predicted = bent(truth, 7, 0.8);
  const FusedViewDepth fused = fused_target_depth(sources_with(0), kExact, camera_between(), {predicted});
  const double of_prediction = log_error(bent(truth, 1, 0.8), truth);
  EXPECT_NEAR(log_error(fused.depth, truth), of_prediction / 2, 0.1 * of_prediction);
  EXPECT_EQ(*std::max_element(fused.confirmed.begin(), fused.confirmed.end()), 0.0F);
}

// A camera to the side sees a part that no source shows: there the prediction counts, in the unit and with the bend of
// the part that is shown, without a step where this ends.
TEST(FusedViewDepth, WhatNoSourceShowsIsThePredictionWithoutAStep) {
  const Camera aside = camera_before_plane({1.6, 0, 0}, 0);
  const PlanarDepth truth = truth_of(aside);
  const FusedViewDepth fused = fused_target_depth(sources_with(1), kExact, aside, {bent(truth, 0.2, 0)});
  const auto unseen = static_cast<size_t>(truth.height / 2 * truth.width + truth.width - 1);
  ASSERT_EQ(fused.confirmed[unseen], 0.0F) << "the test's camera sees too little";
  EXPECT_LT(log_error(fused.depth, truth), 0.005);
  const PlanarDepth off = fused_target_depth(sources_with(1), kExact, aside, {bent(truth, 0.2, 0.5)}).depth;
  for (int64_t column = 1; column < truth.width; ++column) {
    const auto pixel = static_cast<size_t>(truth.height / 2 * truth.width + column);
    EXPECT_LT(std::abs(std::log(off.values[pixel] / off.values[pixel - 1])), 0.08F) << column;
  }
}

// A head whose shape photographs contradict says nothing where no source looks, nor beside what a source says.
TEST(FusedViewDepth, APredictionThatIsNotBelievedYieldsToWhatIsAroundIt) {
  const Camera aside = camera_before_plane({1.6, 0, 0}, 0);
  const PlanarDepth truth = truth_of(aside);
  PlanarDepth noise = truth;
  for (size_t i = 0; i < noise.values.size(); ++i) noise.values[i] *= i % 2 == 0 ? 0.5F : 2.0F;
  const FusedViewDepth fused = fused_target_depth(sources_with(0), kExact, aside, {noise, 0});
  const double believed =
      log_error(fused_target_depth(sources_with(0), kExact, aside, {noise, 1}).depth, truth);
  EXPECT_LT(log_error(fused.depth, truth), 0.05);  // a slanted plane, continued without its slant
  EXPECT_GT(believed, 5 * log_error(fused.depth, truth));
}

TEST(FusedViewDepth, APriorIsBelievedByTheSpreadOfItsRatio) {
  EXPECT_EQ(belief_in_prior(std::nullopt), 1);
  PriorAgreement agreement;
  EXPECT_EQ(belief_in_prior(agreement), 1) << "photographs said nothing of it";
  agreement.pixels = 1000;
  agreement.spread = 0.25;
  EXPECT_NEAR(belief_in_prior(agreement), 0.5, 1e-12);
  agreement.spread = 0.05;
  EXPECT_GT(belief_in_prior(agreement), 0.99);
  agreement.spread = 1;
  EXPECT_LT(belief_in_prior(agreement), 0.01);
}

TEST(FusedViewDepth, ViewsThatNoSourceShowsHaveNone) {
  const Camera away = camera_before_plane({0, 0, 0}, std::acos(-1.0));
  const PlanarDepth predicted{8, 8, std::vector<float>(64, 2.0F)};
  EXPECT_TRUE(fused_target_depth(sources_with(1), kExact, away, {predicted}).depth.values.empty());
  EXPECT_TRUE(fused_target_depth({}, kExact, camera_between(), {predicted}).depth.values.empty());
}

TEST(FusedViewDepth, ASourceViewHasItsOwnDepthAndThePredictionInItsHoles) {
  ConfirmedDepth source = sources_with(1).front();
  const PlanarDepth truth = source.view.depth;
  for (int64_t row = 0; row < truth.height; ++row) {
    for (int64_t column = 0; column < truth.width / 2; ++column)
      source.view.depth.values[static_cast<size_t>(row * truth.width + column)] = 0;
  }
  PlanarDepth predicted = bent(truth, 3, 0);
  predicted.values.back() = std::numeric_limits<float>::quiet_NaN();
  const FusedViewDepth fused = fused_source_depth(source, {predicted});
  EXPECT_LT(log_error(fused.depth, truth), 1e-5);
  EXPECT_NEAR(fused.unit, 3, 1e-4);
  EXPECT_EQ(fused.depth.values.back(),
            truth.values.back());  // where there is no prediction the source's stands alone
}

}  // namespace
}  // namespace gld
