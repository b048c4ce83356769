#include "train/loop/training_loop.h"

#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/report/progress.h"
#include "gld/tensors/torch_version.h"
#include "gld/tensors/weight_tensors.h"
#include "train/loop/batches_of_process.h"
#include "train/loop/checkpoint.h"
#include "train/loop/checkpoint_on_stop.h"
#include "train/loop/loss_curve.h"
#include "train/loop/metrics_log.h"
#include "train/loop/resumable_checkpoint.h"
#include "train/loop/shared_optimiser.h"
#include "train/loop/training_precision.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <limits>
#include <map>
#include <optional>
#include <utility>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <fmt/format.h>

namespace gld {
namespace {

// A number that is none has no sign.
std::string four_digits(double value) { return std::isnan(value) ? "nan" : fmt::format("{:.4g}", value); }

struct StepOutcome {
  bool finite = false;
  double loss = 0.0;
  double gradient_norm = 0.0;
  std::string problem;                 // what was not finite
  std::optional<int64_t> micro_batch;  // and of which; a gradient is the sum of all
  int64_t scenes = 0;
  std::vector<std::pair<std::string, double>> parts;  // means over the micro-batches
};

// Means of the values logged between two lines.
class Averages {
 public:
  void add(const std::string& name, double value) {
    for (auto& entry : entries_) {
      if (entry.name == name) {
        entry.sum += value;
        ++entry.count;
        return;
      }
    }
    entries_.push_back({name, value, 1});
  }
  void write_into(nlohmann::ordered_json& line) const {
    for (const auto& entry : entries_) line[entry.name] = entry.sum / static_cast<double>(entry.count);
  }
  void clear() { entries_.clear(); }

 private:
  struct Entry {
    std::string name;
    double sum = 0.0;
    int64_t count = 0;
  };
  std::vector<Entry> entries_;
};

// Divides the threads of LibTorch and BLAS among workers for as long as it lives.
class DividedThreads {
 public:
  explicit DividedThreads(int64_t workers) : before_(thread_count()) {
    if (workers > 1) set_thread_count(std::max(1, before_ / static_cast<int>(workers)));
  }
  ~DividedThreads() { set_thread_count(before_); }
  DividedThreads(const DividedThreads&) = delete;
  DividedThreads& operator=(const DividedThreads&) = delete;

 private:
  int before_;
};

// Returns an undefined tensor without a moving average.
torch::Tensor average_of(const std::map<std::string, torch::Tensor>& optimiser_state) {
  const auto found = optimiser_state.find("average");
  return found == optimiser_state.end() ? torch::Tensor() : found->second;
}

// Returns the pictures, cameras and depth of a batch under names that say of which scene.
std::map<std::string, torch::Tensor> tensors_of(const TrainingBatch& batch) {
  std::map<std::string, torch::Tensor> tensors;
  for (size_t i = 0; i < batch.scenes.size(); ++i) {
    const TrainingScene& scene = batch.scenes[i];
    const std::string prefix = "scene" + std::to_string(i) + ".";
    tensors[prefix + "images"] = scene.images;
    if (scene.depth.defined()) tensors[prefix + "depth"] = scene.depth;
    if (scene.encoded.defined()) tensors[prefix + "encoded"] = scene.encoded;
    if (scene.degraded.defined()) tensors[prefix + "degraded"] = scene.degraded;
    const auto views = static_cast<int64_t>(scene.views.cameras.size());
    torch::Tensor poses = torch::zeros({views, 4, 4}, torch::kFloat64);
    torch::Tensor intrinsics = torch::zeros({views, 3, 3}, torch::kFloat64);
    for (int64_t view = 0; view < views; ++view) {
      const Camera& camera = scene.views.cameras[static_cast<size_t>(view)];
      for (int row = 0; row < 4; ++row) {
        for (int column = 0; column < 4; ++column) {
          poses[view][row][column] = camera.world_from_camera.matrix()(row, column);
          if (row < 3 && column < 3) intrinsics[view][row][column] = camera.intrinsics(row, column);
        }
      }
    }
    tensors[prefix + "world_from_camera"] = poses;
    tensors[prefix + "intrinsics"] = intrinsics;
  }
  return tensors;
}

class Session {
 public:
  Session(const TrainingRun& run, const TrainingLoopOptions& options)
      : run_(run),
        team_(run.team != nullptr ? *run.team : alone_),
        options_(options),
        objective_(*run.objective),
        parameters_(objective_.parameters()),
        optimiser_(parameters_, options.optimiser,
                   options.shard_optimiser ? OptimiserShare::kOwnPiece : OptimiserShare::kWhole, team_),
        generator_(at::detail::createCPUGenerator(static_cast<uint64_t>(options.seed))),
        checkpoints_(run.folder / "checkpoints", CheckpointFolderOptions{options.keep_last}) {}

  void restore(TrainingStart start);
  TrainingSummary run();

 private:
  // Rank 0 restores, logs, validates and writes for all.
  bool leads() const { return team_.rank() == 0; }
  bool validates_after(int64_t step) const {
    return step % options_.validate_every == 0 || step == options_.steps;
  }
  // As many as share a step; the threads of LibTorch are divided among them (DividedThreads).
  int64_t workers() const { return objective_.concurrent() ? options_.workers : 1; }
  bool computes(int64_t micro) const { return process_of_micro_batch(micro, team_.count()) == team_.rank(); }
  void check_team() const;
  void read_checkpoint(TrainingStart start);
  void take_state_of_first_process();
  void begin_feed();
  bool stop_requested() const;
  StepOutcome forward_backward();
  void count_non_finite(const StepOutcome& outcome);
  std::vector<std::filesystem::path> save_offending() const;
  void log(const StepOutcome& outcome, double rate);
  // What the optimiser keeps of all parameters (SharedOptimiser::whole_state()).
  using OptimiserState = std::map<std::string, torch::Tensor>;
  void validate(const OptimiserState& state);
  // values are the parameters', flat; they are of their own, where the moving average is in their place.
  Checkpoint snapshot(const torch::Tensor& values, const OptimiserState& state) const;
  Checkpoint snapshot(const OptimiserState& state) const { return snapshot(parameters_.values(), state); }
  // Returns the parameters' values, flat: a copy, as the moving average may take their place.
  torch::Tensor trained_values() const { return parameters_.values().detach().clone(); }
  // Does the same where the objective may change tensors of its state before its next step is complete.
  Checkpoint kept_snapshot(const torch::Tensor& values, const OptimiserState& state) const;
  // Returns what a stop writes as long as it lives; null of several processes, which stop behind a step alone.
  std::unique_ptr<CheckpointOnStop::Steady> steady_state(const torch::Tensor& values,
                                                         const OptimiserState& state) {
    return stop_ ? std::make_unique<CheckpointOnStop::Steady>(*stop_, kept_snapshot(values, state)) : nullptr;
  }
  double elapsed() const {
    return earlier_seconds_ +
           std::chrono::duration<double>(std::chrono::steady_clock::now() - begun_).count();
  }
  StepContext context() const { return {step_, options_.steps, generator_}; }

  const TrainingRun& run_;
  TeamOfOne alone_;
  ProcessTeam& team_;
  const TrainingLoopOptions& options_;
  Objective& objective_;
  FlatParameters parameters_;
  SharedOptimiser optimiser_;
  OptimiserState restored_;  // of a checkpoint, until all processes have it
  torch::Generator generator_;
  CheckpointFolder checkpoints_;
  std::optional<CheckpointOnStop> stop_;
  std::optional<MetricsLog> metrics_;
  std::unique_ptr<BatchPrefetcher> feed_;

  bool fresh_ = true;  // not gone on with from a checkpoint
  int64_t step_ = 0;
  int64_t batch_index_ = 0;
  int64_t skipped_ = 0;
  int64_t skipped_in_a_row_ = 0;
  double last_loss_ = 0.0;
  double best_ = std::numeric_limits<double>::infinity();
  double earlier_seconds_ = 0.0;
  std::chrono::steady_clock::time_point begun_ = std::chrono::steady_clock::now();
  std::vector<TrainingBatch>
      offending_;  // of the last step that was not finite, as far as this process computed it
  std::vector<std::pair<std::string, double>> validation_;
  std::vector<std::string> messages_;
};

void Session::check_team() const {
  if (team_.alone()) return;
  const int64_t processes = team_.count();
  if (options_.micro_batches < processes) {
    fail({"loop.micro_batches", "at least one for each of " + std::to_string(processes) + " processes",
          std::to_string(options_.micro_batches), "raise it, or start fewer processes"});
  }
  if (!objective_.spreads_over_processes()) {
    fail({"--processes.count", "1 for an objective with a discriminator, which learns from all of a step",
          std::to_string(processes), "train it in one process, with more threads"});
  }
}

void Session::restore(TrainingStart start) {
  fresh_ = start == TrainingStart::kFresh;
  check_team();
  if (leads()) read_checkpoint(start);
  if (!team_.alone()) take_state_of_first_process();
  if (leads()) metrics_.emplace(run_.folder / "metrics.jsonl", step_);
  begin_feed();
}

void Session::take_state_of_first_process() {
  nlohmann::json counts;
  if (leads()) counts = {step_, batch_index_, skipped_, skipped_in_a_row_};
  counts = nlohmann::json::parse(team_.gather(counts.dump()).front());
  step_ = counts.at(0).get<int64_t>();
  batch_index_ = counts.at(1).get<int64_t>();
  skipped_ = counts.at(2).get<int64_t>();
  skipped_in_a_row_ = counts.at(3).get<int64_t>();
  torch::Tensor values = parameters_.values();
  team_.broadcast(values, 0);
  auto state = restored_.empty() ? optimiser_.like_whole_state() : std::exchange(restored_, {});
  for (auto& [name, tensor] : state) team_.broadcast(tensor, 0);
  optimiser_.load_state(state, "the state of rank 0");
  auto beside = objective_.state();
  for (auto& [name, tensor] : beside) team_.broadcast(tensor, 0);
  objective_.load_state(beside, "the state of rank 0");
  for (auto& [name, tensor] : objective_.untrained()) team_.broadcast(tensor, 0);
  torch::Tensor random = generator_.get_state();
  team_.broadcast(random, 0);
  generator_.set_state(random);
}

void Session::begin_feed() {
  PrefetchOptions feed;
  feed.threads = options_.loader_threads;
  feed.ahead = 2 * std::max<int64_t>(options_.loader_threads, 1) + 1;
  feed_ = std::make_unique<BatchPrefetcher>(
      std::make_shared<BatchesOfProcess>(run_.data, team_, batch_index_, options_.micro_batches), feed);
}

void Session::read_checkpoint(TrainingStart start) {
  check_training_start(run_.folder, start);
  const auto check = [this](const Checkpoint& checkpoint, const std::string& where) {
    check_resumable(checkpoint, snapshot(optimiser_.like_whole_state()), objective_.kind(), where);
    if (run_.model != nullptr)
      check_same_model(checkpoint, *run_.model, run_.model_defaults, run_.may_change, where);
    if (!run_.allow_other_parts) check_same_parts(checkpoint, run_.trained_on, where);
  };
  const auto found = start == TrainingStart::kResume ? checkpoints_.newest(check) : std::nullopt;
  if (found) {
    for (const std::string& damaged : found->damaged) messages_.push_back("passed over " + damaged);
    const Checkpoint& checkpoint = found->checkpoint;
    const std::string where = found->file.string();
    OptimiserState optimiser_state;
    std::map<std::string, torch::Tensor> objective_state;
    const torch::NoGradGuard no_grad;
    for (const auto& [name, tensor] : checkpoint.tensors) {
      if (name.rfind("optimiser.", 0) == 0) optimiser_state[name.substr(10)] = tensor;
      if (name.rfind("objective.", 0) == 0) objective_state[name.substr(10)] = tensor;
    }
    torch::Tensor average =
        optimiser_.has_average() ? torch::zeros_like(parameters_.values()) : torch::Tensor();
    for (size_t i = 0; i < parameters_.parameters().size(); ++i) {
      const NamedParameter& item = parameters_.parameters()[i];
      const auto take = [&](const std::string& prefix, const torch::Tensor& flat) {
        torch::Tensor target = parameters_.part(flat, i);
        target.copy_(checkpoint.tensors.at(prefix + item.name));
      };
      take("model.", parameters_.values());
      if (average.defined()) take("ema.", average);
    }
    for (auto& [name, tensor] : objective_.untrained()) {
      const auto kept = checkpoint.tensors.find(kUntrainedTensors + name);
      if (kept != checkpoint.tensors.end()) tensor.copy_(kept->second);
    }
    if (average.defined()) optimiser_state["average"] = average;
    optimiser_.load_state(optimiser_state, where);
    if (!team_.alone()) restored_ = std::move(optimiser_state);
    objective_.load_state(objective_state, where);
    generator_.set_state(checkpoint.tensors.at("random.cpu").clone());
    step_ = checkpoint.step;
    batch_index_ = checkpoint.metadata.at("batch_index").get<int64_t>();
    skipped_ = checkpoint.metadata.at("skipped_steps").get<int64_t>();
    skipped_in_a_row_ = checkpoint.metadata.at("skipped_in_a_row").get<int64_t>();
    last_loss_ = checkpoint.metadata.at("loss").get<double>();
    earlier_seconds_ = checkpoint.metadata.at("seconds").get<double>();
    const auto& best = checkpoint.metadata.at("best");
    if (best.is_number()) best_ = best.get<double>();
  }
}

// All stop after the same step.
bool Session::stop_requested() const {
  const auto all = team_.gather(interrupt_requested() ? "stop" : "");
  return std::find(all.begin(), all.end(), "stop") != all.end();
}

Checkpoint Session::kept_snapshot(const torch::Tensor& values, const OptimiserState& state) const {
  const torch::NoGradGuard no_grad;
  Checkpoint checkpoint = snapshot(values, state);
  for (auto& [name, tensor] : checkpoint.tensors) {
    if (name.rfind("objective.", 0) == 0) tensor = tensor.detach().clone();
  }
  return checkpoint;
}

Checkpoint Session::snapshot(const torch::Tensor& values, const OptimiserState& state) const {
  Checkpoint checkpoint;
  checkpoint.step = step_;
  checkpoint.metadata = {{"kind", objective_.kind()},
                         {"batch_index", batch_index_},
                         {"skipped_steps", skipped_},
                         {"skipped_in_a_row", skipped_in_a_row_},
                         {"loss", last_loss_},
                         {"seconds", elapsed()},
                         {"steps", options_.steps},
                         {"learning_rate", learning_rate(options_.learning_rate, step_, options_.steps)}};
  if (run_.model != nullptr) checkpoint.metadata["model"] = to_yaml(*run_.model);
  if (!run_.trained_on.empty()) checkpoint.metadata["trained_on"] = run_.trained_on;
  checkpoint.metadata["best"] = std::isfinite(best_) ? nlohmann::json(best_) : nlohmann::json();
  for (size_t i = 0; i < parameters_.parameters().size(); ++i) {
    const std::string& name = parameters_.parameters()[i].name;
    checkpoint.tensors["model." + name] = parameters_.part(values, i);
    if (optimiser_.has_average())
      checkpoint.tensors["ema." + name] = parameters_.part(state.at("average"), i);
  }
  for (const auto& [name, tensor] : state) {
    if (name != "average") checkpoint.tensors["optimiser." + name] = tensor;
  }
  for (const auto& [name, tensor] : objective_.state()) checkpoint.tensors["objective." + name] = tensor;
  for (const auto& [name, tensor] : objective_.untrained())
    checkpoint.tensors[kUntrainedTensors + name] = tensor;
  checkpoint.tensors["random.cpu"] = generator_.get_state();
  return checkpoint;
}

StepOutcome Session::forward_backward() {
  StepOutcome outcome;
  outcome.finite = true;
  parameters_.zero_gradients();
  std::vector<MicroBatch> batches;
  for (int64_t micro = 0; micro < options_.micro_batches; ++micro) {
    // Every micro-batch has random numbers of its own, so that their order in time does not matter.
    const auto seed = torch::randint(0, std::numeric_limits<int64_t>::max(), {1}, generator_, torch::kInt64);
    StepContext own = context();
    own.generator = at::detail::createCPUGenerator(static_cast<uint64_t>(seed.item<int64_t>()));
    ++batch_index_;
    if (computes(micro)) batches.push_back({feed_->next(), own});
  }
  MicroBatchWork work;
  work.precision = options_.precision;
  work.workers = workers();
  work.share = 1.0 / static_cast<double>(options_.micro_batches);
  Averages parts;
  double loss_sum = 0.0;
  const auto results = team_.alone() ? add_gradients(objective_, parameters_, batches, work)
                                     : add_gradients_of_all(team_, objective_, parameters_, batches,
                                                            options_.micro_batches, work);
  const auto processes = static_cast<size_t>(team_.count());
  for (size_t micro = 0; micro < results.size(); ++micro) {
    outcome.scenes += results[micro].scenes;
    if (!std::isfinite(results[micro].loss)) {
      if (outcome.finite) {
        outcome.micro_batch = static_cast<int64_t>(micro);
      }
      outcome.finite = false;
      outcome.problem = "a loss of " + four_digits(results[micro].loss);
      continue;
    }
    loss_sum += results[micro].loss;
    for (const auto& [name, value] : results[micro].parts) parts.add(name, value);
  }
  outcome.loss = loss_sum / static_cast<double>(options_.micro_batches);
  if (outcome.finite) {
    outcome.gradient_norm = optimiser_.gradient_norm();
    if (!std::isfinite(outcome.gradient_norm)) {
      outcome.finite = false;
      outcome.problem = "a gradient norm of " + four_digits(outcome.gradient_norm);
    }
  }
  offending_.clear();
  for (size_t own = 0; !outcome.finite && own < batches.size(); ++own) {
    const auto micro = static_cast<int64_t>(own * processes) + team_.rank();
    if (outcome.micro_batch.value_or(micro) == micro) offending_.push_back(batches[own].batch);
  }
  nlohmann::ordered_json means;
  parts.write_into(means);
  for (const auto& item : means.items()) outcome.parts.emplace_back(item.key(), item.value().get<double>());
  return outcome;
}

// Returns the files, one a micro-batch that may be the cause.
std::vector<std::filesystem::path> Session::save_offending() const {
  const auto folder = run_.folder / "non_finite";
  std::filesystem::create_directories(folder);
  std::vector<std::filesystem::path> files;
  for (const TrainingBatch& batch : offending_) {
    files.push_back(folder / fmt::format("batch_{}.safetensors", batch.index));
    save_safetensors(files.back(), tensors_of(batch),
                     {{"step", std::to_string(step_)}, {"batch_index", std::to_string(batch.index)}});
  }
  return files;
}

void Session::count_non_finite(const StepOutcome& outcome) {
  ++skipped_;
  ++skipped_in_a_row_;
  if (skipped_in_a_row_ < options_.stop_after_non_finite) return;
  const auto files = save_offending();
  const std::string look =
      files.empty()
          ? "look at what the process that computed it wrote into " + (run_.folder / "non_finite").string()
      : files.size() == 1
          ? "look at the batch in " + files.front().string()
          : fmt::format("look at the step's {} batches from {} on in {}", files.size(),
                        files.front().filename().string(), files.front().parent_path().string());
  fail({"training step " + std::to_string(step_), "finite losses and gradients",
        outcome.problem + " (" + std::to_string(skipped_in_a_row_) + " skipped steps in a row)",
        look + ", or lower the learning rate with --resume --may-change loop.learning_rate.peak"});
}

void Session::validate(const OptimiserState& state) {
  if (run_.validation_scenes.empty()) return;
  Validation validation;
  {
    const torch::NoGradGuard no_grad;
    const auto steady = steady_state(trained_values(), state);
    const AverageInPlace average(parameters_, average_of(state));
    validation = objective_.validate(run_.validation_scenes);
  }
  validation_ = validation.values;
  nlohmann::ordered_json line = {{"step", step_}};
  for (const auto& [name, value] : validation.values) line["validation_" + name] = value;
  metrics_->append(line);
  if (run_.draw_validation && !validation.rows.empty()) {
    const auto folder = run_.folder / "validation";
    std::filesystem::create_directories(folder);
    char name[32];
    std::snprintf(name, sizeof(name), "step_%09lld", static_cast<long long>(step_));
    run_.draw_validation(validation, folder / name);
  }
  if (!validation.values.empty() && validation.values.front().second < best_) {
    best_ = validation.values.front().second;
    checkpoints_.save_best(snapshot(state));
  }
}

TrainingSummary Session::run() {
  const int64_t first_step = step_;
  // Of several processes none ends in the midst of a step, for which the others would wait.
  if (team_.alone()) stop_.emplace(checkpoints_, run_.on_stop);
  std::optional<Progress> progress;
  if (!leads()) {
    // Rank 0 speaks for all.
  } else if (first_step < options_.steps) {
    progress.emplace(
        ProgressOf{"training the " + objective_.kind(), options_.steps, first_step, run_.folder});
  } else {
    messages_.push_back(fmt::format("nothing to train: the run is at step {} of {}", step_, options_.steps));
  }
  if (options_.workers > 1 && !objective_.concurrent()) {
    messages_.push_back(fmt::format(
        "micro-batches were computed one after another, not by {} workers: recomputed activations allow no other way",
        options_.workers));
  }
  if (run_.begins_trained && fresh_) {
    const OptimiserState state = optimiser_.whole_state();
    if (leads()) validate(state);
  }
  if (!fresh_ && validates_after(step_) && (step_ > 0 || run_.begins_trained)) {
    // A stop in the midst of that validation kept the step, and no line of it.
    const OptimiserState state = optimiser_.whole_state();
    if (leads()) {
      validation_ = metrics_->values_at(step_, "validation_");
      if (validation_.empty()) validate(state);
    }
  }
  Averages averages;
  int64_t scenes = 0;
  std::string speed;  // of the last line of metrics.jsonl
  auto logged = std::chrono::steady_clock::now();
  while (step_ < options_.steps) {
    if (stop_requested()) {
      std::filesystem::path file = checkpoints_.path();
      const OptimiserState state = optimiser_.whole_state();
      if (leads()) file = checkpoints_.save(snapshot(state));
      team_.finish();
      if (leads()) draw_loss_curve(*metrics_, run_.folder / "loss");
      std::string text = stopped_text(run_.folder, step_, file);
      if (step_ > 0)
        text += fmt::format(" (with --steps {} behind it the model of this step is written)", step_);
      throw Interrupted(text);
    }
    const double rate = learning_rate(options_.learning_rate, step_, options_.steps);
    const StepOutcome outcome = [&] {
      const auto steady = stop_ ? steady_state(parameters_.values(), optimiser_.whole_state()) : nullptr;
      return forward_backward();
    }();
    scenes += outcome.scenes;
    if (outcome.finite) {
      optimiser_.step(rate, outcome.gradient_norm, workers());
      skipped_in_a_row_ = 0;
      last_loss_ = outcome.loss;
      averages.add("loss", outcome.loss);
      for (const auto& [name, value] : outcome.parts) averages.add(name, value);
      averages.add("gradient_norm", outcome.gradient_norm);
      for (const auto& [name, value] : objective_.after_step(context())) averages.add(name, value);
    } else {
      count_non_finite(outcome);
    }
    ++step_;
    const bool last = step_ == options_.steps;
    const bool validates = validates_after(step_);
    const bool saves = step_ % options_.checkpoint_every == 0 || last;
    const OptimiserState state = validates || saves ? optimiser_.whole_state() : OptimiserState();
    if (!leads()) continue;
    if (step_ % options_.log_every == 0 || last) {
      const auto now = std::chrono::steady_clock::now();
      const double seconds = std::chrono::duration<double>(now - logged).count();
      logged = now;
      const double waited = feed_->take_waited_seconds();
      nlohmann::ordered_json line = {{"step", step_}};
      averages.write_into(line);
      line["learning_rate"] = rate;
      line["samples_per_second"] = static_cast<double>(scenes) / std::max(seconds, 1e-9);
      line["data_wait_fraction"] = waited / std::max(seconds, 1e-9);
      if (!team_.alone()) {
        line["communication_fraction"] = team_.take_communication_seconds() / std::max(seconds, 1e-9);
      }
      line["skipped_steps"] = skipped_;
      line["seconds"] = elapsed();
      metrics_->append(line);
      speed = ", " + four_digits(line["samples_per_second"].get<double>()) + " scenes/s, data wait " +
              four_digits(100.0 * waited / std::max(seconds, 1e-9)) + " %";
      averages.clear();
      scenes = 0;
    }
    progress->update(step_, "loss " + four_digits(last_loss_) + ", rate " + four_digits(rate) + speed);
    if (run_.on_step) run_.on_step();
    if (validates) {
      validate(state);
      draw_loss_curve(*metrics_, run_.folder / "loss");
    }
    if (saves) checkpoints_.save(snapshot(state));
  }
  if (progress) progress->finish();
  const OptimiserState state = optimiser_.whole_state();
  if (leads()) {
    const torch::NoGradGuard no_grad;
    const auto steady = steady_state(trained_values(), state);
    const AverageInPlace average(parameters_, average_of(state));
    const auto folder = run_.folder / "model";
    std::filesystem::create_directories(folder);
    // An earlier end of this run may have left a bundle of the description that was allowed to change.
    if (!run_.may_change.empty()) std::filesystem::remove(folder / "model.yaml");
    objective_.export_model(folder, run_.export_dtype);
  }
  TrainingSummary summary;
  summary.steps_done = step_;
  summary.steps_this_call = step_ - first_step;
  summary.skipped_steps = skipped_;
  summary.seconds = elapsed();
  summary.final_loss = last_loss_;
  summary.validation = validation_;
  summary.messages = messages_;
  return summary;
}

}  // namespace

void check_training_start(const std::filesystem::path& folder, TrainingStart start) {
  const CheckpointFolder checkpoints(folder / "checkpoints", {});
  const auto steps = checkpoints.steps();
  if (start == TrainingStart::kResume && steps.empty()) {
    fail({folder.string(), "a checkpoint to resume from", "none in " + checkpoints.path().string(),
          std::filesystem::exists(folder) ? "begin again, with --overwrite in the place of --resume"
                                          : "start the run without --resume"});
  }
  if (start == TrainingStart::kFresh && !steps.empty()) {
    fail({folder.string(), "a folder without checkpoints", "a run at step " + std::to_string(steps.back()),
          "continue it with --resume, begin anew with --overwrite, or choose another --out"});
  }
}

TrainingSummary train(const TrainingRun& run, const TrainingLoopOptions& options, TrainingStart start) {
  set_training_precision(*run.objective, options.precision);
  Session session(run, options);
  session.restore(start);
  const DividedThreads threads(run.objective->concurrent() ? options.workers : 1);
  return session.run();
}

}  // namespace gld
