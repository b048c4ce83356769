// The whole scenes of the shared data; tests/data/scenes holds pieces of them.
#include "tests/support/data_folders.h"
#include "tests/support/real_scenes.h"

#include <gtest/gtest.h>

namespace gld::test {
namespace {

TEST(SharedScenes, Re10kTextEqualsTheNpzPosesOfTheSameClip) {
  expect_re10k_text_equals_npz(shared_data() / "scenes");
}

TEST(SharedScenes, TartanAirDepthWarpsBetweenViews) {
  expect_tartanair_depth_agrees(shared_data() / "scenes" / "tartanair_hospital", 8);
}

TEST(SharedScenes, ColmapTextEqualsBinary) {
  expect_colmap_text_equals_binary(shared_data() / "scenes", {12, 11384});
}

TEST(SharedScenes, ColmapPointsProjectIntoTheirImages) {
  const Scene scene =
      expect_colmap_points_inside(shared_data() / "scenes" / "colmap_lund_door", {12, 11384}, 5001);
  EXPECT_EQ(scene.frames[9].name, "DSC_0010");
  EXPECT_EQ(scene.frames[9].camera.width, 1296);
}

TEST(SharedScenes, HaveNoMistakes) { expect_no_mistakes(shared_data() / "scenes"); }

}  // namespace
}  // namespace gld::test
