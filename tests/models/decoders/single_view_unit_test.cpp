#include "models/decoders/single_view_unit.h"

#include <cmath>
#include <limits>
#include <vector>

#include <ATen/CPUGeneratorImpl.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

struct Drawn {
  torch::Tensor features;
  std::vector<double> log_units;
};

// Units that follow from the first two of ten features, but for noise of that deviation.
Drawn drawn(int64_t scenes, double noise, uint64_t seed) {
  auto generator = at::detail::createCPUGenerator(seed);
  Drawn result;
  result.features = torch::empty({scenes, 10}, torch::kFloat64).normal_(3, 2, generator);
  const auto off = torch::empty({scenes}, torch::kFloat64).normal_(0, noise, generator);
  for (int64_t i = 0; i < scenes; ++i) {
    const auto feature = [&](int64_t j) { return result.features[i][j].item<double>(); };
    result.log_units.push_back(1.2 + 0.08 * feature(0) - 0.05 * feature(1) + off[i].item<double>());
  }
  return result;
}

TEST(SingleViewUnit, TellsTheUnitOfOtherScenesAsWellAsItSays) {
  const Drawn seen = drawn(400, 0.05, 3), others = drawn(400, 0.05, 4);
  const SingleViewUnit unit = fit_single_view_unit(seen.features, seen.log_units);
  EXPECT_NEAR(unit.log_deviation, 0.05, 0.006);
  double squares = 0;
  for (int64_t i = 0; i < 400; ++i) {
    const UnitGuess guess = guessed_unit(unit, others.features[i]);
    EXPECT_EQ(guess.log_deviation, unit.log_deviation);
    squares += std::pow(std::log(guess.metres) - others.log_units[static_cast<size_t>(i)], 2);
  }
  EXPECT_NEAR(std::sqrt(squares / 400), unit.log_deviation, 0.006);
}

// Every scene fitted without it in so many words, by each of the penalties: the best of them is what is said.
TEST(SingleViewUnit, SaysWhatScenesThatAreLeftOutAreOffBy) {
  const Drawn seen = drawn(14, 0.1, 5);
  const int64_t scenes = 14;
  const auto known = (seen.features - seen.features.mean(0)) / seen.features.std(0, /*unbiased=*/false);
  const auto wanted = torch::tensor(seen.log_units, torch::kFloat64);
  const auto with_one = torch::cat({known, torch::ones({scenes, 1}, torch::kFloat64)}, 1);
  double best = std::numeric_limits<double>::infinity();
  for (const double penalty : {1e-3, 1e-2, 1e-1, 1.0, 10.0}) {
    auto penalties = torch::full({11}, penalty * scenes, torch::kFloat64);
    penalties[10] = 0;  // the mean is free
    double squares = 0;
    for (int64_t out = 0; out < scenes; ++out) {
      const auto others = torch::cat({with_one.slice(0, 0, out), with_one.slice(0, out + 1)});
      const auto their_units = torch::cat({wanted.slice(0, 0, out), wanted.slice(0, out + 1)});
      const auto weights = torch::linalg_solve(torch::mm(others.t(), others) + torch::diag(penalties),
                                               torch::mv(others.t(), their_units));
      squares += std::pow((wanted[out] - with_one[out].dot(weights)).item<double>(), 2);
    }
    best = std::min(best, std::sqrt(squares / scenes));
  }
  EXPECT_NEAR(fit_single_view_unit(seen.features, seen.log_units).log_deviation, best, 1e-9);
}

TEST(SingleViewUnit, GoesNoFurtherThanWhatWasSeen) {
  const Drawn seen = drawn(100, 0.02, 6);
  const SingleViewUnit unit = fit_single_view_unit(seen.features, seen.log_units);
  const auto far = seen.features[0] + 1000 * unit.weights / unit.deviation;
  EXPECT_NEAR(guessed_unit(unit, far).metres, std::exp(unit.largest), 1e-9);
  EXPECT_NEAR(guessed_unit(unit, 2 * unit.mean - far).metres, std::exp(unit.least), 1e-9);
  const auto unknown = torch::full_like(far, std::nan(""));
  EXPECT_NEAR(guessed_unit(unit, unknown).metres, std::exp(unit.offset), 1e-9);
}

TEST(SingleViewUnit, AFeatureThatNeverChangesCountsForNothing) {
  Drawn seen = drawn(100, 0.02, 7);
  const SingleViewUnit without = fit_single_view_unit(seen.features.slice(1, 0, 9), seen.log_units);
  seen.features.select(1, 9).fill_(5);
  const SingleViewUnit unit = fit_single_view_unit(seen.features, seen.log_units);
  EXPECT_NEAR(unit.log_deviation, without.log_deviation, 1e-9);
  EXPECT_NEAR(unit.weights[9].item<double>(), 0, 1e-12);
}

TEST(SingleViewUnit, IsMadeOfTokensMeanDepthInCellsAndFocalLength) {
  const auto patches = torch::arange(12, torch::kFloat32).view({4, 3});
  auto depth = torch::full({16, 24}, 2.0F);
  depth.slice(0, 0, 2).slice(1, 0, 3).fill_(std::exp(1.0F));
  Camera camera;
  camera.width = 200;
  camera.intrinsics(0, 0) = 150;
  const auto features = single_view_features(look_of_view(patches, depth), camera);
  ASSERT_EQ(features.sizes(), (std::vector<int64_t>{3 + 64 + 1}));
  EXPECT_EQ(features.scalar_type(), torch::kFloat64);
  EXPECT_NEAR(features[0].item<double>(), 4.5, 1e-6);
  EXPECT_NEAR(features[3].item<double>(), 1, 1e-6);
  EXPECT_NEAR(features[4].item<double>(), std::log(2), 1e-6);
  EXPECT_NEAR(features[67].item<double>(), std::log(0.75), 1e-9);
}

}  // namespace
}  // namespace gld
