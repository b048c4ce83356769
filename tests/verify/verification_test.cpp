#include "verify/verification.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/tensors/torch_version.h"
#include "gld/tensors/weight_tensors.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <cmath>
#include <limits>

#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

// Outputs the inputs, multiplied by config's "factor".
NamedTensors run_scaling_case(const ReferenceCase& reference) {
  NamedTensors outputs;
  for (const auto& [name, tensor] : reference.inputs) {
    outputs[name] = tensor * reference.config.at("factor").get<double>();
  }
  return outputs;
}

class Verification : public testing::Test {
 protected:
  std::filesystem::path write_case(const std::string& name, const std::string& description,
                                   const NamedTensors& inputs, const NamedTensors& outputs) {
    auto directory = folder_.path() / name;
    std::filesystem::create_directories(directory);
    write_file_atomically(directory / "case.json", description);
    save_safetensors(directory / "inputs.safetensors", inputs);
    save_safetensors(directory / "outputs.safetensors", outputs);
    return directory;
  }
  CaseVerification verify(const std::filesystem::path& directory) { return verify_case(directory, runners_); }
  // Returns the error of verifying the folder, with the folder's path written as DIR.
  std::string error(const std::filesystem::path& directory) {
    auto text = verify(directory).error;
    for (auto at = text.find(directory.string()); at != std::string::npos;
         at = text.find(directory.string())) {
      text.replace(at, directory.string().size(), "DIR");
    }
    return text;
  }

  test::TemporaryFolder folder_;
  ReferenceRunners runners_ = {{"scaling", run_scaling_case}};
  const std::string description_ =
      R"({"kind": "scaling", "config": {"factor": 2}, "relative_tolerance": 1e-3, "note": "n"})";
};

TEST(CompareTensor, ToleranceIsRelativeToTheLargestReferenceOrToOne) {
  const auto small = compare_tensor("t", torch::tensor({0.1f, 0.2009f}), torch::tensor({0.1f, 0.2f}), 1e-3);
  EXPECT_TRUE(small.passed);
  EXPECT_EQ(small.tolerance, 1e-3);
  EXPECT_EQ(small.count, 2);
  EXPECT_NEAR(small.max_difference, 9e-4, 1e-7);
  EXPECT_NEAR(small.mean_difference, 4.5e-4, 1e-7);
  EXPECT_EQ(small.worst_index, (std::vector<int64_t>{1}));
  EXPECT_FALSE(compare_tensor("t", torch::tensor({0.2011f}), torch::tensor({0.2f}), 1e-3).passed);
  const auto large =
      compare_tensor("t", torch::tensor({{-200.0f, 0.15f}}), torch::tensor({{-200.0f, 0.0f}}), 1e-3);
  EXPECT_TRUE(large.passed);
  EXPECT_NEAR(large.tolerance, 0.2, 1e-12);
  EXPECT_EQ(large.worst_index, (std::vector<int64_t>{0, 1}));
}

TEST(CompareTensor, MissingEmptyMisshapenAndNonFiniteValuesFail) {
  const auto one = torch::ones({2, 3});
  EXPECT_EQ(compare_tensor("t", torch::Tensor(), one, 1).problem,
            "missing: this kind of case computes no tensor of that name");
  EXPECT_EQ(compare_tensor("t", torch::ones({0}), torch::ones({0}), 1).problem, "the reference is empty");
  EXPECT_EQ(compare_tensor("t", torch::ones({3, 2}), one, 1).problem, "shape [3, 2] instead of [2, 3]");
  auto bad = torch::ones({2, 3});
  bad[1][2] = kNaN;
  const auto row = compare_tensor("t", bad, one, 1);
  EXPECT_FALSE(row.passed);
  EXPECT_EQ(row.worst_index, (std::vector<int64_t>{1, 2}));
  EXPECT_FALSE(compare_tensor("t", one, bad, 1).passed);
  EXPECT_FALSE(compare_tensor("t", bad, bad, 1).passed);
  const auto infinite = torch::full({1}, std::numeric_limits<float>::infinity());
  EXPECT_FALSE(compare_tensor("t", infinite, infinite, 1).passed);
}

TEST_F(Verification, PassesOnlyWhenEveryExpectedTensorDoes) {
  const NamedTensors inputs = {{"a", torch::tensor({1.0f, 2.0f})}, {"b", torch::tensor({3.0f})}};
  const auto good = verify(write_case("good", description_, inputs,
                                      {{"a", torch::tensor({2.0f, 4.0f})}, {"b", torch::tensor({6.0f})}}));
  EXPECT_TRUE(good.passed());
  EXPECT_EQ(good.kind, "scaling");
  ASSERT_EQ(good.tensors.size(), 2u);
  const auto wrong = verify(write_case("wrong", description_, inputs,
                                       {{"a", torch::tensor({2.0f, 4.0f})}, {"b", torch::tensor({6.1f})}}));
  EXPECT_FALSE(wrong.passed());
  EXPECT_TRUE(wrong.tensors[0].passed);
  const auto missing = verify(write_case("missing", description_, inputs, {{"c", torch::tensor({2.0f})}}));
  EXPECT_FALSE(missing.passed());
  EXPECT_EQ(missing.tensors[0].problem, "missing: this kind of case computes no tensor of that name");

  EXPECT_EQ(
      summary_text({good, wrong, missing}),
      "1 of 3 cases pass in float32, on LibTorch " + torch_version() + " with " + blas_name() + " as BLAS\n");
  EXPECT_NE(case_text(wrong).find("FAIL  b"), std::string::npos);
  const auto json = verification_json({good, missing});
  EXPECT_FALSE(json.at("passed").get<bool>());
  EXPECT_TRUE(json.at("cases")[0].at("passed").get<bool>());
  EXPECT_EQ(json.at("cases")[0].at("tensors")[0].at("worst_index"), nlohmann::json::array({0}));
  EXPECT_TRUE(json.at("cases")[1].at("tensors")[0].at("max").is_null());
}

TEST_F(Verification, ATrailingSlashNamesTheSameCase) {
  const auto directory =
      write_case("slash", description_, {{"a", torch::ones({1})}}, {{"a", torch::ones({1}) * 2}});
  const auto result = verify(directory / "");
  EXPECT_TRUE(result.passed());
  EXPECT_EQ(result.folder, directory);
}

TEST_F(Verification, FaultsOfACaseAreOneSentence) {
  const NamedTensors one = {{"a", torch::ones({1})}};
  EXPECT_EQ(error(folder_.path() / "nowhere"),
            "DIR: expected a folder with a reference case, found no such folder; give the folder that holds "
            "case.json.");
  std::filesystem::create_directories(folder_.path() / "empty");
  EXPECT_EQ(
      error(folder_.path() / "empty"),
      "DIR/case.json: expected a reference case's description, found no readable file; give a folder with "
      "case.json, inputs.safetensors and outputs.safetensors.");
  EXPECT_EQ(error(write_case("syntax", "{\"kind\": ", one, one)),
            "DIR/case.json:1: expected JSON, found a syntax error; correct the file.");
  EXPECT_EQ(error(write_case("list", "[1]", one, one)),
            "DIR/case.json: kind: expected the name of a kind of case, found nothing; repair the case's "
            "description.");
  EXPECT_EQ(
      error(write_case("number", R"({"kind": 3})", one, one)),
      "DIR/case.json: kind: expected the name of a kind of case, found 3; repair the case's description.");
  EXPECT_EQ(error(write_case("config", R"({"kind": "scaling", "config": []})", one, one)),
            "DIR/case.json: config: expected an object with the configuration, found []; repair the case's "
            "description.");
  EXPECT_EQ(error(write_case("tolerance", R"({"kind": "scaling", "config": {}, "relative_tolerance": -1})",
                             one, one)),
            "DIR/case.json: relative_tolerance: expected a positive number, found -1; repair the case's "
            "description.");
  EXPECT_EQ(
      error(write_case("kind", R"({"kind": "scalings", "config": {}, "relative_tolerance": 1})", one, one)),
      "DIR/case.json: kind: expected one of scaling, found scalings; write scaling.");
  const auto without_inputs = write_case("inputs", description_, one, one);
  std::filesystem::remove(without_inputs / "inputs.safetensors");
  EXPECT_EQ(error(without_inputs).rfind("DIR/inputs.safetensors: ", 0), 0u) << error(without_inputs);
}

TEST_F(Verification, InputsAreAskedForByNameAndShape) {
  const auto directory = write_case("inputs", description_, {{"a", torch::ones({2, 3}, torch::kFloat16)}},
                                    {{"a", torch::ones({1})}});
  const auto reference = read_reference_case(directory);
  EXPECT_EQ(reference.input("a", {-1, 3}).numel(), 6);
  EXPECT_EQ(reference.input("a", {-1, 3}).scalar_type(), torch::kFloat32);
  const auto file = (directory / "inputs.safetensors").string();
  EXPECT_EQ(
      test::error_of([&] { reference.input("b", {1}); }),
      file +
          ": expected the input b, found no tensor of that name; write the inputs that kind scaling needs.");
  EXPECT_EQ(test::error_of([&] {
              reference.input("a", {-1, 4});
            }),
            file +
                ": a: expected shape [any, 4], found [2, 3]; make the inputs agree with case.json's "
                "configuration.");
  EXPECT_EQ(
      test::error_of([&] { reference.weight_file(); }),
      directory.string() + ": expected weights.safetensors, found no such file; kind scaling needs weights.");
  EXPECT_TRUE(reference.expects("a"));
  EXPECT_FALSE(reference.expects_prefix("b"));
}

TEST_F(Verification, FaultsInsideARunnerDoNotStopTheOthers) {
  runners_["scaling"] = [](const ReferenceCase&) -> NamedTensors {
    return {{"a", torch::matmul(torch::ones({2, 3}), torch::ones({2, 3}))}};
  };
  const auto directory =
      write_case("fault", description_, {{"a", torch::ones({1})}}, {{"a", torch::ones({1})}});
  const auto result = verify(directory);
  EXPECT_FALSE(result.passed());
  EXPECT_EQ(result.error.find('\n'), std::string::npos);
  EXPECT_NE(result.error.find("found tensors that do not fit together ("), std::string::npos);
  runners_["scaling"] = [](const ReferenceCase&) -> NamedTensors {
    return {{"a", torch::empty({1LL << 48})}};
  };
  EXPECT_EQ(error(directory), "DIR: expected enough memory for the case, found too little; free memory.");
  runners_["scaling"] = [](const ReferenceCase&) -> NamedTensors { throw Interrupted("stopped"); };
  EXPECT_THROW(verify(directory), Interrupted);
}

}  // namespace
}  // namespace gld
