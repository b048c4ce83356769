#include "cli/verify_command.h"

#include "gld/tensors/torch_version.h"
#include "tests/support/data_folders.h"

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

struct VerifyOutcome {
  int status = 0;
  std::string output;
};

VerifyOutcome run_verify(const std::vector<std::string>& arguments) {
  std::vector<std::string> words = {"verify"};
  words.insert(words.end(), arguments.begin(), arguments.end());
  testing::internal::CaptureStdout();
  VerifyOutcome outcome;
  outcome.status = run_command_line({make_verify_command()}, words);
  outcome.output = testing::internal::GetCapturedStdout();
  return outcome;
}

std::string reference_case(const std::string& name) {
  return (test::test_data() / "reference_cases" / name).string();
}

TEST(VerifyCommand, SucceedsOnlyWhenEveryCasePasses) {
  const auto good = run_verify({reference_case("metrics_image_depth"), reference_case("rgb_decoder")});
  EXPECT_EQ(good.status, 0);
  EXPECT_NE(good.output.find("2 of 2 cases pass in float32, on LibTorch "), std::string::npos) << good.output;
  EXPECT_NE(good.output.find("  pass  psnr "), std::string::npos) << good.output;

  // A folder that is no case fails with its sentence and does not stop the next.
  const auto mixed = run_verify({reference_case("no_such_case"), reference_case("metrics_image_depth")});
  EXPECT_EQ(mixed.status, 1);
  EXPECT_NE(mixed.output.find(
                reference_case("no_such_case") +
                ": expected a folder with a reference case, found no such folder; give the folder that "
                "holds case.json."),
            std::string::npos)
      << mixed.output;
  EXPECT_NE(mixed.output.find("1 of 2 cases pass in float32, on LibTorch "), std::string::npos)
      << mixed.output;
}

TEST(VerifyCommand, PrintsOneJsonObject) {
  const auto outcome = run_verify({reference_case("metrics_image_depth"), "--json"});
  EXPECT_EQ(outcome.status, 0);
  const auto report = nlohmann::json::parse(outcome.output);
  EXPECT_TRUE(report.at("passed").get<bool>());
  EXPECT_EQ(report.at("libtorch"), torch_version());
  EXPECT_EQ(report.at("blas"), blas_name());
  EXPECT_EQ(report.at("precision"), "float32");
  EXPECT_FALSE(report.at("device").get<std::string>().empty());
  const auto& tensors = report.at("cases").at(0).at("tensors");
  ASSERT_EQ(tensors.size(), 5u);
  EXPECT_EQ(tensors[0].at("name"), "abs_rel");
  EXPECT_EQ(tensors[0].at("count"), 4);
  EXPECT_LT(tensors[0].at("max").get<double>(), tensors[0].at("tolerance").get<double>());
}

TEST(VerifyCommand, ComputesOnADeviceThatCan) {
  EXPECT_EQ(run_verify({reference_case("metrics_image_depth"), "--device", "cpu"}).status, 0);
  testing::internal::CaptureStderr();
  EXPECT_EQ(
      run_verify({reference_case("metrics_image_depth"), "--device", "cuda", "--precision", "int8"}).status,
      2);
  EXPECT_EQ(
      testing::internal::GetCapturedStderr(),
      "error: --precision: expected float32 or bfloat16 on the device cuda, found int8; use --device cpu, which has "
      "kernels for it.\n");
}

TEST(VerifyCommand, NeedsAFolder) { EXPECT_EQ(run_verify({}).status, 2); }

}  // namespace
}  // namespace gld
