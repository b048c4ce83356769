#include "tests/support/data_folders.h"
#include "verify/reference_runners.h"
#include "verify/verification.h"

#include <algorithm>

#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(ReferenceTraining, LossesGradientsStepsAndAverageMatchThePublishedCode) {
  const auto result =
      verify_case(test::test_data() / "reference_cases" / "train_diffusion", reference_runners());
  EXPECT_TRUE(result.passed()) << case_text(result);
  EXPECT_EQ(result.tensors.size(), 45U);
}

// What runs in float32 whatever was asked for is held to float32's tolerance; what does not has its own.
TEST(ReferenceTraining, OnlyWhatComputesInAPrecisionIsForgivenIt) {
  const auto tolerance = [](const char* name, ComputePrecision precision) {
    const auto result = verify_case(test::test_data() / "reference_cases" / name, reference_runners(),
                                    {precision, torch::kCPU});
    EXPECT_TRUE(result.passed()) << case_text(result);
    double largest = 0;
    for (const auto& row : result.tensors) largest = std::max(largest, row.tolerance);
    return largest;
  };
  for (const ComputePrecision precision : {ComputePrecision::kBFloat16, ComputePrecision::kInt8}) {
    for (const char* name : {"camera", "dpt_head_da3", "vae_taef2", "train_diffusion"}) {
      EXPECT_EQ(tolerance(name, precision), tolerance(name, ComputePrecision::kFloat32)) << name;
    }
    EXPECT_GT(tolerance("dit_level1", precision), 100 * tolerance("dit_level1", ComputePrecision::kFloat32));
  }
}

TEST(ReferenceTraining, EveryKindOfCaseHasARunner) {
  const auto runners = reference_runners();
  for (const char* kind :
       {"backbone", "dpt_head", "rgb_decoder", "lpips", "metrics_image_depth", "camera_conditioning", "dit",
        "sample", "pipeline", "train_diffusion", "splat_projection", "splat_compositing", "refiner"}) {
    EXPECT_EQ(runners.count(kind), 1U) << kind;
  }
}

}  // namespace
}  // namespace gld
