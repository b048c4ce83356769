#include "models/splats/splatted_scene.h"

#include "gld/tensors/weight_tensors.h"
#include "models/refiner/latent_refining.h"
#include "models/splats/splat_refiner.h"
#include "tests/models/splats/small_autoencoder.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <map>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::TemporaryFolder;
using testing::HasSubstr;

class SplattedScenes : public testing::Test {
 protected:
  SplattedScenes()
      : bundle_(test::write_small_autoencoder(folder_.path() / "bundle", true)),
        file_(folder_.path() / "scene.safetensors") {
    save_splatted_scene(file_, test::half_splatted_scene(bundle_, 1));
  }
  // Returns what reading says of the file with these tensors and notes in the place of its own.
  std::string error_with(const std::string& name, const torch::Tensor& tensor) {
    auto tensors = read_all(file_);
    tensors[name] = tensor;
    auto metadata = WeightFile::open(file_)->metadata();
    const auto other = folder_.path() / "other.safetensors";
    save_safetensors(other, tensors, metadata);
    return error_of([&] { read_splatted_scene(other); });
  }
  TemporaryFolder folder_;
  ModelBundle bundle_;
  std::filesystem::path file_;
};

TEST_F(SplattedScenes, AreReadAsTheyWereWritten) {
  const SplattedScene written = test::half_splatted_scene(bundle_, 1), read = read_splatted_scene(file_);
  EXPECT_EQ(read.name, written.name);
  EXPECT_EQ(read.fitted, 4);
  EXPECT_EQ(read.held_out(), 2);
  EXPECT_EQ(read.tag.backbone_hash, written.tag.backbone_hash);
  EXPECT_TRUE(read.pictures.equal(written.pictures));
  EXPECT_TRUE(read.encoded.equal(written.encoded.to(torch::kFloat16)));
  EXPECT_TRUE(read.splatted.equal(written.splatted.to(torch::kFloat16)));
  EXPECT_TRUE(read.degraded(DegradedLatents::kSplatted).equal(read.splatted));
  EXPECT_TRUE(read.degraded(DegradedLatents::kColours).equal(written.colours.to(torch::kFloat16)));
  for (size_t view = 0; view < 6; ++view) {
    EXPECT_EQ(read.cameras[view].intrinsics, written.cameras[view].intrinsics);
    EXPECT_EQ(read.cameras[view].world_from_camera.matrix(),
              written.cameras[view].world_from_camera.matrix());
    EXPECT_EQ(read.cameras[view].width, 32);
  }
  EXPECT_EQ(splatted_scene_files(folder_.path()).size(), 1U);
}

TEST_F(SplattedScenes, SayWhatIsWrongWithThem) {
  const std::string made = "; make it again with gld splat pairs.";
  const auto scene = test::half_splatted_scene(bundle_, 1);
  EXPECT_THAT(
      error_with("splatted", scene.splatted),
      HasSubstr("expected splatted of 4 dimensions and type Half, found shape [2, 4, 4, 4], Float" + made));
  EXPECT_THAT(
      error_with("encoded", scene.encoded.slice(0, 1).to(torch::kFloat16)),
      HasSubstr("expected encoded latents of 6 views, 4 channels and 4x4 pixels, found [5, 4, 4, 4]" + made));
  EXPECT_THAT(error_with("encoded", (scene.encoded / 0).to(torch::kFloat16)),
              HasSubstr("expected finite latents, found NaN or infinity" + made));
  EXPECT_THAT(error_with("colours", (scene.colours / 0).to(torch::kFloat16)),
              HasSubstr("expected finite latents, found NaN or infinity" + made));
  EXPECT_THAT(
      error_with("colours", scene.colours.slice(0, 1).to(torch::kFloat16)),
      HasSubstr("expected colours of the shape of splatted latents, [2, 4, 4, 4], found [1, 4, 4, 4]" +
                made));
  EXPECT_THAT(error_with("intrinsics", torch::zeros({5, 3, 3}, torch::kFloat64)),
              HasSubstr("expected intrinsics of 6 views, found [5, 3, 3]" + made));
  EXPECT_THAT(
      error_with("splatted", scene.splatted.slice(0, 1).to(torch::kFloat16)),
      HasSubstr("expected 5 fitted views, those that are not splatted, found 4 in gld:fitted" + made));
  EXPECT_THAT(error_with("intrinsics", torch::zeros({6, 3, 3}, torch::kFloat64)), HasSubstr("view 0"));
  const auto empty = folder_.path() / "empty";
  std::filesystem::create_directory(empty);
  EXPECT_EQ(
      error_of([&] { splatted_scene_files(empty); }),
      empty.string() +
          ": expected splatted scenes, files *.safetensors, found none; make them with gld splat pairs, and name "
          "its folder pairs/.");
}

TEST_F(SplattedScenes, BelongToOneAutoencoder) {
  const LatentTag tag = read_splatted_scene(file_).tag;
  EXPECT_NO_THROW(require_same_latent_space(tag, bundle_, "here"));
  write_random_bundle(folder_.path() / "another", test::small_autoencoder_model(), 6);
  const auto another = ModelBundle::open(folder_.path() / "another");
  EXPECT_THAT(error_of([&] { require_same_latent_space(tag, another, "here"); }),
              HasSubstr("here: expected latents of the backbone of " + another.folder().string()));
  EXPECT_NO_THROW(require_same_normalisation(tag, bundle_, "here"));
  save_bundle_part(bundle_.folder(), BundlePart::statistics(0),
                   statistics_tensors({torch::zeros(4), torch::full({4}, 2.0F)}));
  EXPECT_THAT(error_of([&] { require_same_normalisation(tag, bundle_, "here"); }),
              HasSubstr("here: expected latents normalised by"));
}

TEST_F(SplattedScenes, AreRepairedBesideAsManyViewsAsThereAre) {
  const auto scene = read_splatted_scene(file_);
  const auto unet = bundle_.load_refiner();
  const auto encoded = scene.encoded.to(torch::kFloat32);
  const auto degraded = scene.splatted[0].to(torch::kFloat32);
  const auto refined = [&](int64_t views) {
    return LatentRefining(*unet, {scene.cameras.begin(), scene.cameras.begin() + views},
                          encoded.slice(0, 0, views))(scene.cameras[4], degraded);
  };
  // Of a grid two references leave a cell empty: one is taken.
  EXPECT_EQ(references_taken(unet->options(), 2), 1);
  EXPECT_EQ(references_taken(unet->options(), 9), 3);
  EXPECT_FALSE(refined(1).equal(degraded));
  // View 3 is the nearest to the one held out at 4, then 2 and 1.
  const auto by_hand =
      refined_latents(*unet, torch::stack({degraded, encoded[3], encoded[2], encoded[1]}).unsqueeze(0))[0];
  EXPECT_LT((refined(4) - by_hand).abs().max().item<double>(), 1e-4);
  EXPECT_TRUE(has_splat_refiner(bundle_));
  std::filesystem::remove(bundle_.file(BundlePart::refiner()));
  EXPECT_FALSE(has_splat_refiner(bundle_));
}

TEST_F(SplattedScenes, AreNotRepairedWhereTheyDoNotFitIntoMemory) {
  const auto scene = read_splatted_scene(file_);
  const auto unet = bundle_.load_refiner();
  const int64_t side = int64_t{1} << 18;
  // Views of that size that take no memory themselves.
  const auto huge = torch::zeros({1, 1, 1, 1}).expand({4, scene.encoded.size(1), side, side});
  const auto said = error_of([&] {
    LatentRefining(*unet, {scene.cameras.begin(), scene.cameras.begin() + 4}, huge);
  });
  EXPECT_THAT(said, HasSubstr("refining latents: expected at most "));
  EXPECT_THAT(said,
              HasSubstr(" for 4 views of 262144x262144 latent pixels by the forecast; take smaller views."));
}

}  // namespace
}  // namespace gld
