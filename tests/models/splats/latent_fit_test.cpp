#include "models/splats/latent_fit.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/sha256.h"
#include "gld/cameras/resized_camera.h"
#include "gld/latents/latent_tokens.h"
#include "gld/tensors/weight_tensors.h"
#include "models/bundle/random_bundle.h"
#include "tests/gld/splatting/random_gaussians.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <ATen/CPUGeneratorImpl.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;

torch::Tensor random_pictures(int64_t views, int64_t side) {
  return torch::rand({views, 3, side, side}, at::detail::createCPUGenerator(3));
}

TEST(LatentPictures, AreTheNormalisedTokensOfALevel) {
  const ModelBundle bundle = ModelBundle::open(test::source_root() / "configs" / "tiny");
  const auto images = random_pictures(2, 112);
  const auto levels = LatentEncoding(bundle)(images, {0, 3});
  ASSERT_EQ(levels.size(), 2U);
  const auto backbone = bundle.load_backbone();
  const at::NoGradGuard no_grad;
  const auto encoded = backbone->encode(images, 3);
  for (size_t i = 0; i < 2; ++i) {
    const LatentPictures& latents = levels[i];
    EXPECT_EQ(latents.tag.level, i == 0 ? 0 : 3);
    EXPECT_EQ(latents.tag.channels, 256);
    EXPECT_EQ(latents.tag.width, 8);
    EXPECT_EQ(latents.tag.backbone_hash, sha256_of_file(bundle.file(BundlePart::backbone())));
    // The bundle has statistics of what it generates.
    EXPECT_EQ(latents.tag.statistics, i == 0 ? "of the model" : "of the views");
    const auto tokens = backbone->patches_of(encoded[i == 0 ? 0 : 3])[1];
    const auto raw = latents.raw(latents.pictures[1]).permute({1, 2, 0}).reshape({64, 256});
    // Normalised and back, in float32.
    EXPECT_LT((raw - tokens).abs().max().item<double>(), 1e-5 * tokens.abs().max().item<double>());
  }
  const auto of_views = levels[1].pictures;
  const auto both = torch::stack({tensor_of(of_views[0]), tensor_of(of_views[1])});
  EXPECT_LT(both.mean({0, 2, 3}).abs().max().item<double>(), 1e-4);
  Camera camera = splat_test_camera(112, 112);
  const Camera over = levels[0].camera_of(camera);
  EXPECT_EQ(over.width, 8);
  EXPECT_NEAR(over.intrinsics(0, 2), camera.intrinsics(0, 2) * 8 / 112, 1e-12);
}

TEST(LatentPictures, OfAutoencodersLieOnTheirPixels) {
  const test::TemporaryFolder folder;
  BundleOptions options;
  load_yaml(options, test::source_root() / "configs/ablations/latents/vae/model.yaml");
  write_random_bundle(folder.path() / "vae", options, 5);
  const ModelBundle bundle = ModelBundle::open(folder.path() / "vae");
  EXPECT_EQ(image_size_of_latents(bundle.options(), 8, 6).width, 64);
  EXPECT_EQ(image_size_of_latents(bundle.options(), 8, 6).height, 48);
  EXPECT_EQ(
      error_of([&] { image_size_of_latents(bundle.options(), 8, 7); }),
      "latents of ablation latent vae: expected a side in whole tokens of 2 latent pixels, found 7; choose "
      "another.");
  const auto images = random_pictures(2, 64);
  const auto levels = LatentEncoding(bundle)(images, {0});
  EXPECT_EQ(levels[0].tag.channels, 32);
  EXPECT_EQ(levels[0].tag.width, 8);
  const auto backbone = bundle.load_backbone();
  const at::NoGradGuard no_grad;
  const auto expected = latents_of_tokens(backbone->encode(images, 0)[0], {2, 4, 4}, 2);
  const auto raw = levels[0].raw(levels[0].pictures[0]);
  EXPECT_LT((raw - expected[0]).abs().max().item<double>(), 1e-4 * expected.abs().max().item<double>());
}

TEST(LatentPictures, RefuseLevelsThatAreNot) {
  const ModelBundle bundle = ModelBundle::open(test::source_root() / "configs" / "tiny");
  EXPECT_EQ(latent_levels({"2", "0", "2"}, bundle.options(), "--features"), (std::vector<int64_t>{0, 2}));
  EXPECT_EQ(latent_levels({"all"}, bundle.options(), "--features").size(), 4U);
  EXPECT_EQ(error_of([&] { latent_levels({"4"}, bundle.options(), "--features"); }),
            "--features: expected levels 0 to 3 of GLD tiny, or all, found '4'; choose among them.");
}

// Pictures that Gaussians can make are made; the file says of what.
TEST(LatentFit, FindsAndKeepsFeatures) {
  RandomGaussians wanted;
  wanted.count = 40;
  const GaussianSet set = random_gaussians(wanted);
  StillGaussians gaussians{set, {}, {}, 3};
  for (const double angle : {-0.2, 0.0, 0.2, 0.1}) {
    Camera camera = splat_test_camera(96, 96);
    camera.world_from_camera = Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitY()) * camera.world_from_camera;
    gaussians.cameras.push_back(camera);
  }
  const auto truth = torch::randn({40, 5}, at::detail::createCPUGenerator(8));
  std::vector<torch::Tensor> pictures;
  for (const Camera& camera : gaussians.cameras)
    pictures.push_back(tensor_of(rendered_features(gaussians, truth, resized_camera(camera, 24, 24), {})));
  // Nothing is where no Gaussian is: the mean of normalised latents has to be 0 for that.
  LatentPictures latents = latent_pictures_of(torch::stack(pictures), {});
  latents.statistics.mean.zero_();
  latents.statistics.variance.fill_(1);
  for (size_t i = 0; i < 4; ++i) latents.pictures[i] = splat_image_of(pictures[i]);
  FeatureSolveOptions options;
  options.ridge = 1e-6;
  const LatentFit fit = fit_latents(gaussians, latents, options, {});
  EXPECT_LE(fit.residual, 1e-6);
  EXPECT_LT(latent_error(gaussians, fit, latents, 0, 3, {}), 1e-2);
  EXPECT_LT(latent_error(gaussians, fit, latents, 3, 4, {}), 0.3);

  const test::TemporaryFolder folder;
  write_file_atomically(folder.path() / "splats.ply", "as if it were one");
  save_latent_fits(folder.path() / "features.safetensors", {fit}, folder.path() / "splats.ply",
                   {{"a", "note"}});
  const auto file = WeightFile::open(folder.path() / "features.safetensors");
  EXPECT_TRUE(torch::equal(read_tensor(*file, "level0.features"), fit.features));
  EXPECT_EQ(read_tensor(*file, "level0.deviation").size(0), 5);
  EXPECT_EQ(file->metadata().at("gld:splats"), sha256_of_file(folder.path() / "splats.ply"));
  EXPECT_EQ(file->metadata().at("a"), "note");
  const auto tags = nlohmann::json::parse(file->metadata().at("gld:latent_space"));
  EXPECT_EQ(tags.at("level0").at("width"), 24);
}

// Features that depend on the direction of view are kept with their coefficients, and read back.
TEST(LatentFit, KeepsFeaturesOfADegree) {
  RandomGaussians wanted;
  wanted.count = 40;
  const GaussianSet set = random_gaussians(wanted);
  StillGaussians gaussians{set, {}, {splat_test_camera(96, 96), splat_test_camera(96, 96)}, 2};
  gaussians.cameras[1].world_from_camera.translation().x() += 0.8;
  LatentPictures latents =
      latent_pictures_of(torch::randn({2, 5, 24, 24}, at::detail::createCPUGenerator(8)), {});
  FeatureSolveOptions options;
  options.feature_degree = 1;
  const LatentFit fit = fit_latents(gaussians, latents, options, {});
  EXPECT_EQ(fit.features.sizes(), (std::vector<int64_t>{40, 4, 5}));
  const double error = latent_error(gaussians, fit, latents, 0, 2, {});
  options.feature_degree = 0;
  EXPECT_LT(error, latent_error(gaussians, fit_latents(gaussians, latents, options, {}), latents, 0, 2, {}));

  const test::TemporaryFolder folder;
  const auto ply = folder.path() / "splats.ply", file = folder.path() / "features.safetensors";
  write_file_atomically(ply, "as if it were one");
  save_latent_fits(file, {fit}, ply, {});
  EXPECT_TRUE(torch::equal(read_latent_fits(file, ply).at(0).features, fit.features));
  LatentFit odd = fit;
  odd.features = fit.features.slice(1, 0, 3).contiguous();
  save_latent_fits(file, {odd}, ply, {});
  EXPECT_EQ(
      error_of([&] { read_latent_fits(file, ply); }),
      file.string() +
          ": expected level0.features with 4, 9 or 16 coefficients of spherical harmonics, found 3; make it "
          "again with gld splat fit --features.");
}

}  // namespace
}  // namespace gld
