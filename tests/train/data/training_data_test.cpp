#include "train/data/training_data.h"

#include "datasets/formats/scene_writer.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "tests/support/temporary_folder.h"

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

}  // namespace
}  // namespace gld
