#include "gld/photogrammetry/edge_following_depth.h"

#include <cmath>
#include <cstdint>
#include <limits>

#include <gtest/gtest.h>

namespace gld {
namespace {

constexpr int64_t kWide = 48, kHigh = 32;

// The picture is dark on the left and bright on the right half.
PicturedView two_halves(int64_t enlarged = 1) {
  PicturedView picture;
  picture.width = kWide * enlarged;
  picture.height = kHigh * enlarged;
  picture.camera.width = picture.width;
  picture.camera.height = picture.height;
  for (int64_t y = 0; y < picture.height; ++y) {
    for (int64_t x = 0; x < picture.width; ++x)
      for (int channel = 0; channel < 3; ++channel)
        picture.rgb.push_back(2 * x < picture.width ? 0.2F : 0.8F);
  }
  return picture;
}

// Depth is 1 on the left and 2 on the right, smeared over so many columns to each side of the middle.
PlanarDepth step(double smeared) {
  PlanarDepth depth{kWide, kHigh, {}};
  for (int64_t y = 0; y < kHigh; ++y) {
    for (int64_t x = 0; x < kWide; ++x) {
      const double from_middle = static_cast<double>(x) + 0.5 - 0.5 * static_cast<double>(kWide);
      const double share = smeared == 0 ? (from_middle > 0 ? 1.0 : 0.0)
                                        : std::fmin(1, std::fmax(0, 0.5 + 0.5 * from_middle / smeared));
      depth.values.push_back(static_cast<float>(1 + share));
    }
  }
  return depth;
}

double largest_error(const PlanarDepth& depth, const PlanarDepth& truth) {
  double largest = 0;
  for (size_t i = 0; i < truth.values.size(); ++i)
    largest = std::fmax(largest, std::fabs(std::log(depth.values[i] / truth.values[i])));
  return largest;
}

TEST(EdgeFollowingDepth, AnEdgeThatIsSmearedIsPutWhereThePictureHasIt) {
  const PlanarDepth truth = step(0), smeared = step(4);
  EXPECT_GT(largest_error(smeared, truth), 0.3);
  for (const int64_t enlarged : {1, 3}) {
    const PlanarDepth found = edge_following_depth(smeared, two_halves(enlarged), {}, 1);
    EXPECT_LT(largest_error(found, truth), 0.12) << enlarged;
  }
  // A picture without an edge tells nothing of where it is.
  PicturedView plain = two_halves();
  plain.rgb.assign(plain.rgb.size(), 0.5F);
  EXPECT_GT(largest_error(edge_following_depth(smeared, plain, {}, 1), truth), 0.2);
}

TEST(EdgeFollowingDepth, WhatPhotographsConfirmStays) {
  const PlanarDepth smeared = step(4);
  ConfidenceMap confirmed(kWide, kHigh);
  for (int64_t y = 0; y < kHigh; y += 2) {
    for (int64_t x = 0; x < kWide; ++x) confirmed.at(x, y) = 0.5F;
  }
  const PlanarDepth found = edge_following_depth(smeared, two_halves(), confirmed, 1);
  double moved = 0;
  for (size_t i = 0; i < found.values.size(); ++i) {
    const bool is_confirmed = (static_cast<int64_t>(i) / kWide) % 2 == 0;
    if (is_confirmed) {
      ASSERT_NEAR(found.values[i], smeared.values[i], 1e-6F) << i;
    } else {
      moved = std::fmax(moved, std::fabs(found.values[i] - smeared.values[i]));
    }
  }
  EXPECT_GT(moved, 0.1);
}

// A median of one side of a slope would shift it.
TEST(EdgeFollowingDepth, ASlopeAcrossATextureStays) {
  PicturedView stripes = two_halves();
  PlanarDepth floor{kWide, kHigh, {}};
  for (int64_t y = 0; y < kHigh; ++y) {
    for (int64_t x = 0; x < kWide; ++x) {
      floor.values.push_back(static_cast<float>(2 * std::exp(0.01 * static_cast<double>(y))));
      for (int channel = 0; channel < 3; ++channel)
        stripes.rgb[static_cast<size_t>(3 * (y * kWide + x) + channel)] = (y / 4) % 2 == 0 ? 0.2F : 0.8F;
    }
  }
  EXPECT_LT(largest_error(edge_following_depth(floor, stripes, {}, 1), floor), 1e-6);
}

TEST(EdgeFollowingDepth, WhatIsNotKnownStaysSoAndIsNotAsked) {
  PlanarDepth smeared = step(4);
  const size_t hole = static_cast<size_t>(10 * kWide + kWide / 2);
  for (const float unknown : {0.0F, -1.0F, std::numeric_limits<float>::infinity()}) {
    smeared.values[hole] = unknown;
    const PlanarDepth found = edge_following_depth(smeared, two_halves(), {}, 1);
    EXPECT_EQ(found.values[hole], unknown);
    for (size_t i = 0; i < found.values.size(); ++i) {
      if (i == hole) continue;
      ASSERT_TRUE(found.values[i] >= 1 && found.values[i] <= 2) << i;
    }
  }
  EXPECT_TRUE(edge_following_depth({}, two_halves(), {}, 1).values.empty());
  EXPECT_EQ(edge_following_depth(step(4), PicturedView(), {}, 1).values, step(4).values);
}

TEST(EdgeFollowingDepth, ThreadsGiveTheSameBits) {
  EXPECT_EQ(edge_following_depth(step(4), two_halves(), {}, 1).values,
            edge_following_depth(step(4), two_halves(), {}, 2).values);
}

}  // namespace
}  // namespace gld
