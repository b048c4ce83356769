#include "bench/splatting/splat_benchmark.h"

#include "bench/splatting/dense_rendering.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "gld/splatting/naive_splatting.h"
#include "tests/gld/splatting/random_gaussians.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

SplatBenchmarkOptions small() {
  SplatBenchmarkOptions options;
  options.views = 6;
  options.threads = 2;
  options.speed.gaussians = 600;
  options.speed.channels = {4, 9};
  options.speed.side = 24;
  options.speed.picture_side = 40;
  options.speed.repeats = 2;
  options.errors.gaussians = {150, 600};
  options.errors.steps = {4, 40};
  options.errors.side = 40;
  options.errors.held_out = 2;
  options.errors.feature_side = 24;
  options.errors.channels = 5;
  options.errors.iterations = {1, 10, 200};
  // Gaussians that overlap as much as these are told apart slowly.
  options.errors.ridge = 0.01;
  options.errors.adam_steps = {30};
  options.errors.adam_rates = {0.05};
  return options;
}

// The rival must compute the same thing, or it is none.
TEST(DenseRendering, IsTheNaiveOneWithItsGradients) {
  RandomGaussians wanted;
  wanted.count = 40;
  const GaussianSet set = random_gaussians(wanted);
  const SplatView view = view_of_splats(set, splat_camera(splat_test_camera(21, 17), set.origin, {}), {});
  std::vector<float> values;
  for (int64_t i = 0; i < 40 * 3; ++i) values.push_back(static_cast<float>(i % 11) / 8 - 0.5F);
  SplatFeatures features;
  features.values = values.data();
  features.channels = 3;
  features.by_index = true;
  NaiveScene scene;
  scene.channels = 3;
  scene.width = 21;
  scene.height = 17;
  for (const VisibleSplat& splat : view.splats) {
    ProjectedGaussian projected;
    project_gaussian(gaussian_shape(set, splat.index), view.camera, projected);
    scene.splats.push_back(naive_splat(projected));
    for (int64_t c = 0; c < 3; ++c)
      scene.features.push_back(values[static_cast<size_t>(3 * splat.index + c)]);
  }
  const NaiveImage expected = render_naively(scene);
  torch::Tensor of_picture = torch::zeros({3, 17, 21});
  std::vector<double> seeds(3 * 17 * 21, 0.0);
  for (size_t i = 0; i < seeds.size(); ++i) {
    if (expected.to_jump[i % (17 * 21)] < 1e-4) continue;
    seeds[i] = std::sin(static_cast<double>(i));
    of_picture.data_ptr<float>()[i] = static_cast<float>(seeds[i]);
  }
  const DenseRendering dense = render_densely(dense_splats(set, view, features), of_picture);
  const NaiveGradients gradients = render_naively_backward(scene, seeds);
  for (size_t i = 0; i < expected.values.size(); ++i) {
    if (expected.to_jump[i % (17 * 21)] < 1e-4) continue;
    EXPECT_NEAR(dense.picture.data_ptr<float>()[i], expected.values[i], 2e-5) << i;
  }
  double largest = 0;
  for (const NaiveSplat& splat : gradients.splats)
    largest = std::max({largest, std::abs(splat.mean[0]), std::abs(splat.mean[1])});
  for (int64_t i = 0; i < view.size(); ++i) {
    const auto at = static_cast<size_t>(i);
    for (int64_t k = 0; k < 2; ++k)
      EXPECT_NEAR(dense.of_places.data_ptr<float>()[2 * i + k], gradients.splats[at].mean[k], 1e-4 * largest);
    // There it is that of the opacity's logarithm.
    EXPECT_NEAR(dense.of_opacities.data_ptr<float>()[i] * scene.splats[at].opacity,
                gradients.splats[at].opacity, 1e-3);
    for (int64_t c = 0; c < 3; ++c)
      EXPECT_NEAR(dense.of_features.data_ptr<float>()[3 * i + c],
                  gradients.features[3 * at + static_cast<size_t>(c)], 1e-3);
  }
}

TEST(SplatBenchmark, WritesSpeedAndErrors) {
  const test::TemporaryFolder folder;
  SplatBenchmarkOptions options = small();
  options.out = (folder.path() / "run").string();
  EXPECT_EQ(run_splat_benchmark(options), 0);
  for (const char* name : {"splat_speed.csv", "splat_fits.csv", "splat_bounds.csv", "splat_features.csv",
                           "splat.md", "splat.png"})
    EXPECT_TRUE(std::filesystem::exists(folder.path() / "run" / name)) << name;
  const auto report = nlohmann::json::parse(read_file(folder.path() / "run" / "report.json"));
  EXPECT_TRUE(report.contains("measured_with"));
}

TEST(SplatBenchmark, RowsSayWhatIsTrue) {
  const SplatBenchmarkOptions options = small();
  SyntheticOptions rooms;
  rooms.frames = options.views;
  rooms.width = rooms.height = 40;
  const Scene scene = make_synthetic_scene(rooms, 0);
  const auto speeds = splat_speed_rows(scene, options.speed);
  ASSERT_EQ(speeds.size(), 9U);
  for (const SplatSpeedRow& row : speeds) {
    EXPECT_GT(row.seen, 100);
    EXPECT_LE(row.milliseconds_low, row.milliseconds);
    EXPECT_EQ(row.times > 0, row.pass != "lists" && row.pass != "backward_features") << row.pass;
    const bool compared = row.pass == "forward" || row.pass == "backward";
    EXPECT_EQ(row.error > 0, compared) << row.pass;
    // A pixel where float32 takes the other side of a jump is off by 1/255 of one Gaussian.
    EXPECT_LT(row.error, 1e-4);
    EXPECT_LT(row.dense_error, 1e-4);
  }
  const auto fits = splat_fit_rows(scene, options.errors);
  ASSERT_EQ(fits.size(), 4U);
  EXPECT_LE(fits[0].gaussians, 150);
  for (const size_t first : {size_t{0}, size_t{2}}) {
    EXPECT_GT(fits[first + 1].fitted_psnr, fits[first].fitted_psnr);
    EXPECT_GT(fits[first + 1].seconds, fits[first].seconds);
  }
  // The looser a bound, the larger its error; as tight as it can be, there is none but of the other bound.
  const auto bounds = splat_bound_rows(scene, options.errors);
  ASSERT_EQ(bounds.size(), 7U);
  for (const size_t i : {size_t{1}, size_t{2}, size_t{3}}) EXPECT_GT(bounds[i].error, bounds[i - 1].error);
  EXPECT_LT(bounds[4].error, bounds[5].error);
  EXPECT_LT(bounds[5].error, bounds[6].error);
  EXPECT_NEAR(bounds[4].error, bounds[1].error, 0.01 * bounds[1].error);
  EXPECT_GT(bounds[6].error, 1e-3);
  const auto features = splat_feature_rows(scene, options.errors);
  ASSERT_EQ(features.size(), 4U);
  // Conjugate gradients never go away from the optimum; they end at it.
  EXPECT_LT(features[1].error, features[0].error);
  EXPECT_LT(features[2].error, 1e-4);
  EXPECT_LE(features[2].residual, 1e-6);
  EXPECT_EQ(features[3].method, "adam_0.05");
  EXPECT_LT(features[3].error, 1);
  EXPECT_GT(features[3].error, features[2].error);
}

TEST(SplatBenchmark, RefusesWhatItCannotCompare) {
  SplatBenchmarkOptions options = small();
  options.out = "runs/bench";
  options.errors.held_out = 6;
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "--held-out: expected less than the room's 6 views, found 6; keep fewer of them apart.");
  options.errors.held_out = 1;
  options.errors.steps = {3, 2};
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "--fit-steps: expected rising numbers, found others; sort them.");
}

}  // namespace
}  // namespace gld
