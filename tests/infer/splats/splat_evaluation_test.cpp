#include "infer/splats/splat_evaluation.h"

#include "gld/base/atomic_file.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>
#include <filesystem>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

using test::error_of;

TEST(SplatEvaluation, MeasuresColoursAndDecodedLatentsOfHeldOutViews) {
  const test::TemporaryFolder folder;
  SplatEvaluationOptions options;
  options.model = (test::source_root() / "configs" / "tiny").string();
  options.synthetic = 2;
  options.generator.frames = 10;
  options.generator.width = options.generator.height = 112;
  options.side = 112;
  options.held_out = 2;
  options.fit.steps = 30;
  options.fit.density.most_gaussians = 6000;
  options.threads = 1;
  const auto means_of = [&](const char* name, int64_t input_views) {
    options.out = (folder.path() / name).string();
    options.input_views = input_views;
    testing::internal::CaptureStdout();
    run_splat_evaluation(options);
    testing::internal::GetCapturedStdout();
    const auto report = nlohmann::json::parse(read_file(std::filesystem::path(options.out) / "report.json"));
    EXPECT_EQ(report.at("scenes"), 2);
    return report.at("means");
  };
  const auto mean = [](const nlohmann::json& means, const char* column) {
    return means.at(column).at("mean").get<double>();
  };
  options.consistency_model = options.model;
  const auto all = means_of("all", 0);
  options.consistency_model.clear();
  const auto two = means_of("two", 2);
  // The colours of eight views show the others better than a view beside them does, and than those of two.
  EXPECT_GT(mean(all, "rgb_psnr"), mean(all, "nearest_psnr"));
  EXPECT_GT(mean(all, "rgb_psnr"), mean(two, "rgb_psnr"));
  EXPECT_GT(mean(all, "nearest_psnr"), mean(two, "nearest_psnr"));
  // True depth carries views to where they belong, which shows more than leaving them where they are.
  EXPECT_GT(mean(all, "carried_psnr"), mean(all, "nearest_psnr") + 3);
  EXPECT_GT(mean(all, "carried_psnr"), mean(two, "carried_psnr"));
  EXPECT_LT(mean(all, "encoded_carried_error"), mean(all, "latent_error"));
  // What splatting leaves of latents is decoded to less than the latents themselves.
  EXPECT_LT(mean(all, "decoded_psnr"), mean(all, "autoencoded_psnr"));
  EXPECT_LT(mean(all, "decoded_ssim"), mean(all, "autoencoded_ssim"));
  EXPECT_GT(mean(all, "latent_error"), 0);
  // Colours that are encoded lose what the model's decoder does, and less than latents that were splatted.
  EXPECT_LT(mean(all, "encoded_colours_psnr"), mean(all, "autoencoded_psnr") + 0.1);
  EXPECT_GT(mean(all, "encoded_colours_error"), 0);
  EXPECT_LT(mean(all, "encoded_colours_error"), mean(all, "latent_error"));
  // One place has other features in two true views too, since views see it from elsewhere; what Gaussians show of it
  // is further from the truth's.
  EXPECT_GT(mean(all, "true_met3r_like"), 0);
  EXPECT_GT(mean(all, "decoded_met3r_like"), mean(all, "true_met3r_like"));
  EXPECT_GT(mean(all, "decoded_met3r_like"), mean(all, "autoencoded_met3r_like"));
  EXPECT_LT(mean(all, "rgb_random_features"), mean(all, "nearest_random_features"));
  EXPECT_LT(mean(all, "autoencoded_random_features"), mean(all, "decoded_random_features"));
  EXPECT_FALSE(all.contains("refined_met3r_like"));
  EXPECT_FALSE(two.contains("true_met3r_like"));
  const std::string rows = read_file(folder.path() / "all" / "eval.csv");
  EXPECT_EQ(std::count(rows.begin(), rows.end(), '\n'), 3);
  EXPECT_EQ(
      rows.rfind("scene,gaussians,rgb_psnr,decoded_psnr,encoded_colours_psnr,autoencoded_psnr,carried_psnr,"
                 "encoded_carried_psnr,nearest_psnr,",
                 0),
      0U);
  int pictures = 0;
  for (const auto& item : std::filesystem::directory_iterator(folder.path() / "all" / "pictures"))
    pictures += item.path().extension() == ".png" ? 1 : 0;
  EXPECT_EQ(pictures, 2);

  // A scene without depth.
  options.out = (folder.path() / "without").string();
  options.consistency_model = options.model;
  options.scenes = {(test::source_root() / "tests/data/scenes/gld_layout_5e040cd0758dcc96").string()};
  EXPECT_THAT(
      error_of([&] { run_splat_evaluation(options); }),
      testing::MatchesRegex("--consistency-model: expected scenes with depth in every view, found none in "
                            "view .* of .*; leave it out, or measure scenes with depth."));
  options.consistency_model.clear();
  options.scenes.clear();
  options.synthetic = 0;
  EXPECT_EQ(error_of([&] { run_splat_evaluation(options); }),
            "scenes: expected --scenes DIR or --synthetic N, found neither; give one of them.");
}

}  // namespace
}  // namespace gld
