// This runs what trains, samples and evaluates, whole, on LibTorch's meta device (tests/support/meta_device.h): every
// tensor is where the device's operations can take it, and all shapes fit. What the numbers are is compared elsewhere.
// The same runs on a GPU (ctest -L gpu).
#include "datasets/formats/scene_writer.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "infer/evaluate/evaluation.h"
#include "infer/sample/sampling.h"
#include "models/bundle/bundle.h"
#include "tests/support/meta_device.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/small_training.h"
#include "train/stages/feature_stages.h"
#include "train/stages/latent_stages.h"

#include <cstdlib>
#include <filesystem>
#include <map>
#include <memory>
#include <set>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

template <class Options>
Options training_options(const std::string& device, const std::filesystem::path& model,
                         const std::filesystem::path& out) {
  auto options = test::training_options<Options>(model, out);
  options.device = device;
  return options;
}

// One folder a device with all stages, each on the device and from what the one before wrote.
class CommandsOnDevice : public testing::TestWithParam<std::string> {
 protected:
  void SetUp() override {
    std::unique_ptr<test::TemporaryFolder>& folder = folders_[GetParam()];
    if (!folder) {
      folder = std::make_unique<test::TemporaryFolder>();
      train_all();
      trained_.insert(GetParam());
    }
    if (trained_.count(GetParam()) == 0) FAIL() << "the trainings before did not end";
  }
  void train_all() {
    ::setenv("XDG_CACHE_HOME", path("cache").c_str(), 1);  // no rates of the tester's
    BundleOptions model = test::small_model();
    model.generator(level_model(1)).dit.warped_sources = 2;
    save_bundle_options(path("empty"), model);
    train_backbone(training_options<TrainBackboneOptions>(GetParam(), path("empty"), path("backbone")), {});
    auto decoder = training_options<TrainDecoderOptions>(GetParam(), path("backbone/model"), path("decoder"));
    decoder.objective.adversarial.convolutional.channels = 8;
    train_decoder(decoder, {});
    StatsOptions statistics;
    statistics.model = path("decoder/model").string();
    statistics.out = path("stats").string();
    statistics.device = GetParam();
    statistics.threads = 1;
    statistics.data = test::small_data();
    statistics.scene_count = 2;
    compute_statistics(statistics);
    auto level = training_options<TrainLevelOptions>(GetParam(), path("stats/model"), path("level"));
    level.loop.optimiser.algorithm = OptimiserAlgorithm::kMuon;
    train_level(level, {});
    train_cascade(training_options<TrainCascadeOptions>(GetParam(), path("level/model"), path("cascade")),
                  {});
    SyntheticOptions drawn;
    drawn.frames = 4;
    drawn.width = drawn.height = 56;
    write_scene(make_synthetic_scene(drawn, 0), "cameras-json", path("scene"));
  }
  static void TearDownTestSuite() { folders_.clear(); }
  std::filesystem::path path(const std::string& name) const { return folders_.at(GetParam())->path() / name; }
  SampleOptions sampling_options(const std::string& run) const {
    SampleOptions options;
    options.model = path("cascade/model").string();
    options.scene = path("scene").string();
    options.device = GetParam();
    options.views.sources = {0, 3};
    options.views.targets = {1, 2};
    options.outputs = {"image", "depth", "rays", "points", "latents"};
    options.solver.evaluations = 3;
    options.threads = 1;
    options.out = path(run).string();
    return options;
  }
  nlohmann::json report(const std::string& run) const {
    return nlohmann::json::parse(read_file(path(run) / "report.json"));
  }

  static std::map<std::string, std::unique_ptr<test::TemporaryFolder>> folders_;
  static std::set<std::string> trained_;
};
std::set<std::string> CommandsOnDevice::trained_;
std::map<std::string, std::unique_ptr<test::TemporaryFolder>> CommandsOnDevice::folders_;

// All the others rest on this.
TEST(MetaDevice, ATensorThatWasLeftOnTheCpuIsAnError) {
  const auto on_device = torch::ones({4, 4}, torch::kMeta), left = torch::ones({4, 4});
  EXPECT_ANY_THROW(on_device + left);
  EXPECT_ANY_THROW(torch::layer_norm(on_device, {4}, left[0], left[1]));
  EXPECT_ANY_THROW(torch::conv2d(on_device.view({1, 1, 4, 4}), left.view({1, 1, 4, 4})));
  EXPECT_ANY_THROW(torch::empty({4}, torch::kMeta).copy_(torch::empty({3}, torch::kMeta)));
  EXPECT_ANY_THROW(torch::cat({on_device, left}));
  EXPECT_ANY_THROW(torch::mm(on_device, left));
  EXPECT_ANY_THROW(torch::linear(on_device, left, left[0]));
  EXPECT_ANY_THROW(torch::matmul(on_device.unsqueeze(0), left.unsqueeze(0)));
}

TEST_P(CommandsOnDevice, EveryStageOfTrainingRuns) {
  const auto trained = ModelBundle::open(path("cascade/model"));
  for (const BundlePart& part : bundle_parts(trained.options())) {
    EXPECT_TRUE(trained.has(part)) << bundle_part_name(part);
  }
  for (const char* run : {"backbone", "decoder", "level", "cascade"}) {
    EXPECT_EQ(report(run).at("steps"), 2) << run;
    EXPECT_EQ(report(run).at("skipped_steps"), 0) << run;
  }
}

TEST_P(CommandsOnDevice, ARunIsResumed) {
  std::filesystem::copy(path("level"), path("resumed"), std::filesystem::copy_options::recursive);
  auto options = training_options<TrainLevelOptions>(GetParam(), path("stats/model"), path("resumed"));
  options.loop.optimiser.algorithm = OptimiserAlgorithm::kMuon;
  options.resume = true;
  options.loop.steps = 3;
  train_level(options, {});
  EXPECT_EQ(report("resumed").at("steps_in_this_call"), 1);
}

TEST_P(CommandsOnDevice, NovelViewsAreSampled) {
  const SampleOptions options = sampling_options("sampled");
  sample(options);
  EXPECT_EQ(report("sampled").at("precision"), "float32");
  if (GetParam() == "cuda") {
    EXPECT_GT(report("sampled").at("stages")[0].at("device_bytes").get<int64_t>(), 0)
        << "LibTorch 2.9 and newer say";
  }
  EXPECT_TRUE(report("sampled").at("plan")[0].at("predicted_seconds").is_null())
      << "the rates known are the processor's";
  for (const char* file : {"images/view_02.png", "images/view_03.png", "contact_sheet.png"}) {
    EXPECT_TRUE(std::filesystem::is_regular_file(path("sampled") / file)) << file;
  }
  EXPECT_EQ(report("sampled").at("flows").size(), 2U);
}

TEST_P(CommandsOnDevice, NovelViewsAreSampledInBfloat16) {
  SampleOptions options = sampling_options("in_bfloat16");
  options.precision = PrecisionChoice::kBFloat16;
  sample(options);
  EXPECT_EQ(report("in_bfloat16").at("precision"), "bfloat16 on " + GetParam());
  EXPECT_THAT(report("in_bfloat16").at("sampling").at("in_words").get<std::string>(),
              testing::HasSubstr("bfloat16 on " + GetParam()));
}

TEST_P(CommandsOnDevice, ScenesAreEvaluated) {
  EvaluationOptions options;
  options.model = path("cascade/model").string();
  options.out = path("evaluated").string();
  options.device = GetParam();
  options.threads = 1;
  options.synthetic = 2;
  options.solver.evaluations = 2;
  evaluate(options);
  EXPECT_TRUE(std::filesystem::is_regular_file(path("evaluated") / "eval.csv"));
}

INSTANTIATE_TEST_SUITE_P(Meta, CommandsOnDevice, testing::Values("meta"));
INSTANTIATE_TEST_SUITE_P(on_gpu, CommandsOnDevice, testing::Values("cuda"));

}  // namespace
}  // namespace gld
