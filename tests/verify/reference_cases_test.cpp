#include "tests/support/data_folders.h"
#include "verify/reference_runners.h"
#include "verify/verification.h"

#include <string>

#include <gtest/gtest.h>

namespace gld {
namespace {

class ReferenceCases : public testing::TestWithParam<std::string> {};

TEST_P(ReferenceCases, EveryTensorIsWithinItsTolerance) {
  const auto result = verify_case(test::test_data() / "reference_cases" / GetParam(), reference_runners());
  EXPECT_TRUE(result.passed()) << case_text(result);
  EXPECT_FALSE(result.tensors.empty());
}

INSTANTIATE_TEST_SUITE_P(Modules, ReferenceCases,
                         testing::Values("backbone_da3", "dpt_head_da3", "rgb_decoder", "lpips_squeeze",
                                         "metrics_image_depth", "metrics_trajectory"));

INSTANTIATE_TEST_SUITE_P(OtherLatents, ReferenceCases,
                         testing::Values("backbone_vggt", "dpt_head_vggt", "point_head_vggt",
                                         "camera_head_vggt", "rgb_decoder_vggt", "dpt_head_da3_replaced",
                                         "backbone_dinov2", "vae_sd", "vae_sdxl", "vae_taef2"));

INSTANTIATE_TEST_SUITE_P(Cameras, ReferenceCases, testing::Values("known_cameras_da3", "camera_decoder_da3"));

INSTANTIATE_TEST_SUITE_P(Diffusion, ReferenceCases,
                         testing::Values("camera", "dit_level1", "dit_cascade", "dit_cascade_split",
                                         "dit_options", "dit_true_inverse", "dit_special_level1",
                                         "dit_special_cascade", "sample_level1", "pipeline"));

INSTANTIATE_TEST_SUITE_P(Splatting, ReferenceCases,
                         testing::Values("splat_projection", "splat_projection_antialias", "splat_colours",
                                         "splat_compositing", "splat_picture"));

INSTANTIATE_TEST_SUITE_P(Refiner, ReferenceCases,
                         testing::Values("refiner_grid", "refiner_self", "refiner_cross"));

}  // namespace
}  // namespace gld
