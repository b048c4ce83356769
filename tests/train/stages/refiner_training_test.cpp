#include "gld/base/atomic_file.h"
#include "tests/models/splats/small_autoencoder.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/small_training.h"
#include "train/loop/metrics_log.h"
#include "train/stages/refiner_stage.h"

#include <filesystem>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::TemporaryFolder;
using testing::HasSubstr;

class RefinerStage : public testing::Test {
 protected:
  RefinerStage() : bundle_(test::write_small_autoencoder(folder_.path() / "bundle", false)) {
    std::filesystem::create_directory(folder_.path() / "pairs");
    for (uint64_t seed = 1; seed <= 4; ++seed) {
      const SplattedScene scene = test::half_splatted_scene(bundle_, seed);
      save_splatted_scene(folder_.path() / "pairs" / (scene.name + ".safetensors"), scene);
    }
  }
  TrainRefinerOptions options(const std::string& out) const {
    TrainRefinerOptions options;
    options.model = bundle_.folder().string();
    options.out = (folder_.path() / out).string();
    options.threads = 1;
    options.loop = test::two_steps();
    options.data.pairs = {(folder_.path() / "pairs").string()};
    options.data.validation_scenes = 1;
    options.data.batch_size = 2;
    return options;
  }
  std::vector<std::pair<double, double>> series(const std::string& run, const std::string& key) const {
    std::vector<std::pair<double, double>> points;
    for (const auto& [step, value] : MetricsLog(folder_.path() / run / "metrics.jsonl", 1000).series(key))
      points.emplace_back(static_cast<double>(step), value);
    return points;
  }
  TemporaryFolder folder_;
  ModelBundle bundle_;
};

TEST_F(RefinerStage, LearnsToGiveBackWhatSplattingLost) {
  auto training = options("run");
  training.loop.steps = training.loop.validate_every = 100;
  training.loop.learning_rate.peak = 3e-3;
  training.loop.optimiser.ema_decay = 0.5;
  train_refiner(training, {});
  const double lost = series("run", "validation_degraded_latent_error").back().second;
  EXPECT_GT(lost, 0.4);
  EXPECT_LT(series("run", "validation_latent_error").back().second, 0.75 * lost);
  EXPECT_GT(series("run", "picture").front().second, 0);
  EXPECT_GT(series("run", "perceptual").front().second, 0);
  const auto trained = ModelBundle::open(folder_.path() / "run/model");
  EXPECT_TRUE(trained.has(BundlePart::refiner()));
  EXPECT_EQ(read_file(trained.file(BundlePart::backbone())), read_file(bundle_.file(BundlePart::backbone())));
}

TEST_F(RefinerStage, RepairsColoursThatAreEncodedWhereTheModelSaysSo) {
  auto training = options("splatted");
  training.loop.learning_rate.peak = training.loop.learning_rate.final = 1e-9;
  train_refiner(training, {});
  test::repair_colours(bundle_);
  training.out = (folder_.path() / "colours").string();
  train_refiner(training, {});
  const auto given = [&](const char* run) {
    return series(run, "validation_degraded_latent_error").back().second;
  };
  // Half of the encoded latents is twice as far away as three quarters of them.
  EXPECT_NEAR(given("splatted") / given("colours"), 2, 0.02);
  EXPECT_NEAR(series("colours", "validation_latent_error").back().second, given("colours"), 1e-3);
}

TEST_F(RefinerStage, FirstLearnsToSeeThroughNoise) {
  auto training = options("run");
  training.loop.steps = 5;
  training.objective.denoising_steps = 2;
  training.objective.latent_steps = 2;
  train_refiner(training, {});
  EXPECT_EQ(series("run", "noise").size(), 2U);
  EXPECT_EQ(series("run", "latent").size(), 3U);
  EXPECT_EQ(series("run", "picture").size(), 1U);
  EXPECT_EQ(series("run", "perceptual").size(), 1U);
  // An untrained network predicts no noise at all, whose mean square is 1.
  EXPECT_NEAR(series("run", "noise").front().second, 1, 0.4);
}

TEST_F(RefinerStage, PriorTellsNoiseFromLatents) {
  auto training = options("run");
  training.loop.steps = training.objective.denoising_steps = 100;
  training.loop.validate_every = 50;
  training.loop.learning_rate.peak = 3e-3;
  training.loop.optimiser.ema_decay = 0.5;
  train_refiner(training, {});
  // Whoever takes nothing for noise is wrong by its variance, 1.
  const auto errors = series("run", "validation_denoising_error");
  EXPECT_LT(errors.front().second, 1);
  EXPECT_LT(errors.back().second, 0.9 * errors.front().second);
}

TEST_F(RefinerStage, StepsInOneCallEqualStepsInSeveral) {
  auto whole = options("whole");
  whole.objective.denoising_steps = 1;
  train_refiner(whole, {});
  auto first = options("parts");
  first.objective.denoising_steps = 1;
  first.loop.steps = 1;
  train_refiner(first, {});
  auto second = options("parts");
  second.objective.denoising_steps = 1;
  second.resume = true;
  train_refiner(second, {});
  EXPECT_EQ(read_file(folder_.path() / "whole/model/refiner.safetensors"),
            read_file(folder_.path() / "parts/model/refiner.safetensors"));
}

TEST_F(RefinerStage, AValidatedSceneIsNotTrainedOnInAnotherFolderEither) {
  std::filesystem::create_directory(folder_.path() / "again");
  for (uint64_t seed = 1; seed <= 2; ++seed) {
    const SplattedScene scene = test::half_splatted_scene(bundle_, seed);
    save_splatted_scene(folder_.path() / "again" / (scene.name + ".safetensors"), scene);
  }
  SplatPairOptions data = options("run").data;
  data.validation_pairs = (folder_.path() / "again").string();
  data.validation_scenes = 2;
  data.batch_size = 32;
  const SplatPairBatches pairs(data, bundle_.options().refiner, bundle_);
  ASSERT_EQ(pairs.validation().size(), 2U);
  for (const TrainingScene& scene : pairs.batch(0).scenes)
    EXPECT_THAT(scene.name, testing::AnyOf("scene_3", "scene_4"));
}

TEST_F(RefinerStage, GoesOnWithTrainedWeightsAndComparesWithPhotographs) {
  auto first = options("first");
  train_refiner(first, {});
  auto second = options("second");
  second.model = (folder_.path() / "first/model").string();
  second.objective.start = ModelStart::kBundle;
  second.objective.truth = RefinerTruth::kPhotograph;
  second.loop.learning_rate.peak = second.loop.learning_rate.final = 1e-9;
  train_refiner(second, {});
  const auto weights = [&](const char* run) {
    return ModelBundle::open(folder_.path() / run / "model").load_refiner()->parameters().front();
  };
  EXPECT_LT((weights("first") - weights("second")).abs().max().item<double>(), 1e-6);
  // The autoencoder's own pictures are another truth than the photographs.
  EXPECT_NE(series("first", "picture").front().second, series("second", "picture").front().second);
}

TEST_F(RefinerStage, SaysWhatItLacks) {
  auto late = options("run");
  late.objective.denoising_steps = 1;
  late.objective.latent_steps = 1;
  EXPECT_EQ(
      error_of([&] { late.check(); }),
      "--objective.latent-steps: expected with --objective.denoising-steps 1 fewer than the 2 steps of the "
      "training, behind which decoded pictures count, found 1; lower it, or set --objective.picture-weight "
      "and --objective.perceptual.weight to 0.");
  late.objective.picture_weight = late.objective.perceptual.weight = 0;
  EXPECT_NO_THROW(late.check());
  auto training = options("run");
  training.data.validation_scenes = 4;
  EXPECT_THAT(
      error_of([&] { train_refiner(training, {}); }),
      HasSubstr("--pairs: expected scenes of other names than those that are validated on, found none"));
  training = options("run");
  training.data.pairs = {};
  EXPECT_THAT(error_of([&] { training.check(); }),
              HasSubstr("--pairs: expected a folder of splatted scenes"));
  BundleOptions many = test::small_autoencoder_model();
  many.refiner.references = 5;
  write_random_bundle(folder_.path() / "many", many, 5);
  std::filesystem::copy_file(bundle_.file(BundlePart::backbone()),
                             folder_.path() / "many/backbone.safetensors",
                             std::filesystem::copy_options::overwrite_existing);
  training = options("run");
  training.model = (folder_.path() / "many").string();
  EXPECT_THAT(error_of([&] { train_refiner(training, {}); }),
              HasSubstr("expected at least 5 fitted views, the refiner's references, found 4"));
  write_random_bundle(folder_.path() / "without", test::small_model(), 5);
  training.model = (folder_.path() / "without").string();
  EXPECT_THAT(error_of([&] { train_refiner(training, {}); }), HasSubstr("expected a refiner, found none"));
  BundleOptions of_samples = bundle_.options();
  of_samples.refiner.degraded = DegradedLatents::kGenerated;
  of_samples.refiner.latent_channels =
      static_cast<int64_t>(of_samples.generators.size()) * of_samples.backbone.level_channels();
  save_bundle_options(folder_.path() / "of_samples", of_samples);
  training.model = (folder_.path() / "of_samples").string();
  EXPECT_THAT(error_of([&] { train_refiner(training, {}); }),
              HasSubstr("found one of samples; train it with gld train sample-refiner"));
}

}  // namespace
}  // namespace gld
