#include "train/data/training_data.h"

#include "datasets/formats/scene_writer.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/small_training.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

// What is validated is cut as what is trained on.
TEST(TrainingData, ValidationScenesAreCutAboutThePointOfTheTraining) {
  SyntheticOptions synthetic;
  synthetic.seed = 3;
  synthetic.frames = 4;
  synthetic.width = 112;
  synthetic.height = 56;
  Scene scene = make_synthetic_scene(synthetic, 0);
  for (Frame& frame : scene.frames) frame.camera.intrinsics(0, 2) += 14;
  const test::TemporaryFolder folder;
  write_scene(scene, "cameras-json", folder.path() / "scene");
  TrainingDataOptions options;
  options.validation_folder = folder.path().string();
  options.validation_scenes = 1;
  options.views.views = 2;
  options.views.fewest_sources = options.views.most_sources = 1;
  options.views.longest_interval = 2;
  for (const CropCentre centre : {CropCentre::kImage, CropCentre::kPrincipalPoint}) {
    options.loading.crop_centre = centre;
    const auto scenes = validation_scenes(options, {56, 56}, FrameParts::kImage);
    ASSERT_EQ(scenes.size(), 1U);
    for (const Camera& camera : scenes.front().views.cameras) {
      EXPECT_NEAR(camera.intrinsics(0, 2), centre == CropCentre::kImage ? 42 : 28, 1e-6);
    }
  }
}

TEST(DistinctBatches, ComeAgain) {
  auto options = test::small_data();
  options.distinct_batches = 2;
  const DatasetBatches data(options, {{56, 56}}, FrameParts::kImage);
  const DatasetBatches endless(test::small_data(), {{56, 56}}, FrameParts::kImage);
  for (const int64_t index : {0, 1, 2, 5}) {
    const auto batch = data.batch(index);
    EXPECT_EQ(batch.index, index);
    const auto expected = endless.batch(index % 2);
    ASSERT_EQ(batch.scenes.size(), expected.scenes.size());
    EXPECT_TRUE(torch::equal(batch.scenes.front().images, expected.scenes.front().images));
  }
}

}  // namespace
}  // namespace gld
