#include "train/loop/training_loop.h"

#include "gld/base/atomic_file.h"
#include "gld/tensors/weight_tensors.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/loop/toy_objective.h"
#include "train/loop/checkpoint.h"
#include "train/loop/metrics_log.h"

#include <chrono>
#include <csignal>
#include <thread>

#include <torch/types.h>

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

namespace gld {
namespace {

TrainingLoopOptions short_run() {
  TrainingLoopOptions options;
  options.steps = 24;
  options.micro_batches = 2;
  options.seed = 5;
  options.log_every = 4;
  options.checkpoint_every = 5;
  options.validate_every = 8;
  options.stop_after_non_finite = 3;
  options.learning_rate.schedule = LearningRateSchedule::kCosine;
  options.learning_rate.peak = 0.05;
  options.learning_rate.warmup_steps = 3;
  options.optimiser.ema_decay = 0.8;
  return options;
}

std::map<std::string, torch::Tensor> tensors_of_newest(const std::filesystem::path& folder) {
  auto found = CheckpointFolder(folder / "checkpoints", {}).newest();
  return found->checkpoint.tensors;
}

void expect_same_bytes(const std::map<std::string, torch::Tensor>& a,
                       const std::map<std::string, torch::Tensor>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (const auto& [name, tensor] : a) {
    ASSERT_EQ(b.count(name), 1U) << name;
    EXPECT_TRUE(torch::equal(tensor, b.at(name))) << name;
  }
}

TEST(TrainingLoop, StepsInOneCallEqualStepsInSeveral) {
  const test::TemporaryFolder whole, parts;
  test::ToyObjective first;
  const auto summary = train(test::toy_run(whole.path(), first), short_run(), TrainingStart::kFresh);
  EXPECT_EQ(summary.steps_done, 24);
  EXPECT_EQ(summary.skipped_steps, 0);

  // The length of the run is part of the learning rate, so the first part is cut off by removing checkpoints.
  test::ToyObjective second;
  train(test::toy_run(parts.path(), second), short_run(), TrainingStart::kFresh);
  for (const char* late : {"step_000000024.safetensors", "step_000000020.safetensors"}) {
    EXPECT_TRUE(std::filesystem::remove(parts.path() / "checkpoints" / late));
  }
  test::ToyObjective third;
  const auto resumed = train(test::toy_run(parts.path(), third), short_run(), TrainingStart::kResume);
  EXPECT_EQ(resumed.steps_this_call, 9);
  expect_same_bytes(tensors_of_newest(whole.path()), tensors_of_newest(parts.path()));
  EXPECT_EQ(read_file(whole.path() / "model" / "weight.txt"),
            read_file(parts.path() / "model" / "weight.txt"));
}

TEST(TrainingLoop, TheNumberOfLoaderThreadsChangesNothing) {
  const test::TemporaryFolder one, four;
  test::ToyObjective first, second;
  auto options = short_run();
  train(test::toy_run(one.path(), first), options, TrainingStart::kFresh);
  options.loader_threads = 4;
  train(test::toy_run(four.path(), second), options, TrainingStart::kFresh);
  expect_same_bytes(tensors_of_newest(one.path()), tensors_of_newest(four.path()));
}

TEST(TrainingLoop, WorkersGiveTheSameBytesWhateverTheirTiming) {
  auto options = short_run();
  options.micro_batches = 5;
  std::map<std::string, torch::Tensor> first, alone;
  for (int repeat = 0; repeat < 3; ++repeat) {
    const test::TemporaryFolder folder;
    test::ToyObjective objective;
    options.workers = repeat == 2 ? 1 : 3;
    train(test::toy_run(folder.path(), objective), options, TrainingStart::kFresh);
    auto tensors = tensors_of_newest(folder.path());
    for (auto& item : tensors) item.second = item.second.clone();
    if (repeat == 0) first = tensors;
    if (repeat == 1) expect_same_bytes(first, tensors);
    if (repeat == 2) alone = tensors;
  }
  EXPECT_LT((first.at("model.weight") - alone.at("model.weight")).abs().max().item<float>(), 1e-5F);
}

TEST(TrainingLoop, LogsEveryNumberThatARunIsJudgedBy) {
  const test::TemporaryFolder folder;
  test::ToyObjective objective;
  train(test::toy_run(folder.path(), objective), short_run(), TrainingStart::kFresh);
  const MetricsLog log(folder.path() / "metrics.jsonl", 24);
  EXPECT_EQ(log.series("loss").size(), 6U);
  EXPECT_EQ(log.series("validation_error").size(), 3U);
  for (const char* key :
       {"learning_rate", "samples_per_second", "data_wait_fraction", "gradient_norm", "error"}) {
    EXPECT_EQ(log.series(key).size(), 6U) << key;
  }
  EXPECT_LT(log.series("loss").back().second, log.series("loss").front().second);
  EXPECT_TRUE(std::filesystem::exists(folder.path() / "checkpoints" / "best.safetensors"));
}

TEST(TrainingLoop, KeepsTheNewestCheckpoints) {
  const test::TemporaryFolder folder;
  test::ToyObjective objective;
  auto options = short_run();
  options.keep_last = 2;
  train(test::toy_run(folder.path(), objective), options, TrainingStart::kFresh);
  EXPECT_EQ(CheckpointFolder(folder.path() / "checkpoints", {}).steps(), (std::vector<int64_t>{20, 24}));
}

TEST(TrainingLoop, SkipsAStepThatIsNotFinite) {
  const test::TemporaryFolder folder;
  test::ToyObjective objective;
  objective.first_spoiled = 9;  // steps 4 and 5 of two micro-batches each
  objective.last_spoiled = 11;
  const auto summary = train(test::toy_run(folder.path(), objective), short_run(), TrainingStart::kFresh);
  EXPECT_EQ(summary.skipped_steps, 2);
  EXPECT_EQ(tensors_of_newest(folder.path()).at("optimiser.steps").item<int64_t>(), 22);
  EXPECT_TRUE(torch::isfinite(tensors_of_newest(folder.path()).at("model.weight")).all().item<bool>());
}

TEST(TrainingLoop, StopsAfterTooManyStepsThatAreNotFinite) {
  const test::TemporaryFolder folder;
  test::ToyObjective objective;
  objective.first_spoiled = 12;
  objective.last_spoiled = 1000;
  const auto run = test::toy_run(folder.path(), objective);
  EXPECT_EQ(test::error_of([&] { train(run, short_run(), TrainingStart::kFresh); }),
            "training step 8: expected finite losses and gradients, "
            "found a loss of nan (3 skipped steps in a row); look at the batch in " +
                (folder.path() / "non_finite" / "batch.safetensors").string() +
                ", or lower the learning rate with --resume --may-change loop.learning_rate.peak.");
  const auto batch = WeightFile::open(folder.path() / "non_finite" / "batch.safetensors");
  EXPECT_NE(batch->find("scene0.images"), nullptr);
  EXPECT_NE(batch->find("scene0.world_from_camera"), nullptr);
  EXPECT_EQ(batch->metadata().at("batch_index"), "16");
}

TEST(TrainingLoop, RefusesToResumeFromNothingAndToStartOverARun) {
  const test::TemporaryFolder folder;
  test::ToyObjective objective;
  const auto run = test::toy_run(folder.path(), objective);
  EXPECT_EQ(test::error_of([&] { train(run, short_run(), TrainingStart::kResume); }),
            folder.path().string() + ": expected a checkpoint to resume from, found none in " +
                (folder.path() / "checkpoints").string() + "; start the run without --resume.");
  train(run, short_run(), TrainingStart::kFresh);
  EXPECT_EQ(test::error_of([&] { train(run, short_run(), TrainingStart::kFresh); }),
            folder.path().string() +
                ": expected a folder without checkpoints, found a run at step 24; "
                "continue it with --resume or choose another --out.");
}

TEST(TrainingLoop, RefusesBFloat16WhereItWouldBeSlow) {
  const test::TemporaryFolder folder;
  test::ToyObjective objective;
  auto options = short_run();
  options.precision = Precision::kBFloat16;
  EXPECT_EQ(
      test::error_of([&] { train(test::toy_run(folder.path(), objective), options, TrainingStart::kFresh); }),
      "precision: expected a device with bfloat16 units, found cpu; set precision: "
      "float32 or train on a GPU.");
}

TEST(TrainingLoop, PassesOverATornCheckpoint) {
  const test::TemporaryFolder folder;
  test::ToyObjective objective;
  train(test::toy_run(folder.path(), objective), short_run(), TrainingStart::kFresh);
  const auto newest = folder.path() / "checkpoints" / "step_000000024.safetensors";
  std::filesystem::resize_file(newest, std::filesystem::file_size(newest) - 100);
  test::ToyObjective second;
  const auto summary = train(test::toy_run(folder.path(), second), short_run(), TrainingStart::kResume);
  EXPECT_EQ(summary.steps_this_call, 4);
  ASSERT_EQ(summary.messages.size(), 1U);
  EXPECT_EQ(summary.messages[0].rfind("passed over " + newest.string(), 0), 0U);
}

TEST(Checkpoint, DetectsBytesThatNeverReachedTheDisk) {
  const test::TemporaryFolder folder;
  Checkpoint checkpoint;
  checkpoint.step = 3;
  checkpoint.tensors["a"] = torch::arange(5000.0F);
  const auto file = folder.path() / "step.safetensors";
  save_checkpoint(file, checkpoint);
  EXPECT_EQ(load_checkpoint(file).step, 3);
  auto bytes = read_file(file);
  std::fill(bytes.end() - 4096, bytes.end(), '\0');
  write_file_atomically(file, bytes);
  EXPECT_EQ(test::error_of([&] { load_checkpoint(file); }),
            file.string() +
                ": expected tensors that match the checksum, found changed or missing data; "
                "use an older checkpoint.");
  save_safetensors(file, checkpoint.tensors);
  EXPECT_EQ(test::error_of([&] { load_checkpoint(file); }),
            file.string() +
                ": expected a training checkpoint, found a weight file of another kind; "
                "name the checkpoints folder of a gld train run.");
}

// Kills a run with SIGKILL after different times; whatever moment that is, the run continues and ends with the
// bytes of a run that was never killed.
TEST(TrainingLoop, SurvivesKillAtAnyMoment) {
  auto options = short_run();
  options.steps = 400;
  options.checkpoint_every = 1;
  options.validate_every = 50;
  const test::TemporaryFolder reference;
  {
    test::ToyObjective objective;
    train(test::toy_run(reference.path(), objective), options, TrainingStart::kFresh);
  }
  const test::TemporaryFolder killed;
  int kills = 0;
  for (int attempt = 0; attempt < 6; ++attempt) {
    const bool resume = !CheckpointFolder(killed.path() / "checkpoints", {}).steps().empty();
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      test::ToyObjective objective;
      train(test::toy_run(killed.path(), objective), options,
            resume ? TrainingStart::kResume : TrainingStart::kFresh);
      _exit(0);
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(20 + 37 * attempt));
    kill(child, SIGKILL);
    int status = 0;
    waitpid(child, &status, 0);
    if (WIFSIGNALED(status)) ++kills;
    for (const int64_t step : CheckpointFolder(killed.path() / "checkpoints", {}).steps()) {
      char name[40];
      std::snprintf(name, sizeof(name), "step_%09lld.safetensors", static_cast<long long>(step));
      EXPECT_EQ(load_checkpoint(killed.path() / "checkpoints" / name).step, step);
    }
  }
  EXPECT_GT(kills, 0);
  test::ToyObjective objective;
  const bool resume = !CheckpointFolder(killed.path() / "checkpoints", {}).steps().empty();
  train(test::toy_run(killed.path(), objective), options,
        resume ? TrainingStart::kResume : TrainingStart::kFresh);
  expect_same_bytes(tensors_of_newest(reference.path()), tensors_of_newest(killed.path()));
}

}  // namespace
}  // namespace gld
