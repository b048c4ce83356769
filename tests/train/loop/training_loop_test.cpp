#include "train/loop/training_loop.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/tensors/weight_tensors.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/loop/toy_objective.h"
#include "train/loop/checkpoint.h"
#include "train/loop/metrics_log.h"

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <sstream>
#include <thread>
#include <utility>
#include <vector>

#include <torch/types.h>

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

namespace gld {
namespace {

using test::expect_same_bytes;
using test::short_run;
using test::tensors_of_newest;

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
  TrainingRun run = test::toy_run(folder.path(), objective);
  int64_t followed = 0;  // also where no line is written
  run.on_step = [&] { ++followed; };
  train(run, short_run(), TrainingStart::kFresh);
  EXPECT_EQ(followed, 24);
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

// A second Ctrl-C, or one that waits too long, ends a run in the midst of a validation: its step is kept.
TEST(TrainingLoop, MakesUpForAValidationThatAStopEnded) {
  const test::TemporaryFolder whole, stopped;
  auto options = short_run();
  test::ToyObjective objective;
  train(test::toy_run(whole.path(), objective), options, TrainingStart::kFresh);
  options.steps = 8;
  options.learning_rate.decay_end_step = 24;
  {
    test::ToyObjective begun;
    train(test::toy_run(stopped.path(), begun), options, TrainingStart::kFresh);
  }
  const auto file = stopped.path() / "metrics.jsonl";
  std::istringstream text(read_file(file));
  std::string kept;
  for (std::string line; std::getline(text, line);) {
    if (line.find("validation_") == std::string::npos) kept += line + "\n";
  }
  ASSERT_NE(kept, read_file(file));
  write_file_atomically(file, kept);
  options.steps = 24;
  test::ToyObjective resumed;
  train(test::toy_run(stopped.path(), resumed), options, TrainingStart::kResume);
  const MetricsLog expected(whole.path() / "metrics.jsonl", 24), log(file, 24);
  EXPECT_EQ(log.series("validation_error"), expected.series("validation_error"));
  // Nothing is left to train, and what was measured at its end is known still.
  test::ToyObjective ended;
  const auto summary = train(test::toy_run(stopped.path(), ended), options, TrainingStart::kResume);
  ASSERT_EQ(summary.validation.size(), 1U);
  EXPECT_EQ(summary.validation[0].second, expected.series("validation_error").back().second);
  EXPECT_EQ(MetricsLog(file, 24).series("validation_error").size(), 3U);
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
                (folder.path() / "non_finite" / "batch_16.safetensors").string() +
                ", or lower the learning rate with --resume --may-change loop.learning_rate.peak.");
  const auto batch = WeightFile::open(folder.path() / "non_finite" / "batch_16.safetensors");
  EXPECT_NE(batch->find("scene0.images"), nullptr);
  EXPECT_NE(batch->find("scene0.world_from_camera"), nullptr);
  EXPECT_EQ(batch->metadata().at("batch_index"), "16");
}

TEST(TrainingLoop, KeepsEveryBatchOfAStepWhoseGradientIsNotFinite) {
  const test::TemporaryFolder folder;
  test::ToyObjective objective;
  objective.first_steep = 12;
  const auto run = test::toy_run(folder.path(), objective);
  EXPECT_EQ(
      test::error_of([&] { train(run, short_run(), TrainingStart::kFresh); }),
      "training step 8: expected finite losses and gradients, "
      "found a gradient norm of nan (3 skipped steps in a row); look at the step's 2 batches from batch_16.safetensors on in " +
          (folder.path() / "non_finite").string() +
          ", or lower the learning rate with --resume --may-change loop.learning_rate.peak.");
  for (const char* name : {"batch_16.safetensors", "batch_17.safetensors"})
    EXPECT_NE(WeightFile::open(folder.path() / "non_finite" / name)->find("scene0.images"), nullptr) << name;
}

TEST(TrainingLoop, GoesOnWithTheUntrainedTensorsThatWereLearntWith) {
  const test::TemporaryFolder whole, stopped;
  test::ToyObjective once, begun, resumed;
  train(test::toy_run(whole.path(), once), short_run(), TrainingStart::kFresh);
  auto half = short_run();
  half.steps = 10;
  half.learning_rate.decay_end_step = short_run().steps;
  auto other_half = short_run();
  other_half.learning_rate.decay_end_step = other_half.steps;
  train(test::toy_run(stopped.path(), begun), half, TrainingStart::kFresh);
  resumed.draw_other_target();
  train(test::toy_run(stopped.path(), resumed), other_half, TrainingStart::kResume);
  EXPECT_TRUE(torch::equal(tensors_of_newest(whole.path()).at("model.weight"),
                           tensors_of_newest(stopped.path()).at("model.weight")));
}

TEST(TrainingLoop, GoesOnBesideTheSamePartsAlone) {
  const test::TemporaryFolder folder;
  test::ToyObjective begun, resumed;
  auto run = test::toy_run(folder.path(), begun);
  run.trained_on = {{"backbone", "12"}, {"statistics_level1", "34"}};
  auto half = short_run();
  half.steps = 10;
  train(run, half, TrainingStart::kFresh);
  run.objective = &resumed;
  run.trained_on["statistics_level1"] = "56";
  EXPECT_EQ(
      test::error_of([&] { train(run, short_run(), TrainingStart::kResume); }),
      "--resume: expected the statistics_level1 that " +
          (folder.path() / "checkpoints" / "step_000000010.safetensors").string() +
          " was trained on, found another statistics_level1 in --model; give the model that the run was begun "
          "with, or go on beside another one with --allow-mixed.");
  run.allow_other_parts = true;
  EXPECT_EQ(train(run, short_run(), TrainingStart::kResume).steps_done, 24);
}

TEST(TrainingLoop, RefusesToResumeFromNothingAndToStartOverARun) {
  const test::TemporaryFolder folder;
  test::ToyObjective objective;
  const auto run = test::toy_run(folder.path(), objective);
  EXPECT_EQ(test::error_of([&] { train(run, short_run(), TrainingStart::kResume); }),
            folder.path().string() + ": expected a checkpoint to resume from, found none in " +
                (folder.path() / "checkpoints").string() +
                "; begin again, with --overwrite in the place of --resume.");
  train(run, short_run(), TrainingStart::kFresh);
  EXPECT_EQ(test::error_of([&] { train(run, short_run(), TrainingStart::kFresh); }),
            folder.path().string() +
                ": expected a folder without checkpoints, found a run at step 24; "
                "continue it with --resume, begin anew with --overwrite, or choose another --out.");
}

class ToyElsewhere : public test::ToyObjective {
 public:
  torch::Device device() const override { return torch::kMeta; }
};

TEST(TrainingLoop, RefusesAPrecisionThatTheDeviceDoesNotCompute) {
  const test::TemporaryFolder folder;
  ToyElsewhere objective;
  auto options = short_run();
  options.precision = ComputePrecision::kBFloat16;
  EXPECT_EQ(
      test::error_of([&] { train(test::toy_run(folder.path(), objective), options, TrainingStart::kFresh); }),
      "loop.precision: expected one that is computed on meta, found bfloat16; set loop.precision to float32, or to "
      "bfloat16 on CUDA.");
}

TEST(TrainingLoop, RefusesAPrecisionThatNothingFollows) {
  const test::TemporaryFolder folder;
  test::ToyObjective objective;
  auto options = short_run();
  options.precision = ComputePrecision::kBFloat16;
  EXPECT_EQ(
      test::error_of([&] { train(test::toy_run(folder.path(), objective), options, TrainingStart::kFresh); }),
      "loop.precision: expected float32: nothing that is trained here has linear layers of blocks, found bfloat16; leave "
      "it out.");
}

// A stop in the middle of a step that would take long leaves the checkpoint of the last complete one.
TEST(TrainingLoop, AStopDoesNotWaitForTheEndOfALongStep) {
  const test::TemporaryFolder whole, stopped;
  {
    test::ToyObjective objective;
    train(test::toy_run(whole.path(), objective), short_run(), TrainingStart::kFresh);
  }
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    install_interrupt_handler(StopDeadline::kSafePoint);
    test::ToyObjective objective;
    objective.slow_step = 7;
    auto run = test::toy_run(stopped.path(), objective);
    run.on_stop = [&] { write_file_atomically(stopped.path() / "told", "of the stop"); };
    train(run, short_run(), TrainingStart::kFresh);
    _exit(0);
  }
  // The step before it has been logged when the slow one runs.
  for (int waited = 0; waited < 200 && CheckpointFolder(stopped.path() / "checkpoints", {}).steps().empty();
       ++waited) {
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(1000));
  const auto asked = std::chrono::steady_clock::now();
  kill(child, SIGTERM);
  int status = 0;
  waitpid(child, &status, 0);
  EXPECT_LT(std::chrono::steady_clock::now() - asked, std::chrono::seconds(2));
  ASSERT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), kInterruptedStatus);
  EXPECT_TRUE(std::filesystem::exists(stopped.path() / "told"));
  EXPECT_EQ(CheckpointFolder(stopped.path() / "checkpoints", {}).steps().back(), 7);

  test::ToyObjective objective;
  train(test::toy_run(stopped.path(), objective), short_run(), TrainingStart::kResume);
  expect_same_bytes(tensors_of_newest(whole.path()), tensors_of_newest(stopped.path()));
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
