// gld stats, gld train level and gld train cascade with a shrunken configuration, from one stage to the next.
#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/flow/flow.h"
#include "gld/latents/latent_statistics.h"
#include "gld/machine/precision_option.h"
#include "gld/tensors/weight_tensors.h"
#include "models/bundle/bundle.h"
#include "models/bundle/part_lineage.h"
#include "models/bundle/view_unit_file.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/small_training.h"
#include "train/loop/metrics_log.h"
#include "train/objectives/level_objective.h"
#include "train/stages/feature_stages.h"
#include "train/stages/latent_stages.h"

#include <cmath>
#include <csignal>
#include <fstream>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

// One folder with the runs of all stages: backbone, decoder, stats, level, cascade.
class TrainedChain : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = std::make_unique<test::TemporaryFolder>();
    save_bundle_options(path("empty"), test::small_model());
    auto backbone = test::training_options<TrainBackboneOptions>(path("empty"), path("backbone"));
    backbone.store = StoredPrecision::kFloat16;
    train_backbone(backbone, {});
    auto decoder = test::training_options<TrainDecoderOptions>(path("backbone/model"), path("decoder"));
    decoder.objective.adversarial.convolutional.channels = 8;
    train_decoder(decoder, {});
    StatsOptions stats;
    stats.model = path("decoder/model").string();
    stats.out = path("stats").string();
    stats.threads = 1;
    stats.scene_count = 5;
    stats.data = test::small_data();
    compute_statistics(stats);
    train_level(test::training_options<TrainLevelOptions>(path("stats/model"), path("level")), {});
    train_cascade(test::training_options<TrainCascadeOptions>(path("level/model"), path("cascade")), {});
  }
  static void TearDownTestSuite() { folder_.reset(); }
  static std::filesystem::path path(const std::string& name) { return folder_->path() / name; }

  static std::unique_ptr<test::TemporaryFolder> folder_;
};
std::unique_ptr<test::TemporaryFolder> TrainedChain::folder_;

TEST_F(TrainedChain, TheLastBundleHasEveryPart) {
  const auto bundle = ModelBundle::open(path("cascade/model"));
  for (const BundlePart& part : bundle_parts(bundle.options()))
    EXPECT_TRUE(bundle.has(part)) << bundle_part_name(part);
  EXPECT_EQ(bundle.load_generator(cascade(1, 0))->options().in_channels, 64);
  // The exported precision is what later stages saw.
  EXPECT_EQ(WeightFile::open(bundle.file(BundlePart::backbone()))->entries().front().dtype, DType::kFloat16);
}

TEST_F(TrainedChain, SourceAndTargetLossesAreLoggedApart) {
  for (const char* kind : {"level", "cascade"}) {
    const MetricsLog log(path(kind) / "metrics.jsonl", 2);
    for (const char* key :
         {"loss", "source", "target", "validation_flow_loss_target", "validation_target_psnr"}) {
      const auto series = log.series(key);
      ASSERT_EQ(series.size(), 2U) << kind << ' ' << key;
      EXPECT_TRUE(std::isfinite(series.back().second)) << kind << ' ' << key;
    }
    // The last layer starts at zero, so the first velocity is 0 and its error E (noise - data)^2 = 2.
    EXPECT_NEAR(log.series("loss").front().second, 2.0, 0.3) << kind;
  }
}

TEST_F(TrainedChain, StatisticsMakeLatentsStandard) {
  const auto bundle = ModelBundle::open(path("stats/model"));
  const auto statistics = bundle.load_statistics(level_model(1));
  EXPECT_EQ(statistics.patches.channels(), 64);
  EXPECT_GE(statistics.patches.variance.min().item<float>(), 0.0F);
  // The same scenes again have mean 0 and variance 1 in every channel.
  const DatasetBatches data(test::small_data(), test::small_model().image_sizes(), FrameParts::kImage);
  const torch::NoGradGuard no_grad;
  const auto backbone = bundle.load_backbone();
  std::vector<torch::Tensor> latents;
  for (int64_t index = 0; index < 5; ++index) {
    const auto images = data.batch(index).scenes.front().images;
    const auto level = backbone->encode(images, 1)[1];
    latents.push_back(statistics.normalise(level.narrow(1, 1, level.size(1) - 1)).flatten(0, 1));
  }
  const auto latent = torch::cat(latents);
  EXPECT_LT(latent.mean(0).abs().max().item<double>(), 1e-3);
  EXPECT_LT((latent.std(0, /*unbiased=*/false) - 1.0).abs().max().item<double>(), 0.02);
  EXPECT_TRUE(std::filesystem::exists(path("stats/report.json")));
}

TEST_F(TrainedChain, ResumingWithNothingIsAnError) {
  auto options = test::training_options<TrainLevelOptions>(path("stats/model"), path("nothing"));
  options.resume = true;
  EXPECT_EQ(test::error_of([&] { train_level(options, {}); }),
            path("nothing").string() + ": expected a checkpoint to resume from, found none in " +
                path("nothing/checkpoints").string() + "; start the run without --resume.");
  EXPECT_FALSE(std::filesystem::exists(path("nothing")));
}

TEST_F(TrainedChain, ResumingWithOtherOptionsSaysWhichDiffer) {
  auto options = test::training_options<TrainLevelOptions>(path("stats/model"), path("other_options"));
  train_level(options, {});
  EXPECT_THAT(
      test::error_of([&] { train_level(options, {}); }),
      testing::HasSubstr("continue it with --resume, begin anew with --overwrite, or choose another --out"));
  options.resume = true;
  const double peak = options.loop.learning_rate.peak;
  options.loop.learning_rate.peak = 0.25;
  options.data.views.longest_interval += 1;
  const auto refused = test::error_of([&] { train_level(options, {}); });
  EXPECT_THAT(
      refused,
      testing::HasSubstr(fmt::format(
          "--resume: expected the options that the run was begun with, found data.views.longest_interval {} (it was {}), "
          "loop.learning_rate.peak 0.25 (it was {});",
          options.data.views.longest_interval, options.data.views.longest_interval - 1, peak)));
  EXPECT_THAT(refused,
              testing::HasSubstr("with --may-change data.views.longest_interval,loop.learning_rate.peak"));
  auto others = options;
  others.loop.seed += 1;
  others.loop.optimiser.clip_norm += 1;
  others.data.loading.seed += 1;
  const auto many = test::error_of([&] { train_level(others, {}); });
  EXPECT_THAT(many, testing::HasSubstr(" and 2 more; take them from --config " +
                                       (path("other_options") / "config.yaml").string() + "."));
  others.model.clear();
  EXPECT_EQ(test::error_of([&] { others.check(); }),
            "--resume: expected the options that the run was begun with, found no --model; add --config " +
                path("other_options").string() + "/config.yaml, where they stand.");
  options.may_change = {"data.views.longest_interval"};
  EXPECT_THAT(test::error_of([&] { train_level(options, {}); }),
              testing::EndsWith("with --may-change loop.learning_rate.peak."));
  // How far it goes and the course of its rate are not what it is.
  options.loop.learning_rate.peak = peak;
  options.loop.learning_rate.schedule = LearningRateSchedule::kLinear;
  options.loop.learning_rate.decay_start_step = options.loop.steps;
  options.loop.steps += 1;
  train_level(options, {});
}

TEST_F(TrainedChain, PartsOfAnotherBackboneAreRefused) {
  std::filesystem::copy(path("stats/model"), path("mixed"));
  const auto backbone = path("mixed") / "backbone.safetensors";
  save_safetensors(backbone, read_all(backbone), {{"trained", "again"}});
  auto options = test::training_options<TrainLevelOptions>(path("mixed"), path("on_mixed"));
  EXPECT_EQ(
      test::error_of([&] { train_level(options, {}); }),
      (path("mixed") / "statistics_level1.safetensors").string() +
          ": expected a part that was trained on the backbone beside it, found one of another backbone; "
          "train statistics_level1 again, or take it as it is with --allow-mixed.");
  EXPECT_FALSE(std::filesystem::exists(path("on_mixed")));
  options.allow_mixed = true;
  train_level(options, {});
}

// A model that is shown photographs in target views learns them with the errors of one geometry head.
TEST_F(TrainedChain, AModelThatIsShownPhotographsBelongsToTheirGeometryHead) {
  std::filesystem::copy(path("stats/model"), path("showing"));
  std::filesystem::remove(path("showing") / "model.yaml");
  BundleOptions model = test::small_model();
  model.generator(level_model(1)).dit.warped_sources = 1;
  save_bundle_options(path("showing"), model);
  auto options = test::training_options<TrainLevelOptions>(path("showing"), path("shown"));
  train_level(options, {});
  const auto trained = ModelBundle::open(path("shown/model"));
  const BundlePart level = BundlePart::of(level_model(1));
  EXPECT_EQ(mixed_parts(trained, {level}, false), std::vector<std::string>());
  const auto head = path("shown/model") / "dpt_head.safetensors";
  save_safetensors(head, read_all(head), {{"trained", "again"}});
  EXPECT_THAT(test::error_of([&] { mixed_parts(trained, {level}, false); }),
              testing::HasSubstr("expected a part that was trained on the dpt_head beside it"));
  // What is no text is no hash of anything.
  note_in_metadata(trained, level, {{"gld:trained_on", R"({"backbone": 5})"}});
  EXPECT_THAT(test::error_of([&] { mixed_parts(trained, {level}, false); }),
              testing::HasSubstr("expected a part that was trained on the backbone beside it"));
}

// No tensor's shape tells what a flow model predicts.
TEST_F(TrainedChain, AFlowModelThatWasTrainedAsSomethingElseIsRefused) {
  std::filesystem::copy(path("level/model"), path("otherwise"));
  const BundlePart level = BundlePart::of(level_model(1));
  EXPECT_EQ(mixed_parts(ModelBundle::open(path("otherwise")), {level}, false), std::vector<std::string>());
  BundleOptions model = ModelBundle::open(path("otherwise")).options();
  model.generator(level_model(1)).dit.prediction = FlowPrediction::kData;
  std::filesystem::remove(path("otherwise") / "model.yaml");
  save_bundle_options(path("otherwise"), model);
  const auto otherwise = ModelBundle::open(path("otherwise"));
  EXPECT_EQ(test::error_of([&] { mixed_parts(otherwise, {level}, false); }),
            (path("otherwise") / "level1.safetensors").string() +
                ": expected a part that was trained as model.yaml says, found level1.prediction data (it was "
                "velocity); put into model.yaml what it was, train level1 again, or take it as it is with "
                "--allow-mixed.");
  EXPECT_EQ(
      mixed_parts(otherwise, {level}, true),
      std::vector<std::string>({"level1 was trained otherwise than model.yaml says: level1.prediction data "
                                "(it was velocity)."}));
}

// Another set of levels than the published one, with special tokens: statistics, a level and a cascade.
TEST_F(TrainedChain, OtherSetsOfLevelsTrain) {
  BundleOptions model = test::small_model();
  const DitOptions like = model.generators.front().dit;
  model.set_generators({level_model(2), cascade(2, 1), level_model(0)});
  model.boundary_level = 2;
  for (auto& part : model.generators) {
    const auto conditioning = part.dit.conditioning;
    part.dit = like;
    part.dit.conditioning = conditioning;
    part.dit.num_special_tokens = 1;
    part.time_shift.training = part.time_shift.evaluation = 3.0;
  }
  save_bundle_options(path("other_set"), model);
  for (const char* file : {"backbone.safetensors", "rgb_decoder.safetensors"}) {
    std::filesystem::copy_file(path("decoder/model") / file, path("other_set") / file);
  }
  StatsOptions stats;
  stats.model = path("other_set").string();
  stats.out = path("other_stats").string();
  stats.threads = 1;
  stats.scene_count = 5;
  stats.data = test::small_data();
  compute_statistics(stats);
  const auto with_statistics = ModelBundle::open(path("other_stats/model"));
  for (const int64_t level : {0, 1, 2}) {
    EXPECT_TRUE(with_statistics.has(BundlePart::statistics(level))) << level;
    EXPECT_TRUE(with_statistics.has(BundlePart::special_statistics(level))) << level;
  }
  auto level = test::training_options<TrainLevelOptions>(path("other_stats/model"), path("level_two"));
  level.level = 2;
  train_level(level, {});
  auto deeper = test::training_options<TrainCascadeOptions>(path("level_two/model"), path("other_cascade"));
  deeper.cascade = "2->1";
  train_cascade(deeper, {});
  const auto trained = ModelBundle::open(path("other_cascade/model"));
  EXPECT_TRUE(trained.has(BundlePart::of(level_model(2))));
  EXPECT_TRUE(trained.has(BundlePart::of(cascade(2, 1))));
  for (const char* kind : {"level_two", "other_cascade"}) {
    const auto losses = MetricsLog(path(kind) / "metrics.jsonl", 2).series("loss");
    ASSERT_EQ(losses.size(), 2U) << kind;
    EXPECT_NEAR(losses.front().second, 2.0, 0.3) << kind;
  }
  deeper.cascade = "1";
  EXPECT_EQ(test::error_of([&] { train_cascade(deeper, {}); }),
            "--cascade: expected a cascade such as 1->0, found '1'; gld train level trains levels.");
}

TEST_F(TrainedChain, TheLevelMustBeOneThatTheModelGenerates) {
  auto options = test::training_options<TrainLevelOptions>(path("stats/model"), path("other_level"));
  options.level = 2;
  EXPECT_EQ(test::error_of([&] { train_level(options, {}); }),
            "model small: expected one of its generated parts: 1, 1->0, found 2; list it under generated in "
            "model.yaml.");
}

// A shift of 0 in model.yaml is the paper's rule for the latent at hand.
TEST_F(TrainedChain, TheTimeShiftFollowsFromTheLatent) {
  const auto bundle = ModelBundle::open(path("level/model"));
  const FrozenParts frozen = frozen_parts(bundle, level_model(1), {});
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImage);
  const auto batch = data.batch(0);
  const auto loss_at = [&](double shift) {
    BundleOptions model = test::small_model();
    model.generator(level_model(1)).time_shift.training = shift;
    LevelObjective objective(model, 1, {}, frozen, {}, 1);
    objective.start_from(*bundle.load_generator(level_model(1)));
    return objective.losses(batch, {0, 1, at::detail::createCPUGenerator(4)}).total.item<double>();
  };
  const auto& scene = batch.scenes.front();
  const BundleOptions model = test::small_model();
  const auto grid = model.backbone.grid_of(scene.views.size(), scene.height(), scene.width());
  const double by_rule = loss_at(0);
  EXPECT_EQ(by_rule, loss_at(time_shift_of(grid, model.backbone.level_channels())));
  EXPECT_NE(by_rule, loss_at(50));
}

// Returns the weights of that part after two steps; the run is stopped after the first where resumed.
torch::Tensor trained_weights(TrainLevelOptions options, const std::string& how) {
  if (how == "resumed") {
    options.loop.steps = 1;
    train_level(options, {});
    options.loop.steps = 2;
    options.resume = true;
  }
  train_level(options, {});
  const auto generator =
      ModelBundle::open(std::filesystem::path(options.out) / "model").load_generator(level_model(1));
  std::vector<torch::Tensor> flat;
  for (const auto& parameter : generator->parameters()) flat.push_back(parameter.detach().flatten());
  return torch::cat(flat);
}

TEST_F(TrainedChain, LearnsInBFloat16AndGoesOnBitForBit) {
  const auto options = [](const std::string& name, ComputePrecision precision) {
    auto made = test::training_options<TrainLevelOptions>(path("stats/model"), path(name));
    made.loop.learning_rate.schedule = LearningRateSchedule::kConstant;
    made.loop.precision = precision;
    return made;
  };
  const auto whole = trained_weights(options("bfloat16", ComputePrecision::kBFloat16), "whole");
  const auto resumed = trained_weights(options("bfloat16_resumed", ComputePrecision::kBFloat16), "resumed");
  const auto exact = trained_weights(options("float32", ComputePrecision::kFloat32), "whole");
  EXPECT_TRUE(torch::equal(whole, resumed));
  EXPECT_FALSE(torch::equal(whole, exact));
  // AdamW's first steps have the size of the rate whatever the gradient is; a weight whose gradient is next to nothing
  // may take them the other way.
  EXPECT_LT((whole - exact).norm().item<double>(), 0.02 * exact.norm().item<double>());
  std::ifstream report_file(path("bfloat16/report.json"));
  const auto report = nlohmann::json::parse(report_file);
  EXPECT_EQ(report.at("precision"), precision_text(ComputePrecision::kBFloat16));

  auto other = options("bfloat16", ComputePrecision::kFloat32);
  other.resume = true;
  other.loop.steps = 3;
  EXPECT_THAT(test::error_of([&] { train_level(other, {}); }), testing::HasSubstr("loop.precision"));
}

// Its time shift is what noise is drawn by, and stands in no option.
TEST_F(TrainedChain, ResumingWithAnotherModelDescriptionIsRefused) {
  const auto model = path("described");
  std::filesystem::copy(path("stats/model"), model, std::filesystem::copy_options::recursive);
  auto options = test::training_options<TrainLevelOptions>(model, path("other_description"));
  train_level(options, {});
  BundleOptions described = ModelBundle::open(model).options();
  const double before = described.generator(level_model(1)).time_shift.training;
  described.generator(level_model(1)).time_shift.training = before + 1;
  write_file_atomically(model / "model.yaml", to_yaml(described));
  options.resume = true;
  options.loop.steps += 1;
  EXPECT_THAT(
      test::error_of([&] { train_level(options, {}); }),
      testing::MatchesRegex("--resume: expected the model.yaml that the run was begun with "
                            "\\(level1_time_shift.training [0-9.]+\\), found [0-9.]+; leave it as it was, or "
                            "allow it with --may-change model.level1_time_shift.training\\."));
  options.may_change = {"model.level1_time_shift.training"};
  EXPECT_NO_THROW(train_level(options, {}));
}

TEST_F(TrainedChain, RecomputedActivationsGiveTheSameGradients) {
  const auto bundle = ModelBundle::open(path("level/model"));
  const FrozenParts frozen = frozen_parts(bundle, level_model(1), {});
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImage);
  const auto batch = data.batch(0);
  std::vector<torch::Tensor> gradients;
  for (const bool recompute : {false, true}) {
    FlowObjectiveOptions options;
    options.checkpoint_blocks = recompute;
    LevelObjective objective(test::small_model(), 1, options, frozen, {}, 1);
    FlatParameters parameters(objective.parameters());
    auto perturbation = at::detail::createCPUGenerator(9);
    {
      const torch::NoGradGuard no_grad;
      const auto& values = parameters.values();
      values.add_(0.02 * torch::randn(values.sizes(), perturbation, torch::kFloat32));
    }
    auto draws = at::detail::createCPUGenerator(4);
    objective.losses(batch, {0, 1, draws}).total.backward();
    gradients.push_back(parameters.gradients().clone());
  }
  EXPECT_GT(gradients[0].abs().max().item<float>(), 0.0F);
  // The same numbers are added up in another order.
  EXPECT_LT((gradients[0] - gradients[1]).abs().max().item<double>(),
            1e-5 * gradients[0].abs().max().item<double>());
}

TEST_F(TrainedChain, FineTuningStartsFromTheBundle) {
  // Steps at a learning rate of almost nothing leave the bundle's weights as they are.
  const auto weights = [&](const std::string& model) {
    std::vector<torch::Tensor> parts;
    for (const auto& tensor : ModelBundle::open(path(model)).load_generator(level_model(1))->parameters()) {
      parts.push_back(tensor.flatten());
    }
    return torch::cat(parts);
  };
  auto options = test::training_options<TrainLevelOptions>(path("level/model"), path("tuned"));
  options.objective.start = ModelStart::kBundle;
  options.loop.learning_rate.peak = options.loop.learning_rate.final = 1e-12;
  options.loop.seed = 99;
  options.loop.optimiser.ema_decay = 0.9;
  testing::internal::CaptureStderr();
  train_level(options, {});
  EXPECT_THAT(
      testing::internal::GetCapturedStderr(),
      testing::HasSubstr("warning: the model that is written is a moving average over about 10 steps "
                         "(loop.optimiser.ema_decay 0.9), and this run has 2: it will hardly differ"));
  EXPECT_LT((weights("tuned/model") - weights("level/model")).abs().max().item<double>(), 1e-6);
  // What it begins with is validated too, so that what was learnt can be told.
  const auto validated = [&](const std::string& run) {
    return MetricsLog(path(run) / "metrics.jsonl", options.loop.steps).series("validation_flow_loss");
  };
  ASSERT_GE(validated("tuned").size(), 2U);
  EXPECT_EQ(validated("tuned").front().first, 0);
  EXPECT_NEAR(validated("tuned").front().second, validated("tuned").back().second, 1e-6);
  options.out = path("fresh").string();
  options.objective.start = ModelStart::kRandom;
  train_level(options, {});
  EXPECT_GT((weights("fresh/model") - weights("level/model")).abs().max().item<double>(), 1e-2);
  EXPECT_GT(validated("fresh").front().first, 0);
  options.model = path("stats/model").string();
  options.out = path("without").string();
  options.objective.start = ModelStart::kBundle;
  EXPECT_THROW(train_level(options, {}), Error);
}

// Whose time embedding has frequencies that no step moves: random numbers of the run that its weights are of.
TEST_F(TrainedChain, GoesOnWithTheFrequenciesThatItBeganWith) {
  auto options = test::training_options<TrainLevelOptions>(path("level/model"), path("stopped"));
  options.objective.start = ModelStart::kBundle;
  options.loop.seed = 99;
  train_level(options, {});
  options.objective.start = ModelStart::kRandom;
  options.resume = true;
  ++options.loop.steps;
  train_level(options, {});
  const auto frequencies = [&](const char* model) {
    return ModelBundle::open(path(model)).load_generator(level_model(1))->named_parameters()["t_embedder.W"];
  };
  EXPECT_TRUE(torch::equal(frequencies("stopped/model"), frequencies("level/model")));
  // Nor does it go on on other latents than it has learnt.
  std::filesystem::copy(path("level/model"), path("other"));
  const auto other = ModelBundle::open(path("other"));
  note_in_metadata(other, BundlePart::backbone(), {{"name", "another"}});
  options.model = path("other").string();
  options.allow_mixed = true;
  ++options.loop.steps;
  train_level(options, {});
  options.allow_mixed = false;
  options.model = path("level/model").string();
  ++options.loop.steps;
  EXPECT_THAT(test::error_of([&] { train_level(options, {}); }),
              testing::StartsWith("--resume: expected the backbone that "));
}

TEST_F(TrainedChain, CorrespondenceIsTaughtBesideTheFlow) {
  auto options = test::training_options<TrainLevelOptions>(path("stats/model"), path("taught"));
  options.objective.correspondence_weight = 0.1;
  options.objective.correspondence_blocks = {1, 2};
  options.objective.camera_dropout = 0;
  options.data.views.fewest_sources = 2;
  train_level(options, {});
  const MetricsLog log(path("taught") / "metrics.jsonl", 2);
  for (const auto& point : log.series("correspondence")) EXPECT_GT(point.second, 0.0);
  EXPECT_EQ(log.series("correspondence").size(), 2U);
  options.out = path("refused").string();
  options.objective.correspondence_blocks = {};
  EXPECT_EQ(
      test::error_of([&] { train_level(options, {}); }),
      "objective.correspondence_weight: expected 0 without correspondence_blocks, whose attention it would "
      "teach, found 0.1; name blocks, or leave it out.");
  options.objective.correspondence_blocks = {3};
  EXPECT_EQ(test::error_of([&] { train_level(options, {}); }),
            "objective.correspondence_blocks: expected blocks from 0 to 2, found 3; choose others.");
  options.objective.correspondence_blocks = {2};
  options.objective.checkpoint_blocks = true;
  EXPECT_EQ(test::error_of([&] { train_level(options, {}); }),
            "objective.correspondence_weight: expected 0 with checkpoint_blocks, which keeps no queries and "
            "keys, found 0.1; switch one of the two off.");
  options.objective.checkpoint_blocks = false;
  options.objective.carried_dropout = 0.2;
  EXPECT_EQ(
      test::error_of([&] { train_level(options, {}); }),
      "objective.carried_dropout: expected 0 for a model into which nothing is carried (warped_sources: 0), "
      "found 0.2; leave it out.");
}

TEST_F(TrainedChain, BackboneAndDecoderGoOnFromTheBundle) {
  const auto flat = [](const torch::nn::Module& module) {
    std::vector<torch::Tensor> parts;
    for (const auto& tensor : module.parameters()) parts.push_back(tensor.flatten());
    return torch::cat(parts).detach();
  };
  const auto still = [](TrainOptions& options) {
    options.loop.learning_rate.peak = options.loop.learning_rate.final = 1e-12;
    options.loop.learning_rate.warmup_steps = 0;
    options.loop.seed = 99;
  };
  const auto before = ModelBundle::open(path("decoder/model"));
  auto backbone = test::training_options<TrainBackboneOptions>(path("decoder/model"), path("backbone_on"));
  still(backbone);
  backbone.objective.training = GeometryTraining::kFromBundle;
  train_backbone(backbone, {});
  const auto with_backbone = ModelBundle::open(path("backbone_on/model"));
  EXPECT_LT((flat(*with_backbone.load_backbone()) - flat(*before.load_backbone())).abs().max().item<double>(),
            1e-6);
  EXPECT_LT((flat(*with_backbone.load_geometry_head()) - flat(*before.load_geometry_head()))
                .abs()
                .max()
                .item<double>(),
            1e-6);
  auto decoder = test::training_options<TrainDecoderOptions>(path("decoder/model"), path("decoder_on"));
  still(decoder);
  decoder.objective.adversarial.weight = 0;
  decoder.objective.start = ModelStart::kBundle;
  train_decoder(decoder, {});
  const auto with_decoder = ModelBundle::open(path("decoder_on/model"));
  EXPECT_LT(
      (flat(*with_decoder.load_rgb_decoder()) - flat(*before.load_rgb_decoder())).abs().max().item<double>(),
      1e-6);
}

TEST_F(TrainedChain, CtrlCWritesACheckpoint) {
  auto options = test::training_options<TrainLevelOptions>(path("stats/model"), path("interrupted"));
  options.loop.checkpoint_every = 1000;
  options.loop.steps = 50;
  options.loop.log_every = 1;
  EXPECT_THROW(
      train_level(options, [](const Validation&, const std::filesystem::path&) { std::raise(SIGINT); }),
      Interrupted);
  std::signal(SIGINT, SIG_DFL);
  EXPECT_TRUE(std::filesystem::exists(path("interrupted/checkpoints/step_000000001.safetensors")));
  EXPECT_THAT(read_file(path("interrupted/report.html")),
              testing::HasSubstr("The training ended before its last step"));
}

TEST_F(TrainedChain, TheHeadGoesOnAlone) {
  auto options = test::training_options<TrainBackboneOptions>(path("decoder/model"), path("head"));
  options.objective.feature_noise = 0.5;
  EXPECT_EQ(test::error_of([&] { train_backbone(options, {}); }),
            "objective.feature_noise: expected 0 while the backbone is trained, "
            "whose features have to be exact, found 0.5; set objective.training to head_only.");
  options.objective.training = GeometryTraining::kHeadOnly;
  options.objective.loss.relative_weight = 2;
  train_backbone(options, {});
  const auto before = ModelBundle::open(path("decoder/model")), after = ModelBundle::open(path("head/model"));
  const auto changed = [&](auto&& load) {
    const auto first = load(before)->parameters(), second = load(after)->parameters();
    for (size_t i = 0; i < first.size(); ++i) {
      if (!torch::equal(first[i], second[i])) return true;
    }
    return false;
  };
  EXPECT_TRUE(changed([](const ModelBundle& bundle) { return bundle.load_geometry_head(); }));
  EXPECT_FALSE(changed([](const ModelBundle& bundle) { return bundle.load_backbone(); }));
  EXPECT_TRUE(after.has(BundlePart::rgb_decoder()));
}

TEST_F(TrainedChain, KeptLatentsAreThoseOfTheScene) {
  const auto bundle = ModelBundle::open(path("stats/model"));
  const FrozenParts frozen = frozen_parts(bundle, level_model(1), {});
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImage);
  const auto batch = data.batch(0);
  std::vector<double> losses;
  for (const double gib : {0.0, 0.01}) {
    FlowObjectiveOptions options;
    options.kept_latents_gib = gib;
    LevelObjective objective(test::small_model(), 1, options, frozen, {}, 1);
    const torch::NoGradGuard no_grad;
    for (int pass = 0; pass < 2; ++pass) {
      auto draws = at::detail::createCPUGenerator(4);
      losses.push_back(objective.losses(batch, {0, 1, draws}).total.item<double>());
    }
  }
  EXPECT_EQ(losses[0], losses[1]);
  EXPECT_EQ(losses[2], losses[3]) << "the first use has the rounding of later ones";
  EXPECT_NEAR(losses[0], losses[2], 1e-3);
}

// The second run takes rooms and latents from the folder, and its model is the same to the byte, whether latents are
// kept in memory (rounded) or not.
TEST_F(TrainedChain, ScenesOfAnotherRunMakeTheSameModel) {
  const auto trained = [&](const std::string& name, double gib, bool in_folder) {
    auto level = test::training_options<TrainLevelOptions>(path("stats/model"), path(name));
    auto cascade = test::training_options<TrainCascadeOptions>(path(name) / "model", path(name + "_cascade"));
    level.data.distinct_batches = cascade.data.distinct_batches = 2;
    level.objective.kept_latents_gib = cascade.objective.flow.kept_latents_gib = gib;
    if (in_folder) level.kept_scenes = cascade.kept_scenes = path("kept_scenes").string();
    train_level(level, {});
    train_cascade(cascade, {});
    return ModelBundle::open(path(name + "_cascade") / "model").content_hash();
  };
  const auto files = [&] {
    int64_t count = 0;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(path("kept_scenes")))
      count += entry.is_regular_file() ? 1 : 0;
    return count;
  };
  int64_t expected = 2;  // rooms
  for (const double gib : {0.0, 0.01}) {
    const std::string name = gib > 0 ? "kept_in_memory" : "kept_nowhere";
    const std::string alone = trained(name, gib, false);
    expected += 4;  // of each room the latents of level 1 and of the cascade
    for (const char* run : {"_first", "_second"}) {
      EXPECT_EQ(trained(name + run, gib, true), alone);
      EXPECT_EQ(files(), expected) << name << run;
    }
  }
}

// Everything that frozen parts make of a scene depends on these.
TEST_F(TrainedChain, KeptScenesAreThoseOfTheirParts) {
  const test::TemporaryFolder folder;
  TrainLevelOptions options;
  options.kept_scenes = (folder.path() / "kept").string();
  const auto bundle = ModelBundle::open(path("stats/model"));
  const auto kept = [&](const ModelBundle& of, const torch::Device& device, const std::string& use) {
    return kept_scene_folder(options, of, {BundlePart::backbone(), BundlePart::geometry_head()}, device, use);
  };
  EXPECT_EQ(kept(bundle, torch::kCPU, "use"), nullptr);  // none of its scenes comes again
  options.data.distinct_batches = 2;
  kept(bundle, torch::kCPU, "use")->keep("key", {});
  EXPECT_TRUE(kept(bundle, torch::kCPU, "use")->find("key"));
  EXPECT_FALSE(kept(bundle, torch::kCPU, "another use")->find("key"));
  EXPECT_FALSE(kept(bundle, torch::kCUDA, "use")->find("key"));
  const auto copied = [&](const char* name) {
    std::filesystem::copy(path("stats/model"), folder.path() / name);
    return ModelBundle::open(folder.path() / name);
  };
  const auto same = copied("same"), other_head = copied("other_head"), other_unit = copied("other_unit");
  EXPECT_TRUE(kept(same, torch::kCPU, "use")->find("key"));
  auto tensors = read_all(other_head.file(BundlePart::geometry_head()));
  save_safetensors(other_head.file(BundlePart::geometry_head()), tensors, {{"changed", "yes"}});
  EXPECT_FALSE(kept(other_head, torch::kCPU, "use")->find("key"));
  SingleViewUnit unit;
  unit.mean = unit.deviation = unit.weights = torch::ones({2}, torch::kFloat64);
  write_single_view_unit(other_unit, unit);
  EXPECT_FALSE(kept(other_unit, torch::kCPU, "use")->find("key"));
}

TEST_F(TrainedChain, CamerasAreDroppedASceneAtATime) {
  const auto bundle = ModelBundle::open(path("stats/model"));
  const FrozenParts frozen = frozen_parts(bundle, level_model(1), {});
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImage);
  const auto batch = data.batch(0);
  const auto loss_with = [&](double dropout) {
    FlowObjectiveOptions options;
    options.camera_dropout = dropout;
    LevelObjective objective(test::small_model(), 1, options, frozen, {}, 1);
    // The last layer is zero at the start; give it something to show.
    const torch::NoGradGuard no_grad;
    auto generator = at::detail::createCPUGenerator(9);
    for (const auto& item : objective.parameters()) {
      if (item.parameter.dim() > 1) {
        torch::Tensor parameter = item.parameter;
        parameter.add_(0.05 * torch::randn(parameter.sizes(), generator, torch::kFloat32));
      }
    }
    auto draws = at::detail::createCPUGenerator(4);
    return objective.losses(batch, {0, 1, draws}).total.item<double>();
  };
  const double shown = loss_with(0.0), dropped = loss_with(1.0);
  EXPECT_NE(shown, dropped);
  EXPECT_EQ(shown, loss_with(0.0));
}

}  // namespace
}  // namespace gld
