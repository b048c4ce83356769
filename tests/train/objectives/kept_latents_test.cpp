#include "tests/support/temporary_folder.h"
#include "tests/train/small_training.h"
#include "train/objectives/scene_latents.h"

#include <memory>

#include <torch/types.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(KeptLatents, EncodesASceneOnceAndOthersApart) {
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImage);
  const TrainingScene first = data.batch(0).scenes.front(), second = data.batch(1).scenes.front();
  int encoded = 0;
  const auto encode = [&] {
    ++encoded;
    SceneLatents latents;
    latents.shown.source_features = torch::full({1, 2, 3}, 1.0 / 3.0 + encoded);
    latents.clean = torch::full({2, 2, 3}, 2.0);
    return latents;
  };
  KeptLatents kept(1e-3);
  const auto made = kept.get(first, encode), again = kept.get(first, encode);
  EXPECT_EQ(encoded, 1);
  EXPECT_TRUE(torch::equal(made.shown.source_features, again.shown.source_features));
  EXPECT_EQ(made.shown.source_features.scalar_type(), torch::kFloat32);
  EXPECT_FALSE(made.shown.deeper_level.defined());
  kept.get(second, encode);
  EXPECT_EQ(encoded, 2);
  // The same view in another crop is another picture.
  TrainingScene cropped = first;
  for (Camera& camera : cropped.views.cameras) camera.intrinsics(0, 2) -= 7;
  kept.get(cropped, encode);
  EXPECT_EQ(encoded, 3);
  KeptLatents none(1e-9);  // room for a byte: everything is encoded every time
  none.get(first, encode);
  none.get(first, encode);
  EXPECT_EQ(encoded, 5);
}

TEST(KeptLatents, AreTakenFromAFolderForTheSamePictures) {
  const test::TemporaryFolder folder;
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImage);
  TrainingScene scene = data.batch(0).scenes.front();
  int encoded = 0;
  const auto encode = [&] {
    ++encoded;
    SceneLatents latents;
    latents.shown.views = scene.views;
    latents.shown.source_features = torch::full({1, 2, 3}, 1.0 / 3.0 + encoded);
    latents.clean = torch::full({2, 2, 3}, 2.0);
    return latents;
  };
  const auto of_another_run = [&](double gib) {
    KeptLatents kept(gib);
    kept.keep_in(std::make_shared<const KeptFolder>(folder.path(), "test"));
    EXPECT_TRUE(kept.enabled());
    return kept.get(scene, encode);
  };
  // Rounded for memory, and whole without.
  for (const double gib : {0.0, 1e-3}) {
    const int before = encoded;
    const SceneLatents first = of_another_run(gib), again = of_another_run(gib);
    EXPECT_EQ(encoded, before + 1);
    EXPECT_TRUE(torch::equal(again.shown.source_features, first.shown.source_features));
    EXPECT_TRUE(torch::equal(again.clean, first.clean));
    EXPECT_EQ(again.shown.views.size(), scene.views.size());
    const auto whole = torch::full({1, 2, 3}, 1.0 / 3.0 + encoded);
    EXPECT_EQ(torch::equal(first.shown.source_features, whole), gib == 0);
  }
  scene.images = scene.images.clone();  // the same name and cameras, another picture
  scene.images[0][0][0][0] += 0.5;
  of_another_run(0);
  EXPECT_EQ(encoded, 3);
}

}  // namespace
}  // namespace gld
