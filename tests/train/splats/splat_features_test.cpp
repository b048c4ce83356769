#include "train/splats/splat_features.h"

#include "datasets/formats/scene_writer.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "gld/base/sha256.h"
#include "gld/splatting/splat_ply.h"
#include "gld/tensors/weight_tensors.h"
#include "models/splats/latent_fit.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

using test::error_of;

TEST(SplatFeatures, AreSolvedForAndSavedBesideTheGaussians) {
  const test::TemporaryFolder folder;
  SyntheticOptions rooms;
  rooms.frames = 8;
  rooms.width = rooms.height = 112;
  write_scene(make_synthetic_scene(rooms, 0), "cameras-json", folder.path() / "scene");
  SplatCommandOptions options;
  options.scene = (folder.path() / "scene").string();
  options.out = (folder.path() / "run").string();
  options.held_out = 2;
  options.fit.steps = 10;
  options.fit.density.most_gaussians = 4000;
  options.threads = 1;
  options.model = (test::source_root() / "configs" / "tiny").string();
  options.features = {"1", "7"};
  EXPECT_EQ(error_of([&] { run_splat_fit_with_features(options); }),
            "--features: expected levels 0 to 3 of GLD tiny, or all, found '7'; choose among them.");
  EXPECT_FALSE(std::filesystem::exists(options.out));
  options.features = {"1"};
  run_splat_fit_with_features(options);
  const std::filesystem::path out = options.out;
  const auto report = nlohmann::json::parse(read_file(out / "report.json")).at("features").at(0);
  EXPECT_EQ(report.at("level"), 1);
  EXPECT_LE(report.at("residual").get<double>(), options.solve.tolerance);
  // 6 x 64 pixels of 4,000 Gaussians could be shown nearly as they are, but for the ridge; what no feature was fitted
  // to is shown better than by the channels' means.
  EXPECT_LT(report.at("fitted_error").get<double>(), 0.5);
  EXPECT_LT(report.at("held_out_error").get<double>(), 1);
  EXPECT_GT(report.at("held_out_error").get<double>(), report.at("fitted_error").get<double>());
  const auto file = WeightFile::open(out / kSplatFeaturesFile);
  const auto features = read_tensor(*file, "level1.features");
  EXPECT_EQ(features.size(0), read_splat_ply(out / kSplatFile).size());
  EXPECT_EQ(features.size(1), 256);
  EXPECT_EQ(file->metadata().at("gld:splats"), sha256_of_file(out / kSplatFile));
  // The same once more.
  options.out = (folder.path() / "again").string();
  run_splat_fit_with_features(options);
  EXPECT_EQ(read_file(out / kSplatFeaturesFile),
            read_file(std::filesystem::path(options.out) / kSplatFeaturesFile));
}

// Returns the means of the Gaussians that a fit of so many steps leaves.
std::vector<float> fitted_means(SplatCommandOptions options, SplatGeometryFrom from, int64_t steps,
                                const std::filesystem::path& out) {
  options.fit.geometry_from = from;
  options.fit.steps = steps;
  options.out = out.string();
  run_splat_fit_with_features(options);
  return read_splat_ply(out / kSplatFile).means;
}

TEST(SplatFeatures, MoveGeometryWhereTheyAreToldTo) {
  const test::TemporaryFolder folder;
  SyntheticOptions rooms;
  rooms.frames = 5;
  rooms.width = rooms.height = 112;
  write_scene(make_synthetic_scene(rooms, 0), "cameras-json", folder.path() / "scene");
  SplatCommandOptions options;
  options.scene = (folder.path() / "scene").string();
  options.held_out = 1;
  options.fit.density.most_gaussians = 2000;
  options.threads = 1;
  options.model = (test::source_root() / "configs" / "tiny").string();
  options.features = {"1"};
  const auto out = [&](const char* name) { return folder.path() / name; };
  const auto start = fitted_means(options, SplatGeometryFrom::kRgb, 0, out("start"));
  EXPECT_EQ(fitted_means(options, SplatGeometryFrom::kFixed, 40, out("fixed")), start);
  const auto by_rgb = fitted_means(options, SplatGeometryFrom::kRgb, 40, out("rgb")),
             by_latents = fitted_means(options, SplatGeometryFrom::kLatent, 40, out("latent")),
             by_both = fitted_means(options, SplatGeometryFrom::kBoth, 40, out("both"));
  EXPECT_NE(by_rgb, start);
  EXPECT_NE(by_latents, start);
  EXPECT_NE(by_latents, by_rgb);
  EXPECT_NE(by_both, by_rgb);
  EXPECT_NE(by_both, by_latents);
  const auto error = [&](const char* name) {
    return nlohmann::json::parse(read_file(out(name) / "report.json"))
        .at("features")
        .at(0)
        .at("fitted_error")
        .get<double>();
  };
  // Geometry that latents move shows them better than one that stands still.
  EXPECT_LT(error("latent"), error("fixed"));
  EXPECT_LT(error("both"), error("fixed"));

  options.features = {"none"};
  options.fit.geometry_from = SplatGeometryFrom::kBoth;
  options.out = out("never").string();
  EXPECT_EQ(
      error_of([&] { run_splat_fit_with_features(options); }),
      "--geometry-from: expected rgb or fixed where no latents are fitted, found both; name levels of a latent "
      "space (gld splat fit --features), or leave it out.");
  options.features = {"1"};
  options.fit.geometry_from = SplatGeometryFrom::kLatent;
  options.fit.density.densify = Densification::kPublished;
  EXPECT_EQ(
      error_of([&] { run_splat_fit_with_features(options); }),
      "--densify: expected none where colours do not move the geometry, by whose gradient Gaussians are added, "
      "found published; leave it out, or add --geometry-from both.");
}

}  // namespace
}  // namespace gld
