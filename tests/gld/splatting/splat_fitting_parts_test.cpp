// The image loss, Adam, density control, and features by least squares.
#include "gld/splatting/density_control.h"
#include "gld/splatting/feature_harmonics.h"
#include "gld/splatting/feature_solve.h"
#include "gld/splatting/image_loss.h"
#include "gld/splatting/splat_adam.h"
#include "tests/gld/splatting/random_gaussians.h"
#include "tests/support/worst_of.h"

#include <algorithm>
#include <cmath>
#include <random>

#include <gtest/gtest.h>

namespace gld {
namespace {

SplatImage random_image(int64_t channels, int64_t width, int64_t height, unsigned seed) {
  std::mt19937 engine(seed);
  std::uniform_real_distribution<float> distribution(0, 1);
  SplatImage image(channels, width, height);
  for (int64_t c = 0; c < channels; ++c) {
    for (int64_t y = 0; y < height; ++y) {
      for (int64_t x = 0; x < width; ++x) image.row(c, y)[x] = distribution(engine);
    }
  }
  return image;
}

// Returns SSIM of a pixel as its formula stands, in double, with zeros beyond the picture.
double naive_similarity(const SplatImage& a, const SplatImage& b, int64_t c, int64_t px, int64_t py) {
  double weights[11], sum = 0;
  for (int k = 0; k < 11; ++k) sum += weights[k] = std::exp(-(k - 5) * (k - 5) / (2 * 1.5 * 1.5));
  double ma = 0, mb = 0, aa = 0, bb = 0, ab = 0;
  for (int64_t i = 0; i < 11; ++i) {
    for (int64_t j = 0; j < 11; ++j) {
      const int64_t x = px + i - 5, y = py + j - 5;
      if (x < 0 || y < 0 || x >= a.width || y >= a.height) continue;
      const double w = weights[i] * weights[j] / (sum * sum), va = a.row(c, y)[x], vb = b.row(c, y)[x];
      ma += w * va;
      mb += w * vb;
      aa += w * va * va;
      bb += w * vb * vb;
      ab += w * va * vb;
    }
  }
  const double c1 = 1e-4, c2 = 9e-4;
  return (2 * ma * mb + c1) * (2 * (ab - ma * mb) + c2) /
         ((ma * ma + mb * mb + c1) * (aa - ma * ma + bb - mb * mb + c2));
}

TEST(ImageLoss, IsItsFormula) {
  const SplatImage x = random_image(2, 21, 14, 1), y = random_image(2, 21, 14, 2);
  const ImageLoss loss = image_loss(x, loss_target(y, {}, {}), 0.2, {});
  double absolute = 0, similarity = 0;
  for (int64_t c = 0; c < 2; ++c) {
    for (int64_t row = 0; row < 14; ++row) {
      for (int64_t column = 0; column < 21; ++column) {
        absolute += std::abs(x.row(c, row)[column] - y.row(c, row)[column]) / (2 * 21 * 14);
        similarity += naive_similarity(x, y, c, column, row) / (2 * 21 * 14);
      }
    }
  }
  // Float sums of 121 products of at most 1, in a variance of about .08: 1e-6.
  EXPECT_NEAR(loss.absolute, absolute, 1e-6);
  EXPECT_NEAR(loss.similarity, similarity, 1e-5);
  EXPECT_NEAR(loss.loss, 0.8 * absolute + 0.2 * (1 - similarity), 1e-5);
  const ImageLoss same = image_loss(y, loss_target(y, {}, {}), 0.2, {});
  EXPECT_NEAR(same.loss, 0, 1e-6);
}

TEST(ImageLoss, GradientIsThatOfDifferences) {
  // Differences in double of the formula; L1's sign does not change within a step.
  SplatImage x = random_image(1, 16, 13, 3);
  const SplatImage y = random_image(1, 16, 13, 4);
  const ImageLoss loss = image_loss(x, loss_target(y, {}, {}), 0.2, {});
  const auto value = [&] {
    double sum = 0;
    for (int64_t row = 0; row < 13; ++row) {
      for (int64_t column = 0; column < 16; ++column) {
        sum += 0.8 * std::abs(static_cast<double>(x.row(0, row)[column]) - y.row(0, row)[column]) -
               0.2 * naive_similarity(x, y, 0, column, row);
      }
    }
    return sum / (16 * 13);
  };
  for (const auto& [column, row] : {std::pair<int64_t, int64_t>{0, 0}, {7, 6}, {15, 12}, {3, 11}, {14, 1}}) {
    float& pixel = x.row(0, row)[column];
    const float here = pixel;
    constexpr float kStep = 1.0F / 1024;
    pixel = here + kStep;
    const double above = value(), up = pixel;
    pixel = here - kStep;
    const double below = value(), down = pixel;
    pixel = here;
    const double slope = (above - below) / (up - down);
    // The error is the curvature of SSIM over 1e-3 of a pixel, and float's rounding of the gradient.
    EXPECT_NEAR(loss.gradient.row(0, row)[column], slope, 1e-3 * std::abs(slope) + 1e-6)
        << column << " " << row;
  }
}

TEST(ImageLoss, PixelsThatSayNothingHaveNoGradient) {
  const SplatImage x = random_image(3, 20, 12, 5), y = random_image(3, 20, 12, 6);
  std::vector<uint8_t> valid(20 * 12, 1);
  valid[3 * 20 + 7] = 0;
  const LossTarget target = loss_target(y, valid, {});
  const ImageLoss loss = image_loss(x, target, 0.2, {});
  SplatImage other = x;
  for (int64_t c = 0; c < 3; ++c) {
    EXPECT_EQ(loss.gradient.row(c, 3)[7], 0);
    other.row(c, 3)[7] = 17;
  }
  EXPECT_EQ(image_loss(other, target, 0.2, {}).loss, loss.loss);
  EXPECT_EQ(mean_squared_error(other, target), mean_squared_error(x, target));
}

TEST(SplatAdam, FirstStepIsTheRateAgainstTheSign) {
  GaussianSet set = random_gaussians({});
  const GaussianSet before = set;
  SplatMoments moments = splat_moments(set);
  GaussianSet gradients = zero_gaussians(set.size(), 0);
  for (size_t i = 0; i < gradients.means.size(); ++i) gradients.means[i] = i % 2 == 0 ? 1e-6F : -3e4F;
  gradients.logit_opacities[2] = 0.5F;
  SplatRates rates;
  adam_step(rates, {0, 2}, gradients, moments, set, {});
  for (size_t i = 0; i < set.means.size(); ++i)
    EXPECT_NEAR(set.means[i] - before.means[i], (i % 2 == 0 ? -1 : 1) * 2 * rates.mean, 1e-6);
  EXPECT_NEAR(set.logit_opacities[2] - before.logit_opacities[2], -rates.opacity, 1e-6);
  EXPECT_EQ(set.log_scales, before.log_scales);
  // At the end of the fit the rate of means is last_mean.
  moments = splat_moments(set);
  const float here = set.means[0];
  adam_step(rates, {1, 1e4}, gradients, moments, set, {});
  EXPECT_NEAR(set.means[0] - here, -1e4 * rates.last_mean, 1e-5);
}

DensityOptions published() {
  DensityOptions options;
  options.densify = Densification::kPublished;
  return options;
}

TEST(DensityControl, CopiesSplitsAndRemoves) {
  RandomGaussians wanted;
  wanted.count = 6;
  wanted.degree = 1;
  GaussianSet set = random_gaussians(wanted);
  for (float& logit : set.logit_opacities) logit = 1;
  set.logit_opacities[5] = -6;  // opacity .0025
  const float small = std::log(0.005F), large = std::log(0.2F);
  for (size_t i = 0; i < set.log_scales.size(); ++i) set.log_scales[i] = i < 3 ? small : large;
  const GaussianSet before = set;
  SplatMoments moments = splat_moments(set);
  std::fill(moments.first.means.begin(), moments.first.means.end(), 1.0F);
  DensityStatistics statistics;
  statistics.gradient_sums = {1e-3F, 1e-3F, 1e-4F, 9e-4F, 0, 0};
  statistics.seen = {2, 2, 1, 9, 0, 0};  // means 5e-4, 5e-4, 1e-4, 1e-4
  const DensityChange change = control_density(published(), {500, 30000, 1, 3}, statistics, set, moments);
  EXPECT_EQ(change.copied, 1);   // Gaussian 0, small
  EXPECT_EQ(change.split, 1);    // Gaussian 1, large
  EXPECT_EQ(change.removed, 1);  // Gaussian 5, faint
  EXPECT_FALSE(change.reset);
  ASSERT_EQ(set.size(), 7);  // 0, 2, 3, 4, the copy of 0, two halves of 1
  check_gaussians(set, "after");
  for (size_t k = 0; k < 3; ++k) {
    EXPECT_EQ(set.means[3 * 4 + k], before.means[k]);
    EXPECT_NEAR(set.log_scales[3 * 5 + k], large - std::log(1.6F), 1e-6);
    EXPECT_NE(set.means[3 * 5 + k], set.means[3 * 6 + k]);
    EXPECT_LT(std::abs(set.means[3 * 5 + k] - before.means[3 + k]), 6 * 0.2 * 1.8);
    EXPECT_EQ(moments.first.means[k], 1);
    EXPECT_EQ(moments.first.means[3 * 4 + k], 0);
  }
  EXPECT_EQ(moments.first.size(), 7);
  EXPECT_TRUE(statistics.seen.empty());
}

TEST(DensityControl, KeepsToItsCapAndResets) {
  GaussianSet set = random_gaussians({});
  SplatMoments moments = splat_moments(set);
  DensityStatistics statistics;
  statistics.gradient_sums.assign(20, 1.0F);
  statistics.gradient_sums[13] = 2;
  statistics.seen.assign(20, 1);
  DensityOptions options = published();
  options.most_gaussians = 21;
  options.faintest = 0;
  const GaussianSet before = set;
  const DensityChange change = control_density(options, {3000, 30000, 1, 3}, statistics, set, moments);
  EXPECT_EQ(change.copied + change.split, 1);  // only Gaussian 13 has room
  EXPECT_EQ(set.size(), 21);
  EXPECT_TRUE(change.reset);
  for (const float logit : set.logit_opacities) EXPECT_LE(1 / (1 + std::exp(-logit)), 0.01001);
  DensityOptions none;
  GaussianSet same = before;
  moments = splat_moments(same);
  control_density(none, {3000, 30000, 1, 3}, statistics, same, moments);
  EXPECT_EQ(same.logit_opacities, before.logit_opacities);
}

// What is added, split or made faint has to find its place before the fit ends.
TEST(DensityControl, LeavesTheEndOfAFitAlone) {
  EXPECT_EQ(last_density_step({}, 30000), 15000);
  EXPECT_EQ(last_density_step({}, 2000), 1900);
  const DensityOptions options = published();
  const auto change_at = [&](int64_t step, int64_t steps) {
    GaussianSet set = random_gaussians({});
    SplatMoments moments = splat_moments(set);
    DensityStatistics statistics;
    statistics.gradient_sums.assign(20, 1.0F);
    statistics.seen.assign(20, 1);
    return control_density(options, {step, steps, 1, 3}, statistics, set, moments);
  };
  const DensityChange last = change_at(3000, 3000), near_end = change_at(3000, 5999),
                      in_time = change_at(3000, 6000);
  EXPECT_EQ(last.copied + last.split + last.removed, 0);
  EXPECT_FALSE(last.reset);
  EXPECT_GT(near_end.copied + near_end.split, 0);
  EXPECT_FALSE(near_end.reset);
  EXPECT_TRUE(in_time.reset);
}

TEST(PixelWeights, AreWhatCompositingSums) {
  RandomGaussians wanted;
  wanted.count = 50;
  const GaussianSet set = random_gaussians(wanted);
  // The picture is no whole number of tiles, nor of vectors.
  const Camera camera = splat_test_camera(37, 21);
  const SplatView view = view_of_splats(set, splat_camera(camera, set.origin, {}), {});
  std::vector<float> values(50);
  for (size_t i = 0; i < values.size(); ++i) values[i] = static_cast<float>(i % 7) - 3;
  SplatFeatures features;
  features.values = values.data();
  features.channels = 1;
  features.by_index = true;
  const CompositedView picture = composite(view, features, {});
  KernelSettings threads;
  threads.threads = 3;
  const PixelWeights weights = pixel_weights(view, threads);
  ASSERT_EQ(weights.first.size(), 37U * 21 + 1);
  EXPECT_EQ(weights.first.back(), static_cast<int64_t>(weights.values.size()));
  for (int64_t pixel = 0; pixel < 37 * 21; ++pixel) {
    double sum = 0, seen = 0;
    for (int64_t k = weights.first[static_cast<size_t>(pixel)];
         k < weights.first[static_cast<size_t>(pixel) + 1]; ++k) {
      const double weight = weights.values[static_cast<size_t>(k)];
      EXPECT_GT(weight, 0);
      seen += weight;
      sum += weight * values[static_cast<size_t>(weights.columns[static_cast<size_t>(k)])];
    }
    EXPECT_NEAR(picture.image.row(0, pixel / 37)[pixel % 37], sum, 1e-5);
    EXPECT_NEAR(1 - picture.transmittance.row(0, pixel / 37)[pixel % 37], seen, 1e-5);
  }
}

struct FeatureCase {
  GaussianSet set;
  std::vector<FeatureView> views;
  int64_t channels = 0;
};
FeatureCase feature_case(int64_t gaussians, int64_t channels) {
  RandomGaussians wanted;
  wanted.count = gaussians;
  wanted.smallest = 0.02;
  wanted.largest = 0.1;
  const GaussianSet set = random_gaussians(wanted);
  FeatureCase result;
  result.set = set;
  result.channels = channels;
  for (const double angle : {-0.2, 0.0, 0.2}) {
    Camera camera = splat_test_camera(32, 24);
    camera.world_from_camera = Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitY()) * camera.world_from_camera;
    result.views.push_back({view_of_splats(set, splat_camera(camera, set.origin, {}), {}),
                            random_image(channels, 32, 24, static_cast<unsigned>(10 * angle + 9))});
  }
  return result;
}

// Returns the gradient of what is minimised, in double, over that of features of 0.
double relative_gradient(const FeatureCase& problem, const std::vector<float>& f, double ridge) {
  const auto n = static_cast<size_t>(problem.set.size());
  std::vector<double> sums(n, 0.0), totals(n, 0.0);
  double worst = 0;
  for (int64_t c = 0; c < problem.channels; ++c) {
    std::vector<double> gradient(n, 0.0), right(n, 0.0);
    std::fill(sums.begin(), sums.end(), 0.0);
    std::fill(totals.begin(), totals.end(), 0.0);
    for (const FeatureView& view : problem.views) {
      const PixelWeights weights = pixel_weights(view.view, {});
      for (int64_t pixel = 0; pixel < 32 * 24; ++pixel) {
        double shown = 0, seen = 0;
        const auto each = [&](const auto& visit) {
          for (int64_t k = weights.first[static_cast<size_t>(pixel)];
               k < weights.first[static_cast<size_t>(pixel) + 1]; ++k)
            visit(static_cast<size_t>(weights.columns[static_cast<size_t>(k)]),
                  static_cast<double>(weights.values[static_cast<size_t>(k)]));
        };
        each([&](size_t i, double w) {
          shown += w * f[i * static_cast<size_t>(problem.channels) + static_cast<size_t>(c)];
          seen += w;
        });
        const double picture = view.picture.row(c, pixel / 32)[pixel % 32];
        each([&](size_t i, double w) {
          gradient[i] += w * (picture - shown);
          right[i] += w * picture;
          sums[i] += w;
          totals[i] += w * seen;
        });
      }
    }
    double left = 0, whole = 0;
    for (size_t i = 0; i < n; ++i) {
      if (!(totals[i] > 0)) continue;
      const double mean = right[i] / sums[i];
      const double value = f[i * static_cast<size_t>(problem.channels) + static_cast<size_t>(c)];
      const double of_i = gradient[i] + ridge * totals[i] * (mean - value);
      const double right_of_i = right[i] + ridge * totals[i] * mean;
      left += of_i * of_i / totals[i];
      whole += right_of_i * right_of_i / totals[i];
    }
    worst = test::worst_of(worst, std::sqrt(left / whole));
  }
  return worst;
}

// More Gaussians than pixels tell apart; more channels than are taken together.
TEST(FeatureSolve, LeavesTheResidualThatItSays) {
  const FeatureCase problem = feature_case(1500, 70);
  FeatureSolveOptions options;
  const SolvedFeatures solved = solve_features(problem.views, problem.set, options, {});
  EXPECT_LE(solved.residuals.back(), options.tolerance);
  EXPECT_LT(solved.iterations(), options.most_iterations);
  // What is said comes from the recursion in float; sums of some hundred products round to some 1e-7.
  EXPECT_LT(relative_gradient(problem, solved.features, options.ridge), 3 * options.tolerance);
  EXPECT_GT(relative_gradient(problem, solved.features, 2 * options.ridge), 1e-5);
}

TEST(FeatureSolve, IsTheSameForAnyNumberOfThreads) {
  const FeatureCase problem = feature_case(700, 5);
  KernelSettings many;
  many.threads = 4;
  EXPECT_EQ(solve_features(problem.views, problem.set, {}, {}).features,
            solve_features(problem.views, problem.set, {}, many).features);
}

TEST(FeatureSolve, FindsTheFeaturesThatMadeThePictures) {
  RandomGaussians wanted;
  wanted.count = 60;
  wanted.smallest = 0.05;
  wanted.largest = 0.15;
  const GaussianSet set = random_gaussians(wanted);
  constexpr int64_t kChannels = 5;
  std::mt19937 engine(7);
  std::uniform_real_distribution<float> distribution(-1, 1);
  std::vector<float> truth(static_cast<size_t>(wanted.count * kChannels));
  for (float& value : truth) value = distribution(engine);
  SplatFeatures features;
  features.values = truth.data();
  features.channels = kChannels;
  features.by_index = true;
  std::vector<FeatureView> views;
  for (const double angle : {-0.2, 0.0, 0.2}) {
    Camera camera = splat_test_camera(64, 48);
    camera.world_from_camera = Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitY()) * camera.world_from_camera;
    SplatView view = view_of_splats(set, splat_camera(camera, set.origin, {}), {});
    SplatImage picture = composite(view, features, {}).image;
    views.push_back({std::move(view), std::move(picture)});
  }
  FeatureSolveOptions options;
  options.ridge = 0;
  options.most_iterations = 400;
  const SolvedFeatures solved = solve_features(views, set, options, {});
  EXPECT_LE(solved.residuals.back(), 1e-6);
  EXPECT_LT(solved.residuals.size(), 400U);
  // The pictures are those of the features, to the tolerance times what the matrix makes of it.
  features.values = solved.features.data();
  double worst = 0;
  for (const FeatureView& view : views) {
    const SplatImage again = composite(view.view, features, {}).image;
    for (size_t i = 0; i < again.values.size(); ++i)
      worst = test::worst_of(worst, std::abs(again.values[i] - view.picture.values[i]));
  }
  EXPECT_LT(worst, 1e-4);
}

// The views of a ring of cameras about the Gaussians: what differs with the direction.
std::vector<Camera> cameras_about(const std::vector<double>& angles, double tilt) {
  std::vector<Camera> cameras;
  const Eigen::Vector3d middle(0, 0, 4);
  for (const double angle : angles) {
    Camera camera = splat_test_camera(40, 30);
    const Eigen::Matrix3d turn = (Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitY()) *
                                  Eigen::AngleAxisd(tilt * std::sin(5 * angle), Eigen::Vector3d::UnitX()))
                                     .toRotationMatrix();
    camera.world_from_camera.linear() = turn * camera.world_from_camera.linear();
    camera.world_from_camera.translation() =
        middle + turn * (camera.world_from_camera.translation() - middle);
    cameras.push_back(camera);
  }
  return cameras;
}

struct DirectedCase {
  GaussianSet set;
  std::vector<float> truth;  // (gaussians, coefficients of degree 2, channels)
  int64_t channels = 3;

  FeatureView view_of(const Camera& camera) const {
    SplatView view = view_of_splats(set, splat_camera(camera, set.origin, {}), {});
    SplatImage picture = shown(view, truth, 2);
    return {std::move(view), std::move(picture)};
  }
  SplatImage shown(const SplatView& view, const std::vector<float>& values, int64_t degree) const {
    const std::vector<float> seen = seen_features(set, view, values.data(), degree, channels, {});
    SplatFeatures features;
    features.values = seen.data();
    features.channels = channels;
    return composite(view, features, {}).image;
  }
  // Returns the root of the mean squared difference over that of the picture.
  double error_of(const FeatureView& view, const std::vector<float>& values, int64_t degree) const {
    const SplatImage again = shown(view.view, values, degree);
    double apart = 0, size = 0;
    for (size_t i = 0; i < again.values.size(); ++i) {
      apart += std::pow(static_cast<double>(again.values[i]) - view.picture.values[i], 2);
      size += std::pow(static_cast<double>(view.picture.values[i]), 2);
    }
    return std::sqrt(apart / size);
  }
};

TEST(FeatureSolve, FeaturesThatDependOnTheDirectionNeedTheirDegree) {
  RandomGaussians wanted;
  wanted.count = 30;
  wanted.smallest = 0.08;
  wanted.largest = 0.2;
  DirectedCase problem;
  problem.set = random_gaussians(wanted);
  std::mt19937 engine(11);
  std::uniform_real_distribution<float> distribution(-1, 1);
  problem.truth.resize(static_cast<size_t>(wanted.count * harmonic_coefficients(2) * problem.channels));
  for (float& value : problem.truth) value = distribution(engine);
  std::vector<FeatureView> views;
  for (const Camera& camera : cameras_about({-1.2, -0.9, -0.6, -0.3, 0.0, 0.3, 0.6, 0.9, 1.2}, 0.5))
    views.push_back(problem.view_of(camera));
  FeatureSolveOptions options;
  options.ridge = 1e-6;
  options.most_iterations = 3000;
  std::vector<double> errors;
  for (options.feature_degree = 0; options.feature_degree <= 2; ++options.feature_degree) {
    const SolvedFeatures solved = solve_features(views, problem.set, options, {});
    ASSERT_EQ(solved.features.size(), static_cast<size_t>(wanted.count * problem.channels *
                                                          harmonic_coefficients(options.feature_degree)));
    double worst = 0;
    for (const FeatureView& view : views)
      worst = test::worst_of(worst, problem.error_of(view, solved.features, options.feature_degree));
    errors.push_back(worst);
    if (options.feature_degree < 2) continue;
    // Between the views that were fitted as well.
    for (const Camera& camera : cameras_about({-0.4, 0.5}, 0.5))
      EXPECT_LT(problem.error_of(problem.view_of(camera), solved.features, 2), 0.1);
  }
  EXPECT_GT(errors[0], 0.3);
  EXPECT_LT(errors[1], errors[0]);
  EXPECT_LT(errors[2], 0.02);
}

TEST(FeatureHarmonics, BeginWithOneAndAreEvenOverDirections) {
  RandomGaussians wanted;
  wanted.count = 2;
  GaussianSet set = random_gaussians(wanted);
  const Camera camera = splat_test_camera(40, 30);
  const SplatView view = view_of_splats(set, splat_camera(camera, set.origin, {}), {});
  ASSERT_EQ(view.size(), 2);
  const std::vector<float> b = feature_harmonics(set, view, 3, {});
  ASSERT_EQ(b.size(), 32U);
  for (size_t i = 0; i < 2; ++i) {
    // The addition theorem: the squares of a degree sum to 2 l + 1 for any direction.
    EXPECT_EQ(b[16 * i], 1);
    for (size_t degree = 1; degree <= 3; ++degree) {
      double squares = 0;
      for (size_t k = degree * degree; k < (degree + 1) * (degree + 1); ++k)
        squares += static_cast<double>(b[16 * i + k]) * b[16 * i + k];
      EXPECT_NEAR(squares, static_cast<double>(2 * degree + 1), 1e-5);
    }
  }
}

}  // namespace
}  // namespace gld
