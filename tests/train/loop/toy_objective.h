#pragma once

#include "gld/base/atomic_file.h"
#include "train/data/batch_prefetcher.h"
#include "train/loop/checkpoint.h"
#include "train/loop/objective.h"
#include "train/loop/training_loop.h"

#include <chrono>
#include <cmath>
#include <filesystem>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld::test {

// A 6 x 3 matrix that learns to map the mean colour of a scene to six fixed numbers, with noise from the run's
// generator, so that every part of the state matters for the next step.
class ToyObjective : public Objective {
 public:
  ToyObjective() : weight_(torch::full({6, 3}, 0.1F)), counter_(torch::zeros({1}, torch::kInt64)) {}

  std::string kind() const override { return "toy"; }
  torch::Device device() const override { return torch::kCPU; }
  bool concurrent() const override { return true; }
  int64_t learn_in(ComputePrecision /*precision*/) override { return 0; }
  std::vector<NamedParameter> parameters() const override { return {{"weight", weight_}}; }
  std::vector<NamedParameter> untrained() const override { return {{"target", target_}}; }
  Losses losses(const TrainingBatch& batch, const StepContext& context) override {
    if (context.step == slow_step) {
      counter_.add_(100);  // what a step that is half done leaves behind
      std::this_thread::sleep_for(std::chrono::seconds(20));
    }
    torch::Tensor total = torch::zeros({});
    // A finite 0 whose gradient is not: the root's slope at 0 times 0.
    if (batch.index >= first_steep) total = total + (0 * weight_).abs().sqrt().sum();
    for (const TrainingScene& scene : batch.scenes) {
      const auto colour = scene.images.mean({0, 2, 3});
      const auto noise = torch::randn({3}, context.generator, torch::kFloat32);
      const auto error = torch::mv(weight_, colour + 0.1 * noise) - target_;
      total = total + error.square().mean() * static_cast<double>(spoil(batch.index));
    }
    return {total, {{"error", total.detach()}}};
  }
  std::vector<std::pair<std::string, double>> after_step(const StepContext& /*context*/) override {
    counter_.add_(1);
    return {};
  }
  Validation validate(const std::vector<TrainingScene>& scenes) override {
    Validation validation;
    validation.values = {
        {"error", torch::mv(weight_, scenes.front().images.mean({0, 2, 3})).norm().item<double>()}};
    return validation;
  }
  std::map<std::string, torch::Tensor> state() const override { return {{"counter", counter_}}; }
  void load_state(const std::map<std::string, torch::Tensor>& state, const std::string& /*where*/) override {
    counter_.copy_(state.at("counter"));
  }
  void export_model(const std::filesystem::path& folder, DType /*dtype*/) const override {
    write_file_atomically(folder / "weight.txt", c10::str(weight_));
  }

  // Batches [first, last) give a loss that is not a number.
  int64_t first_spoiled = 0;
  int64_t last_spoiled = 0;
  // Batches from this one on have a gradient that is not a number.
  int64_t first_steep = std::numeric_limits<int64_t>::max();
  // What was drawn otherwise than in the run that a checkpoint is of.
  void draw_other_target() { target_.fill_(-1); }

  int64_t slow_step = -1;  // takes 20 s a micro-batch

 private:
  float spoil(int64_t index) const {
    return index >= first_spoiled && index < last_spoiled ? std::numeric_limits<float>::quiet_NaN() : 1.0F;
  }
  torch::Tensor weight_;
  torch::Tensor target_ = torch::arange(6.0F);
  torch::Tensor counter_;
};

// Scenes of random colours that depend on the index only.
class ToySource : public TrainingBatchSource {
 public:
  TrainingBatch batch(int64_t index) const override {
    TrainingScene scene;
    scene.name = "toy";
    Camera camera;
    camera.width = camera.height = 4;
    scene.views.cameras = {camera, camera};
    scene.views.num_sources = 1;
    scene.images = torch::empty({2, 3, 4, 4});
    for (int64_t i = 0; i < scene.images.numel(); ++i) {
      scene.images.view({-1})[i] =
          static_cast<float>(0.5 + 0.5 * std::sin(static_cast<double>(7 * index + i)));
    }
    return {index, {scene}};
  }
};

inline TrainingRun toy_run(const std::filesystem::path& folder, ToyObjective& objective) {
  TrainingRun run;
  run.folder = folder;
  run.objective = &objective;
  run.data = std::make_shared<ToySource>();
  run.validation_scenes = ToySource().batch(1000).scenes;
  return run;
}

// A run of the toy of 24 steps, with checkpoints every five and validations every eight.
inline TrainingLoopOptions short_run() {
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

inline std::map<std::string, torch::Tensor> tensors_of_newest(const std::filesystem::path& folder) {
  auto found = CheckpointFolder(folder / "checkpoints", {}).newest();
  return found->checkpoint.tensors;
}

inline void expect_same_bytes(const std::map<std::string, torch::Tensor>& a,
                              const std::map<std::string, torch::Tensor>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (const auto& [name, tensor] : a) {
    ASSERT_EQ(b.count(name), 1U) << name;
    EXPECT_TRUE(torch::equal(tensor, b.at(name))) << name;
  }
}

}  // namespace gld::test
