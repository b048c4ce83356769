#include "cli/reference_training.h"

#include "infer/verify/verification.h"
#include "tests/support/data_folders.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(ReferenceTraining, LossesGradientsStepsAndAverageMatchThePublishedCode) {
  const auto result =
      verify_case(test::test_data() / "reference_cases" / "train_diffusion", all_reference_runners());
  EXPECT_TRUE(result.passed()) << case_text(result);
  EXPECT_EQ(result.tensors.size(), 45U);
}

TEST(ReferenceTraining, EveryKindOfCaseHasARunner) {
  const auto runners = all_reference_runners();
  for (const char* kind : {"backbone", "dpt_head", "rgb_decoder", "lpips", "metrics_image_depth",
                           "camera_conditioning", "dit", "sample", "pipeline", "train_diffusion"}) {
    EXPECT_EQ(runners.count(kind), 1U) << kind;
  }
}

}  // namespace
}  // namespace gld
