#include "gld/metrics/energy_score.h"

#include "gld/metrics/image_metrics.h"
#include "gld/metrics/metric_list.h"
#include "gld/metrics/random_features.h"
#include "tests/support/error_of.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <ATen/CPUGeneratorImpl.h>
#include <ATen/Parallel.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

torch::Tensor grey(double value) { return torch::full({1, 3, 8, 8}, value); }

torch::Tensor random_pictures(at::IntArrayRef shape, uint64_t seed) {
  return torch::rand(shape, at::detail::createCPUGenerator(seed));
}

double value_of(const torch::Tensor& scores) { return scores[0].item<double>(); }

TEST(EnergyScore, IsTheMeanDistanceLessHalfTheSpread) {
  const auto of = [](const std::vector<torch::Tensor>& samples) {
    return value_of(energy_score(grey(0.5), torch::stack(samples)));
  };
  EXPECT_NEAR(of({grey(0.6), grey(0.9)}), (0.1 + 0.4) / 2 - 0.3 / 2, 1e-7);
  EXPECT_NEAR(of({grey(0.3), grey(0.9), grey(0.6)}), (0.2 + 0.4 + 0.1) / 3 - (0.6 + 0.3 + 0.3) / 3 / 2, 1e-7);
  EXPECT_NEAR(of({grey(0.7), grey(0.7), grey(0.7)}), 0.2, 1e-7);
  EXPECT_EQ(of({grey(0.5), grey(0.5)}), 0);
  // Beyond [0, 1] nothing counts.
  EXPECT_EQ(of({grey(1.0)}), of({grey(7.0)}));
  // Root mean square: a third of the colours half as wrong each, and one of 64 pixels.
  auto red = grey(0.5), dot = grey(0.5);
  red.select(1, 0) += 0.3;
  dot[0].select(1, 2).select(1, 5) += 0.4;
  EXPECT_NEAR(of({red}), 0.3 / std::sqrt(3.0), 1e-7);
  EXPECT_NEAR(of({dot}), 0.4 / 8, 1e-7);
}

TEST(EnergyScore, OfOneSampleIsItsDistance) {
  const auto truth = random_pictures({2, 3, 24, 20}, 1), picture = random_pictures({2, 3, 24, 20}, 2);
  const auto score = energy_score(truth, picture.unsqueeze(0));
  const auto features = energy_score_of_features(truth, picture.unsqueeze(0));
  EXPECT_EQ(score.scalar_type(), torch::kFloat64);
  const auto by_psnr = torch::pow(10.0, psnr(truth, picture) / -20);
  EXPECT_LT((score - by_psnr).abs().max().item<double>(), 1e-6);
  EXPECT_LT((features - random_feature_distance(truth, picture).sqrt()).abs().max().item<double>(), 1e-5);
}

TEST(EnergyScore, MeasuresEachViewByItself) {
  const auto truth = random_pictures({3, 3, 16, 16}, 3), samples = random_pictures({4, 3, 3, 16, 16}, 4);
  for (const auto score : {energy_score, energy_score_of_features}) {
    const auto together = score(truth, samples, {});
    for (int64_t view = 0; view < 3; ++view) {
      EXPECT_EQ(together[view].item<double>(),
                value_of(score(truth.narrow(0, view, 1), samples.narrow(1, view, 1), {})));
    }
  }
}

TEST(EnergyScore, CountsThePixelsOfAMask) {
  const auto truth = random_pictures({2, 3, 32, 32}, 5);
  auto samples = truth.unsqueeze(0).expand({3, 2, 3, 32, 32}).clone();
  // What is drawn differs in the right half only.
  samples.narrow(4, 16, 16).copy_(random_pictures({3, 2, 3, 32, 16}, 6));
  auto left = torch::zeros({2, 32, 32}, torch::kBool);
  left.narrow(2, 0, 16).fill_(true);
  EXPECT_EQ(value_of(energy_score(truth, samples, left)), 0);
  // By hand: what is on the right is a picture of its own.
  EXPECT_NEAR(value_of(energy_score(truth, samples, left.logical_not())),
              value_of(energy_score(truth.narrow(3, 16, 16), samples.narrow(4, 16, 16))), 1e-12);
  EXPECT_NEAR(value_of(energy_score(truth, samples, left.logical_not())),
              std::sqrt(2.0) * value_of(energy_score(truth, samples)), 1e-12);
  for (const auto score : {energy_score, energy_score_of_features}) {
    EXPECT_EQ(value_of(score(truth, samples, torch::ones({2, 32, 32}, torch::kBool))),
              value_of(score(truth, samples, {})));
    // A view without such a pixel has none, beside one that has.
    auto first = left.clone();
    first[1].fill_(false);
    const auto of_first = score(truth, samples, first);
    EXPECT_TRUE(std::isnan(of_first[1].item<double>()));
    EXPECT_EQ(value_of(of_first), value_of(score(truth, samples, left)));
  }
  // Features see a few pixels beyond, and nothing far away: the map of an eighth of the size sees 8.
  auto corner = torch::zeros({2, 32, 32}, torch::kBool);
  corner.narrow(2, 0, 1).fill_(true);
  EXPECT_LT(value_of(energy_score_of_features(truth, samples, corner)), 1e-5);
  EXPECT_LT(value_of(energy_score_of_features(truth, samples, left)),
            0.6 * value_of(energy_score_of_features(truth, samples, left.logical_not())));
}

// The parts of a mask add up to the whole: of one sample the squares do.
TEST(EnergyScore, SquaresOfSeenAndUnseenAddUp) {
  const auto truth = random_pictures({1, 3, 16, 24}, 7), sample = random_pictures({1, 1, 3, 16, 24}, 8);
  const auto seen = random_pictures({1, 16, 24}, 9) < 0.3;
  const double share = seen.to(torch::kFloat64).mean().item<double>();
  const double inside = value_of(energy_score(truth, sample, seen));
  const double outside = value_of(energy_score(truth, sample, seen.logical_not()));
  EXPECT_NEAR(std::pow(value_of(energy_score(truth, sample)), 2),
              share * inside * inside + (1 - share) * outside * outside, 1e-9);
}

// Four pictures of which the truth is one, with these probabilities.
class Properness : public testing::TestWithParam<decltype(&energy_score)> {
 protected:
  static constexpr int64_t kPictures = 4;
  using Probabilities = std::vector<double>;  // of the pictures

  Properness() : pictures_(random_pictures({kPictures, 1, 3, 16, 16}, 10)) {
    for (int64_t truth = 0; truth < kPictures; ++truth) {
      for (int64_t a = 0; a < kPictures; ++a) {
        for (int64_t b = 0; b < kPictures; ++b) {
          scores_[truth][a][b] = score(truth, {pictures_[a], pictures_[b]});
        }
      }
    }
  }

  double score(int64_t truth, const std::vector<torch::Tensor>& samples) const {
    return value_of(GetParam()(pictures_[truth], torch::stack(samples), {}));
  }

  // Returns the exact score: it is over all truths and all pairs of samples, which are drawn independently.
  double expected_score(const Probabilities& predicted, const Probabilities& true_ones) const {
    double sum = 0;
    for (int64_t truth = 0; truth < kPictures; ++truth) {
      for (int64_t a = 0; a < kPictures; ++a) {
        for (int64_t b = 0; b < kPictures; ++b) {
          sum += true_ones[truth] * predicted[a] * predicted[b] * scores_[truth][a][b];
        }
      }
    }
    return sum;
  }
  // Returns that of one picture whatever the truth, as a sample repeated.
  double expected_score(const torch::Tensor& picture, const Probabilities& true_ones) const {
    double sum = 0;
    for (int64_t truth = 0; truth < kPictures; ++truth)
      sum += true_ones[truth] * score(truth, {picture, picture});
    return sum;
  }

  torch::Tensor pictures_;
  double scores_[kPictures][kPictures][kPictures] = {};
};

TEST_P(Properness, NoOtherDistributionScoresBetterThanTheTrueOne) {
  const Probabilities truth{0.5, 0.25, 0.25, 0};
  const double best = expected_score(truth, truth);
  EXPECT_GT(best, 0);  // it is not known which picture it will be
  constexpr int64_t kSteps = 8;
  int64_t others = 0;
  for (int64_t a = 0; a <= kSteps; ++a) {
    for (int64_t b = 0; a + b <= kSteps; ++b) {
      for (int64_t c = 0; a + b + c <= kSteps; ++c) {
        Probabilities other;
        for (const int64_t part : {a, b, c, kSteps - a - b - c})
          other.push_back(static_cast<double>(part) / kSteps);
        if (other == truth) continue;
        EXPECT_GT(expected_score(other, truth), best + 1e-4);
        ++others;
      }
    }
  }
  EXPECT_EQ(others, 165 - 1);
}

TEST_P(Properness, NeitherABlurNorAnInventionWins) {
  const Probabilities truth{0.25, 0.25, 0.25, 0.25};
  const double best = expected_score(truth, truth);
  const auto blur = pictures_.mean(0);
  EXPECT_GT(expected_score(blur, truth), 1.1 * best);
  for (int64_t picture = 0; picture < kPictures; ++picture) {
    EXPECT_GT(expected_score(pictures_[picture], truth), 1.1 * best);
  }
  EXPECT_GT(expected_score(random_pictures({1, 3, 16, 16}, 11), truth), 1.1 * best);
  EXPECT_GT(expected_score(torch::full({1, 3, 16, 16}, 0.5), truth), 1.1 * best);
}

INSTANTIATE_TEST_SUITE_P(EnergyScore, Properness, testing::Values(energy_score, energy_score_of_features));

// PSNR says this of the same blur: hence the score.
TEST(EnergyScore, PrefersSamplesWherePsnrPrefersABlur) {
  const int64_t count = 40;
  const auto truths = random_pictures({count, 3, 12, 12}, 12);
  const auto samples = random_pictures({4, count, 3, 12, 12}, 13);  // of the same distribution
  const auto blur = torch::full_like(truths, 0.5);
  EXPECT_GT(psnr(truths, blur).mean().item<double>(), psnr(truths, samples[0]).mean().item<double>() + 2);
  EXPECT_LT(energy_score(truths, samples).mean().item<double>(),
            0.8 * energy_score(truths, blur.unsqueeze(0)).mean().item<double>());
}

// The samples have too little and too much difference, Gaussian in every pixel.
TEST(EnergyScore, IsLeastForSamplesThatDifferAsMuchAsTheTruthDoes) {
  const int64_t count = 1500;
  const auto noise = [&](at::IntArrayRef shape, uint64_t seed) {
    return torch::randn(shape, at::detail::createCPUGenerator(seed)) * 0.1;
  };
  // Few places, so that by chance samples of a room are near or far.
  const auto enlarge = [](const torch::Tensor& colours) { return colours.expand({-1, 3, 4, 4}); };
  const auto truths = enlarge(0.5 + noise({count, 3, 1, 1}, 14));
  const auto drawn = noise({4, count, 3, 1, 1}, 15);
  const auto score = [&](double spread) {
    return energy_score(truths, (0.5 + spread * drawn).expand({4, count, 3, 4, 4})).mean().item<double>();
  };
  EXPECT_LT(score(1), score(0.4));
  EXPECT_LT(score(1), score(0));
  EXPECT_LT(score(1), score(2));
}

TEST(EnergyScore, OfMoreSamplesThanPartnersIsOverTheNearestPairs) {
  const int64_t count = kMostPartners + 20;
  std::vector<torch::Tensor> samples;
  for (int64_t i = 0; i < count; ++i) samples.push_back(grey(static_cast<double>((i * 37) % count) / count));
  double to_truth = 0, between = 0;
  int64_t pairs = 0;
  const auto shade = [&](int64_t i) {
    return static_cast<double>((i * 37) % count) / static_cast<double>(count);
  };
  for (int64_t i = 0; i < count; ++i) {
    to_truth += std::abs(shade(i) - 0.25) / static_cast<double>(count);
    for (int64_t j = std::max<int64_t>(0, i - kMostPartners); j < i; ++j, ++pairs) {
      between += std::abs(shade(i) - shade(j));
    }
  }
  EXPECT_NEAR(value_of(energy_score(grey(0.25), torch::stack(samples))),
              to_truth - between / static_cast<double>(pairs) / 2, 1e-7);
}

TEST(EnergyScore, IsEqualToTheBitForAnyThreads) {
  const auto truth = random_pictures({2, 3, 112, 112}, 16),
             samples = random_pictures({3, 2, 3, 112, 112}, 17);
  const auto seen = random_pictures({2, 112, 112}, 18) < 0.5;
  const int before = at::get_num_threads();
  std::vector<torch::Tensor> found;
  for (const int threads : {1, 2, 3, 5}) {
    at::set_num_threads(threads);
    found.push_back(torch::cat({energy_score(truth, samples), energy_score_of_features(truth, samples),
                                energy_score_of_features(truth, samples, seen)}));
  }
  at::set_num_threads(before);
  for (const auto& scores : found) EXPECT_TRUE(torch::equal(scores, found.front()));
}

TEST(EnergyScore, RefusesOtherShapes) {
  const auto truth = torch::zeros({1, 3, 8, 8});
  EXPECT_EQ(
      test::error_of([&] {
        energy_score(truth, torch::zeros({2, 1, 3, 8, 9}));
      }),
      "energy score: expected images (views, 3, height, width) and samples of them (samples, views, 3, height, "
      "width), found [1, 3, 8, 8] and [2, 1, 3, 8, 9]; give samples of the same views.");
  EXPECT_EQ(
      test::error_of([&] {
        energy_score_of_features(truth, truth.unsqueeze(0), torch::ones({1, 8}, torch::kBool));
      }),
      "energy score of features: expected pixels (views, height, width) of the images, found [1, 8]; choose "
      "among the pixels of [1, 3, 8, 8].");
  EXPECT_NE(test::error_of([&] { energy_score(truth, torch::zeros({0, 1, 3, 8, 8})); }), "");
  const auto small = torch::zeros({1, 3, 7, 9});
  EXPECT_NE(test::error_of([&] { energy_score_of_features(small, small.unsqueeze(0)); }), "");
}

TEST(EnergyScore, IsAMetricOfAllSamplesOrAbsent) {
  MetricInputs inputs;
  inputs.true_images = random_pictures({2, 3, 16, 16}, 19);
  inputs.images = random_pictures({2, 3, 16, 16}, 20);
  const auto value = [&](const char* name) { return measure(metric_named(name), inputs); };
  for (const char* name :
       {"energy_score", "energy_score_seen", "energy_score_unseen", "energy_score_features",
        "energy_score_features_seen", "energy_score_features_unseen"}) {
    EXPECT_TRUE(metric_named(name).of_samples());
    EXPECT_FALSE(metric_named(name).of_images());
    EXPECT_EQ(metric_named(name).better, Better::kLower);
    EXPECT_EQ(value(name).absent, "there are no samples to compare");
  }
  inputs.samples = random_pictures({3, 2, 3, 16, 16}, 21);
  EXPECT_TRUE(torch::equal(value("energy_score").per_view, energy_score(inputs.true_images, inputs.samples)));
  EXPECT_EQ(value("energy_score_seen").absent, "no photographs were carried into the target views");
  inputs.shown = torch::zeros({2, 16, 16}, torch::kBool);
  EXPECT_EQ(value("energy_score_seen").absent, "no target view has such a pixel");
  EXPECT_TRUE(
      torch::equal(value("energy_score_features_unseen").per_view, value("energy_score_features").per_view));
  inputs.shown = torch::zeros({3, 16, 16}, torch::kBool);
  EXPECT_EQ(value("energy_score_unseen").absent, "the images are not those of the target views");
  inputs.true_images = torch::zeros({2, 3, 7, 16});
  inputs.samples = torch::zeros({1, 2, 3, 7, 16});
  EXPECT_EQ(value("energy_score_features").absent, "random features take images of at least 8 pixels");
  EXPECT_EQ(value("energy_score").mean(), 0);
}

}  // namespace
}  // namespace gld
