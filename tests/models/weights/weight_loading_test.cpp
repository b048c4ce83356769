#include "models/weights/weight_loading.h"

#include "gld/base/atomic_file.h"
#include "gld/tensors/weight_tensors.h"
#include "models/layers/layers.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/pickle_text.h"
#include "tests/support/temporary_folder.h"

#include <fstream>
#include <string>

#include <torch/autograd.h>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::float_bytes;
using test::PickleText;
using testing::ElementsAre;

// Parameters "norm.weight", "norm.bias", "out.weight" and a buffer "steps".
class SmallModule : public torch::nn::Module {
 public:
  explicit SmallModule(const ParameterPlacement& placement) {
    norm = register_module("norm", std::make_shared<LayerNorm>(2, 1e-6, placement));
    out = register_module("out", std::make_shared<Linear>(LinearSizes{2, 3, false}, placement));
    steps = register_buffer("steps", torch::zeros({1}, torch::TensorOptions().dtype(torch::kInt64)));
  }
  std::shared_ptr<LayerNorm> norm;
  std::shared_ptr<Linear> out;
  torch::Tensor steps;
};

std::map<std::string, torch::Tensor> good_tensors() {
  return {{"norm.weight", torch::tensor({1.0F, 2.0F})},
          {"norm.bias", torch::tensor({3.0F, 4.0F})},
          {"out.weight", torch::arange(6, torch::kFloat32).reshape({3, 2})},
          {"steps", torch::tensor({int64_t{7}})}};
}

class WeightLoading : public testing::Test {
 protected:
  std::shared_ptr<const WeightFile> saved(const std::map<std::string, torch::Tensor>& tensors) {
    save_safetensors(file_, tensors);
    return WeightFile::open(file_);
  }
  std::string refusal(const std::map<std::string, torch::Tensor>& tensors,
                      const WeightSelection& selection = {}) {
    const auto weights = saved(tensors);
    SmallModule module{ParameterPlacement{}};
    return error_of([&] { load_strict(module, *weights, selection); });
  }

  test::TemporaryFolder folder_;
  std::filesystem::path file_ = folder_.path() / "w.safetensors";
};

// A tensor of the file's memory is changed before loading: where it still is changed afterwards, its pages were kept.
TEST_F(WeightLoading, GivesBackThePagesOfConvertedTensorsAlone) {
  constexpr int64_t kChannels = 1 << 15, kMiddle = kChannels / 2;
  const auto weights = saved({{"weight", torch::ones({kChannels}, torch::kFloat16)},
                              {"bias", torch::ones({kChannels}, torch::kFloat32)}});
  const auto middle = [&](const char* name) { return read_tensor(*weights, name)[kMiddle]; };
  middle("weight").fill_(2);
  middle("bias").fill_(2);
  LayerNorm module(kChannels, 1e-6, ParameterPlacement{});
  const auto report = load_strict(module, *weights);
  EXPECT_EQ(report.shared, 1);
  EXPECT_EQ(report.converted, 1);
  EXPECT_EQ(module.weight[kMiddle].item<float>(), 2);
  EXPECT_EQ(module.bias[kMiddle].item<float>(), 2);
  EXPECT_EQ(middle("weight").item<float>(), 1);
  EXPECT_EQ(middle("bias").item<float>(), 2);
}

TEST_F(WeightLoading, SetsEveryTensorWithoutACopy) {
  SmallModule module{ParameterPlacement{}};
  auto weights = saved(good_tensors());
  const auto report = load_strict(module, *weights);
  EXPECT_EQ(report.tensors, 4);
  EXPECT_EQ(report.parameters, 11);
  EXPECT_EQ(report.shared, 4);
  EXPECT_EQ(report.converted, 0);
  EXPECT_EQ(module.out->weight.data_ptr(), weights->entry("out.weight").data);
  EXPECT_TRUE(module.out->weight.requires_grad());
  // The mapping lives as long as the parameters, and writing to them does not reach the file.
  weights.reset();
  {
    const torch::NoGradGuard no_grad;
    module.out->weight.add_(1);
  }
  EXPECT_EQ(module.out->weight[2][1].item<float>(), 6);
  EXPECT_EQ(module.steps.item<int64_t>(), 7);
  EXPECT_EQ(read_tensor(*WeightFile::open(file_), "out.weight")[2][1].item<float>(), 5);
  const auto x = torch::tensor({{1.0F, 1.0F}});
  EXPECT_EQ(module.out->forward(x)[0][0].item<float>(), 3);
}

TEST_F(WeightLoading, ConvertsFloatingPointTypes) {
  for (const auto dtype : {torch::kFloat16, torch::kBFloat16, torch::kFloat64}) {
    auto tensors = good_tensors();
    tensors["out.weight"] = tensors["out.weight"].to(dtype);
    SmallModule module{ParameterPlacement{}};
    const auto report = load_strict(module, *saved(tensors));
    EXPECT_EQ(report.converted, 1);
    EXPECT_EQ(module.out->weight.scalar_type(), torch::kFloat32);
    EXPECT_EQ(module.out->weight[2][1].item<float>(), 5);
  }
  ParameterPlacement half;
  half.dtype = torch::kBFloat16;
  SmallModule module(half);
  EXPECT_EQ(load_strict(module, *saved(good_tensors())).converted, 3);
  EXPECT_EQ(module.norm->weight.scalar_type(), torch::kBFloat16);
}

TEST_F(WeightLoading, SelectsAPartOfAPyTorchFile) {
  PickleText pickle;
  pickle.op('}').op('(').text("model").op('}').text("w").tensor("0", 2, 0, {2}, {1}).op('s');
  pickle.text("ema").op('}').op('(');
  pickle.text("norm.weight").tensor("0", 2, 0, {2}, {1}).text("norm.bias").tensor("0", 2, 0, {2}, {1});
  pickle.text("weight").tensor("1", 6, 0, {3, 2}, {1, 3}).op('u').op('u');
  const auto file = folder_.path() / "w.pt";
  write_file_atomically(file, test::torch_zip(pickle.stopped(), {{"0", float_bytes({1, 2})},
                                                                 {"1", float_bytes({0, 2, 4, 1, 3, 5})}}));
  Linear linear({2, 3, false}, {});
  WeightSelection selection;
  selection.prefix = "ema.";
  selection.ignored = {{"norm.*", "belongs to another layer"}};
  const auto report = load_strict(linear, *WeightFile::open(file), selection);
  EXPECT_THAT(report.ignored, ElementsAre("norm.bias", "norm.weight"));
  EXPECT_TRUE(linear.weight.equal(torch::arange(6, torch::kFloat32).reshape({3, 2}))) << "a transposed view";
  EXPECT_TRUE(linear.weight.is_contiguous());
}

TEST_F(WeightLoading, RefusesWhatDoesNotFit) {
  const std::string where = file_.string();
  auto missing = good_tensors();
  missing.erase("norm.bias");
  EXPECT_EQ(refusal(missing), where +
                                  ": expected a tensor named norm.bias, found none; "
                                  "check that the configuration belongs to these weights.");
  auto misshapen = good_tensors();
  misshapen["out.weight"] = torch::zeros({2, 3});
  EXPECT_EQ(refusal(misshapen), where +
                                    ": tensor out.weight: expected shape (3, 2), found (2, 3); "
                                    "check that the configuration belongs to these weights.");
  auto unexpected = good_tensors();
  unexpected["out.bias"] = torch::zeros({3});
  EXPECT_EQ(
      refusal(unexpected),
      where +
          ": expected no tensor beside the model's own, found the unexpected tensor out.bias; "
          "check that the configuration belongs to these weights (the model's nearest tensor is norm.bias).");
  WeightSelection with_reason;
  with_reason.ignored = {{"out.bias", "the release stores it, nothing uses it"}};
  SmallModule module{ParameterPlacement{}};
  EXPECT_THAT(load_strict(module, *saved(unexpected), with_reason).ignored, ElementsAre("out.bias"));
  auto wrong_type = good_tensors();
  wrong_type["out.weight"] = torch::zeros({3, 2}, torch::kInt64);
  EXPECT_EQ(refusal(wrong_type), where +
                                     ": tensor out.weight: expected float32, found int64; "
                                     "check that the configuration belongs to these weights.");
  WeightSelection elsewhere;
  elsewhere.prefix = "ema.";
  EXPECT_EQ(
      refusal(good_tensors(), elsewhere),
      where + ": expected tensors whose names start with ema., found none; list the file with gld inspect.");
}

TEST_F(WeightLoading, ARefusedFileLeavesTheModuleAsItWas) {
  SmallModule module{ParameterPlacement{}};
  load_strict(module, good_tensors(), "memory");
  auto misshapen = good_tensors();
  misshapen["norm.bias"].fill_(-1);
  misshapen["steps"] = torch::zeros({2}, torch::kInt64);
  EXPECT_EQ(error_of([&] { load_strict(module, misshapen, "memory"); }),
            "memory: tensor steps: expected shape (1), found (2); "
            "check that the configuration belongs to these weights.");
  EXPECT_EQ(module.norm->bias[0].item<float>(), 3);
}

TEST_F(WeightLoading, AMetaModuleIsMatchedButNotLoaded) {
  ParameterPlacement meta;
  meta.device = torch::kMeta;
  Linear linear({2, 3, false}, meta);
  save_safetensors(file_, {{"weight", torch::zeros({3, 2}, torch::kFloat16)}});
  const auto weights = WeightFile::open(file_);
  LoadReport report;
  const auto matched = match_strict(linear, *weights, {}, report);
  ASSERT_EQ(matched.size(), 1U);
  EXPECT_EQ(matched[0].source->dtype, DType::kFloat16);
  EXPECT_EQ(error_of([&] { load_strict(linear, *weights); }),
            file_.string() +
                ": tensor weight: expected a module with memory, found one on the meta device; "
                "construct the module on the CPU or GPU.");
}

TEST_F(WeightLoading, SavedTensorsComeBackInAnyDtypeShapeAndStride) {
  std::map<std::string, torch::Tensor> tensors = {
      {"scalar", torch::tensor(2.5)},
      {"empty", torch::zeros({0, 3})},
      {"bool", torch::tensor({1, 0, 1}).to(torch::kBool)},
      {"half", torch::tensor({1.5F}).to(torch::kFloat16)},
      {"bytes", torch::arange(5).to(torch::kUInt8)},
      {"transposed", torch::arange(6, torch::kFloat32).reshape({2, 3}).t()},
      {"long", torch::tensor({int64_t{-1}, int64_t{1} << 40})},
  };
  save_safetensors(file_, tensors, {{"made by", "a test"}});
  const std::string first = read_file(file_);
  const auto weights = WeightFile::open(file_);
  EXPECT_EQ(weights->metadata().at("made by"), "a test");
  for (const auto& [name, tensor] : read_all(*weights)) {
    EXPECT_EQ(tensor.scalar_type(), tensors[name].scalar_type()) << name;
    EXPECT_TRUE(tensor.equal(tensors[name])) << name;
  }
  for (const auto& entry : weights->entries()) {
    EXPECT_EQ(reinterpret_cast<uintptr_t>(entry.data) % static_cast<uintptr_t>(byte_size(entry.dtype)), 0U);
  }
  save_safetensors(file_, tensors, {{"made by", "a test"}});
  EXPECT_EQ(read_file(file_), first);
  EXPECT_EQ(error_of([&] { read_all(*weights, "ema."); }),
            file_.string() +
                ": expected tensors whose names start with ema., found none; "
                "list the file with gld inspect.");
}

// Here a part of the module stands under another beginning than the rest.
TEST_F(WeightLoading, PartsMayStandElsewhereInTheFile) {
  std::map<std::string, torch::Tensor> tensors;
  for (const auto& [name, tensor] : good_tensors()) {
    tensors[(name.rfind("norm.", 0) == 0 ? "other." + name.substr(5) : "own." + name)] = tensor;
  }
  WeightSelection selection;
  selection.prefix = "own.";
  selection.elsewhere = {{"other.", "norm."}};
  SmallModule from_file{ParameterPlacement{}}, from_memory{ParameterPlacement{}};
  EXPECT_EQ(load_strict(from_file, *saved(tensors), selection).tensors, 4);
  EXPECT_EQ(load_strict(from_memory, tensors, "tensors", selection).tensors, 4);
  for (const SmallModule* module : {&from_file, &from_memory}) {
    EXPECT_TRUE(module->norm->bias.equal(torch::tensor({3.0F, 4.0F})));
    EXPECT_EQ(module->steps.item<int64_t>(), 7);
  }
  tensors.erase("other.bias");
  EXPECT_EQ(refusal(tensors, selection),
            file_.string() +
                ": expected a tensor named other.bias, found none; check that the configuration belongs "
                "to these weights.");
  tensors["other.bias"] = torch::zeros({2});
  tensors["other.scale"] = torch::zeros({2});
  EXPECT_NE(refusal(tensors, selection).find("the unexpected tensor other.scale"), std::string::npos);
  tensors.erase("other.scale");
  tensors["own.norm.bias"] = torch::zeros({2});
  EXPECT_EQ(
      refusal(tensors, selection),
      file_.string() +
          ": expected one tensor for norm.bias, found a second one, own.norm.bias; check that the configuration "
          "belongs to these weights.");
}

TEST_F(WeightLoading, MisalignedDataIsCopied) {
  // The data starts at byte 8 + 57, so no float is aligned.
  const std::string header = R"({"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}}   )";
  ASSERT_EQ(header.size(), 57U);
  write_file_atomically(file_, test::safetensors_text(header, float_bytes({1.5F, -2})));
  const auto weights = WeightFile::open(file_);
  const auto tensor = read_tensor(*weights, "a");
  EXPECT_NE(tensor.data_ptr(), weights->entry("a").data);
  EXPECT_EQ(tensor[1].item<float>(), -2);
}

TEST_F(WeightLoading, SharedFilesBecomeTensors) {
  const auto stats = read_all(test::test_data() / "stats/da3/normalization_stats_level1.pt");
  EXPECT_EQ(stats.at("mean").sizes(), (torch::IntArrayRef{1, 1536, 1, 1}));
  EXPECT_GT(stats.at("var").min().item<float>(), 0);
  for (const char* name : {"alex", "vgg", "squeeze"}) {
    const auto heads = read_all(test::test_data() / "weights" / (std::string("lpips_v0.1_") + name + ".pth"));
    for (const auto& [key, tensor] : heads) EXPECT_GE(tensor.min().item<float>(), 0) << name << " " << key;
  }
}

}  // namespace
}  // namespace gld
