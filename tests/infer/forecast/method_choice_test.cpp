// Which method and precision options end in, beside a table of measured errors.
#include "infer/forecast/method_choice.h"

#include "gld/base/atomic_file.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/data_folders.h"
#include "tests/support/temporary_folder.h"

#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

const std::string kHash = "of these weights";

// Options ask for the default method; the table has it in every precision, int8 above its limit for automatic.
class MethodChoice : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = std::make_unique<test::TemporaryFolder>();
    write_random_bundle(folder_->path(), small_bundle_options(), 1);
    PlanErrors table;
    table.model_hash = kHash;
    table.scenes = 4;
    table.grid = {2, 4, 4};
    const std::vector<std::pair<ComputePrecision, double>> of_precisions{{ComputePrecision::kFloat32, 0},
                                                                         {ComputePrecision::kBFloat16, 0.019},
                                                                         {ComputePrecision::kInt8, 0.041}};
    for (const auto& [precision, error] : of_precisions) {
      SamplingMethod method = SampleOptions().method();
      method.precision = precision;
      method.name = compute_precision_name(precision);
      table.methods.push_back({method, 0.005 + error, 0.01 + error, 0.02 + error, error, 0});
    }
    write_file_atomically(folder_->path() / kPlanErrorsFile, plan_errors_json(table).dump());
  }
  static void TearDownTestSuite() { folder_.reset(); }

  static ChosenMethod chosen(PrecisionChoice precision, const std::string& device) {
    SampleOptions options;
    options.precision = precision;
    options.device = device;
    PlanRequest request;
    request.grid = {2, 4, 4};
    MachineSpeed speed;
    speed.multiply_add_peak = speed.matrix_product = speed.linear = speed.attention = speed.loading = 1e11;
    speed.bfloat16_linear = speed.bfloat16_attention = 2;
    speed.int8_linear = 4;
    return choose_method(options, ModelBundle::open(folder_->path()), request, speed, [] { return kHash; });
  }

  static std::unique_ptr<test::TemporaryFolder> folder_;
};
std::unique_ptr<test::TemporaryFolder> MethodChoice::folder_;

TEST_F(MethodChoice, AutomaticTakesNoPrecisionAboveItsLimit) {
  const ChosenMethod choice = chosen(PrecisionChoice::kAutomatic, "cpu");
  // Where the processor has a unit for it, bfloat16, though int8 would be faster.
  EXPECT_EQ(choice.method.precision, has_matrix_unit(ComputePrecision::kBFloat16)
                                         ? ComputePrecision::kBFloat16
                                         : ComputePrecision::kFloat32);
  EXPECT_TRUE(choice.errors.has_value());
}

TEST_F(MethodChoice, APrecisionThatIsNamedIsTakenWithItsError) {
  const ChosenMethod choice = chosen(PrecisionChoice::kInt8, "cpu");
  EXPECT_EQ(choice.method.precision, ComputePrecision::kInt8);
  ASSERT_TRUE(choice.errors.has_value());
  EXPECT_EQ(choice.errors->of_precision, 0.041);
  EXPECT_THAT(choice_text(choice), testing::HasSubstr("int8 on "));
}

TEST_F(MethodChoice, ErrorsOfTheCpusPrecisionsSayNothingOfAGpu) {
  EXPECT_TRUE(chosen(PrecisionChoice::kBFloat16, "cpu").errors.has_value());
  const ChosenMethod choice = chosen(PrecisionChoice::kBFloat16, "cuda:0");
  EXPECT_EQ(choice.method.precision, ComputePrecision::kBFloat16);
  EXPECT_FALSE(choice.errors.has_value());
  EXPECT_THAT(choice_text(choice), testing::HasSubstr("bfloat16 on cuda:0"));
  EXPECT_THAT(choice_text(choice), testing::HasSubstr("its error was not measured"));
  EXPECT_EQ(chosen(PrecisionChoice::kAutomatic, "cuda:0").method.precision, ComputePrecision::kFloat32);
  EXPECT_TRUE(chosen(PrecisionChoice::kFloat32, "cuda:0").errors.has_value());
}

// A table of other weights is refused by --tolerance and tells runs nothing: whoever changes configs/tiny measures
// anew, by `gld bench sample --model configs/tiny --synthetic 16 --precisions bfloat16,int8 --write-table --out RUN`.
TEST(ShippedModel, HasErrorsThatWereMeasuredWithItsWeights) {
  const std::filesystem::path shipped = test::source_root() / "configs/tiny";
  EXPECT_EQ(read_plan_errors(shipped / kPlanErrorsFile).model_hash,
            ModelBundle::open(shipped).content_hash());
}

}  // namespace
}  // namespace gld
