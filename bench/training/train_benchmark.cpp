#include "bench/training/train_benchmark.h"

#include "bench/support/benchmark_report.h"
#include "bench/support/measured_cell.h"
#include "bench/support/peak_meter.h"
#include "bench/training/repeated_scene.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/cameras/cameras_in_a_row.h"
#include "gld/machine/block_memory.h"
#include "gld/machine/precision_option.h"
#include "gld/machine/stage_record.h"
#include "gld/machine/timing.h"
#include "gld/report/plot.h"
#include "gld/report/progress.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/torch_version.h"
#include "models/bundle/bundle.h"
#include "models/cost/cost_model.h"
#include "train/loop/micro_batches.h"
#include "train/optim/optimiser.h"

#include <algorithm>
#include <memory>

#include <torch/types.h>

#include <fmt/format.h>

namespace gld {
namespace {

struct Samples {
  std::vector<double> seconds;
  int64_t peak_bytes = 0;
  int threads = 0;  // of the peak that they are compared with; 0 for none
};

// Samples a step of one variant, with scenes micro-batches at a time.
void sample(RepeatedScene& objective, FlatParameters& parameters, int64_t scenes, int64_t workers,
            PeakMeter& meter, Samples& samples) {
  samples.threads = static_cast<int>(std::max<int64_t>(thread_count(), workers));
  meter.measure(samples.threads);
  std::vector<MicroBatch> batches(static_cast<size_t>(scenes));
  MicroBatchWork work;
  work.workers = workers;
  work.share = 1.0 / static_cast<double>(scenes);
  parameters.zero_gradients();
  release_kept_blocks();
  const int64_t before = used_block_bytes();
  const double seconds = seconds_of([&] { add_gradients(objective, parameters, batches, work); });
  samples.seconds.push_back(seconds);
  samples.peak_bytes = std::max(samples.peak_bytes, most_used_block_bytes() - before);
  stop_if_interrupted("nothing was written yet");
}

TrainBenchmarkRow row_from(const std::string& name, const std::string& variant, double flop,
                           const Samples& samples) {
  TrainBenchmarkRow row;
  row.name = name;
  row.variant = variant;
  const Spread spread = spread_of(samples.seconds);
  row.seconds = spread.median;
  row.seconds_low = spread.low;
  row.seconds_high = spread.high;
  row.tflop = flop * 1e-12;
  row.threads = samples.threads;
  row.peak_bytes = samples.peak_bytes;
  return row;
}

DitOptions with_depth(DitOptions options, const std::vector<int64_t>& depth) {
  options.depth = depth;
  return options;
}

constexpr auto kReduced = ComputePrecision::kBFloat16;

// Returns the name of the row of training in bfloat16 beside one in float32; it is measured where the processor has a
// unit for it.
std::string reduced_variant(const std::string& variant) {
  return variant + "_" + compute_precision_name(kReduced);
}

// Measures full width, with activations kept and computed again in turns, and kept in bfloat16.
void measure_storage(const std::string& name, const CameraRow& size, const std::vector<int64_t>& depth,
                     int64_t repeats, PeakMeter& meter, std::vector<TrainBenchmarkRow>& rows) {
  const BundleOptions bundle;
  RepeatedScene objective(bundle, with_depth(bundle.generators.front().dit, depth), size);
  FlatParameters parameters(objective.parameters());
  Samples keep, recompute, reduced;
  for (int64_t repeat = 0; repeat < repeats; ++repeat) {
    objective.store(ActivationStorage::kKeep);
    sample(objective, parameters, 1, 1, meter, keep);
    if (has_matrix_unit(kReduced)) {
      objective.learn_in(kReduced);
      sample(objective, parameters, 1, 1, meter, reduced);
      objective.learn_in(ComputePrecision::kFloat32);
    }
    objective.store(ActivationStorage::kRecompute);
    sample(objective, parameters, 1, 1, meter, recompute);
  }
  rows.push_back(row_from(name, "keep", kForwardsAStep * objective.flop(), keep));
  rows.push_back(row_from(name, "recompute", kForwardsAStep * objective.flop(), recompute));
  if (has_matrix_unit(kReduced)) {
    rows.push_back(row_from(name, reduced_variant("keep"), kForwardsAStep * objective.flop(), reduced));
  }
}

// What a forward pass leaves for the backward pass, and the most in use during the backward pass.
struct Stored {
  double after_forward = 0;
  double peak = 0;
};

Stored measure_stored(const CameraRow& size, const std::vector<int64_t>& depth, ActivationStorage storage) {
  const BundleOptions bundle;
  RepeatedScene objective(bundle, with_depth(bundle.generators.front().dit, depth), size);
  FlatParameters parameters(objective.parameters());
  objective.store(storage);
  parameters.zero_gradients();
  release_kept_blocks();
  const int64_t before = used_block_bytes();
  const auto loss = objective.loss();
  Stored stored;
  stored.after_forward = static_cast<double>(used_block_bytes() - before);
  loss.backward();
  stored.peak = static_cast<double>(most_used_block_bytes() - before);
  return stored;
}

// Returns the same at full depth, from models of few blocks: two encoder blocks, which may share a kept input, add as
// much as the two before. The velocity decoder has its own depth.
Stored stored_at_full_depth(const CameraRow& size, ActivationStorage storage) {
  const BundleOptions bundle;
  const auto& depth = bundle.generators.front().dit.depth;
  const Stored two = measure_stored(size, {2, depth[1]}, storage),
               four = measure_stored(size, {4, depth[1]}, storage);
  const double pairs = static_cast<double>(depth[0] - 2) / 2;
  return {two.after_forward + pairs * (four.after_forward - two.after_forward),
          two.peak + pairs * (four.peak - two.peak)};
}

// Adds M1 at full depth, 8 views of 504x504, on the line through two smaller numbers of tokens. Both are more than the
// backward pass meets at a time (kTokensRecomputedAtOnce), so that what it needs for these is in the part that stays.
void extrapolate_storage(std::vector<TrainBenchmarkRow>& rows) {
  const BundleOptions bundle;
  const CameraRow fewer = {4, 2, {252, 252}}, more = {6, 3, {252, 252}}, full = {8, 4, {504, 504}};
  const auto tokens = [&](const CameraRow& size) {
    return static_cast<double>(
        size.views *
        bundle.backbone.grid_of(size.views, size.image.height, size.image.width).tokens_per_view());
  };
  const double share = (tokens(full) - tokens(fewer)) / (tokens(more) - tokens(fewer));
  for (const auto storage : {ActivationStorage::kKeep, ActivationStorage::kRecompute}) {
    const Stored low = stored_at_full_depth(fewer, storage), high = stored_at_full_depth(more, storage);
    TrainBenchmarkRow row;
    const std::string suffix = storage == ActivationStorage::kKeep ? "keep" : "recompute";
    row.name = "extrapolated_504x504x8";
    row.variant = suffix + "_stored";
    row.peak_bytes =
        static_cast<int64_t>(low.after_forward + share * (high.after_forward - low.after_forward));
    rows.push_back(row);
    row.variant = suffix + "_peak";
    row.peak_bytes = static_cast<int64_t>(low.peak + share * (high.peak - low.peak));
    rows.push_back(row);
  }
}

// This sets the threads of LibTorch while it lives.
class ThreadScope {
 public:
  explicit ThreadScope(int threads) : before_(thread_count()) { set_thread_count(threads); }
  ~ThreadScope() { set_thread_count(before_); }
  ThreadScope(const ThreadScope&) = delete;
  ThreadScope& operator=(const ThreadScope&) = delete;

 private:
  int before_;
};

void measure_small(const TrainBenchmarkOptions& options, PeakMeter& meter,
                   std::vector<TrainBenchmarkRow>& rows) {
  const BundleOptions bundle = ModelBundle::open(options.small_model).options();
  const ImageSize image = image_size_from_text(bundle.trained_sizes.front(), "trained_sizes");
  RepeatedScene objective(bundle, bundle.generators.front().dit, {4, 2, image});
  FlatParameters parameters(objective.parameters());
  const int64_t workers = thread_count(), scenes = 4 * workers;
  Samples alone, parallel, reduced;
  for (int64_t repeat = 0; repeat <= options.repeats; ++repeat) {
    // The first repeat of each warms up.
    if (repeat == 1) alone = parallel = reduced = {};
    sample(objective, parameters, scenes, 1, meter, alone);
    const ThreadScope one(1);
    sample(objective, parameters, scenes, workers, meter, parallel);
    if (!has_matrix_unit(kReduced)) continue;
    objective.learn_in(kReduced);
    sample(objective, parameters, scenes, workers, meter, reduced);
    objective.learn_in(ComputePrecision::kFloat32);
  }
  const double flop = kForwardsAStep * static_cast<double>(scenes) * objective.flop();
  rows.push_back(row_from("small_model", fmt::format("{}_scenes_in_turn", scenes), flop, alone));
  const std::string by_workers = fmt::format("{}_scenes_by_{}_workers", scenes, workers);
  rows.push_back(row_from("small_model", by_workers, flop, parallel));
  if (has_matrix_unit(kReduced)) {
    rows.push_back(row_from("small_model", reduced_variant(by_workers), flop, reduced));
  }
}

double full_size_parameters() {
  const BundleOptions bundle;
  const DitDh model(bundle.generators.front().dit, {torch::kMeta});
  double count = 0;
  for (const auto& parameter : model.parameters()) count += static_cast<double>(parameter.numel());
  return count;
}

// A step is norm, clipping, AdamW and moving average.
void measure_optimiser(const TrainBenchmarkOptions& options, std::vector<TrainBenchmarkRow>& rows) {
  constexpr double kOperations = 20;  // for a parameter, about
  FlatParameters parameters({{"weight", torch::zeros({options.optimiser_parameters}).requires_grad_(true)}});
  Optimiser optimiser(parameters, OptimiserOptions{});
  torch::Tensor gradients = parameters.gradients();
  gradients.uniform_(-1e-3, 1e-3);
  Samples samples;
  const auto step = [&] { optimiser.step(1e-4, optimiser.gradient_norm()); };
  step();  // touches the memory
  for (int64_t repeat = 0; repeat < std::max<int64_t>(3, options.repeats); ++repeat) {
    samples.seconds.push_back(seconds_of(step));
  }
  const auto count = static_cast<double>(options.optimiser_parameters);
  // Values, gradients, two moments and the average.
  samples.peak_bytes = options.optimiser_parameters * 5 * static_cast<int64_t>(sizeof(float));
  rows.push_back(row_from("optimiser", "measured", kOperations * count, samples));
  const double scale = full_size_parameters() / count;
  TrainBenchmarkRow scaled = rows.back();
  scaled.variant = "scaled_to_full_size";
  for (double* value : {&scaled.seconds, &scaled.seconds_low, &scaled.seconds_high, &scaled.tflop}) {
    *value *= scale;
  }
  scaled.peak_bytes = static_cast<int64_t>(static_cast<double>(scaled.peak_bytes) * scale);
  rows.push_back(scaled);
}

const TrainBenchmarkRow& find(const std::vector<TrainBenchmarkRow>& rows, const std::string& name,
                              const std::string& variant) {
  const auto found = std::find_if(rows.begin(), rows.end(), [&](const TrainBenchmarkRow& row) {
    return row.name == name && row.variant == variant;
  });
  if (found == rows.end()) fail({"bench train", "a row " + name + ", " + variant, "none", ""});
  return *found;
}

// Returns the optimiser's part of a full-size step (8 views of 504x504) at the speed of the measured steps.
double optimiser_share(const std::vector<TrainBenchmarkRow>& rows) {
  const BundleOptions bundle;
  const auto& step = find(rows, "full_width", "keep");
  const double flop =
      kForwardsAStep * dit_cost(bundle.generators.front().dit, bundle.backbone.grid_of(8, 504, 504)).flop();
  const double seconds = flop * 1e-12 / step.tflop * step.seconds;
  const double optimiser = find(rows, "optimiser", "scaled_to_full_size").seconds;
  return optimiser / (seconds + optimiser);
}

Table overview(const std::vector<TrainBenchmarkRow>& rows) {
  Table table({"case", "variant", "seconds", "lowest", "highest", "tflop", "fraction_of_peak", "memory"});
  for (const auto& row : rows) {
    table.add_row({row.name, row.variant, if_measured(row.seconds), if_measured(row.seconds_low),
                   if_measured(row.seconds_high), if_measured(row.tflop), if_measured(row.fraction_of_peak),
                   bytes_text(row.peak_bytes)});
  }
  return table;
}

Figure train_figure(const std::vector<TrainBenchmarkRow>& rows) {
  PlotPanel panel;
  panel.title = "memory and use of the processor";
  panel.x = {"activations, GB", AxisScale::kLog};
  panel.y = {"fraction of multiply-add peak", AxisScale::kLinear, 0, 1};
  for (const auto& row : rows) {
    if (row.fraction_of_peak == 0 || row.peak_bytes == 0) continue;
    panel.series.push_back({row.name + ", " + row.variant,
                            SeriesStyle::kMarkers,
                            {{static_cast<double>(row.peak_bytes) * 1e-9, row.fraction_of_peak}}});
  }
  Figure figure;
  figure.title = "Training steps";
  figure.panels = {panel};
  return figure;
}

std::string ratio_text(const std::vector<TrainBenchmarkRow>& rows, const std::string& name) {
  const auto& keep = find(rows, name, "keep");
  const auto& recompute = find(rows, name, "recompute");
  return fmt::format("{}: {:.0f} % more time, {:.0f} % of the memory", name,
                     100 * (recompute.seconds / keep.seconds - 1),
                     100 * static_cast<double>(recompute.peak_bytes) /
                         static_cast<double>(std::max<int64_t>(1, keep.peak_bytes)));
}

}  // namespace

void TrainBenchmarkOptions::visit(FieldVisitor& visitor) {
  visit_out(visitor, out, overwrite);
  visitor.boolean(
      {"full_width", "measure the full-width model; otherwise the small one and the optimiser only"},
      full_width);
  visitor.integer({"views", "source and target views"}, views, {1, 1000});
  visitor.integer({"source_views", "source views"}, sources, {1, 1000});
  visitor.text({"size", "image size of the full-width model, width x height in pixels"}, size);
  visitor.integers({"depth", "blocks of the full-width model's encoder and decoder"}, depth, {1, 1000});
  visitor.integer({"large_views", "views of the large case; 0 leaves it out, and the memory of full depth"},
                  large_views, {0, 1000});
  visitor.text({"large_size", "image size of the large case"}, large_size);
  visitor.integers({"large_depth", "blocks of the large case's encoder and decoder"}, large_depth, {1, 1000});
  visitor.text({"small_model", "folder with the model.yaml of a small model; empty leaves it out"},
               small_model);
  visitor.integer({"optimiser_parameters", "parameters of the optimiser's measurement"}, optimiser_parameters,
                  {1000, 10'000'000'000});
  visitor.integer({"repeats", "measurements of each, of which the median counts; the large case has one"},
                  repeats, {1, 1000});
  visit_threads(visitor, threads);
}

void TrainBenchmarkOptions::check() const {
  if (sources > views) {
    fail({"--source-views", fmt::format("at most --views, {}", views), std::to_string(sources), "lower it"});
  }
  for (const auto* blocks : {&depth, &large_depth}) {
    if (blocks->size() != 2) {
      fail({"--depth", "two numbers", std::to_string(blocks->size()), "write for example --depth 5,1"});
    }
  }
  check_out(out, "runs/bench");
}

std::vector<TrainBenchmarkRow> train_benchmark_rows(const TrainBenchmarkOptions& options, PeakMeter& meter) {
  std::vector<TrainBenchmarkRow> rows;
  Progress progress("bench train", 5);
  if (options.full_width) {
    const CameraRow size = {options.views, options.sources, image_size_from_text(options.size, "--size")};
    measure_storage("full_width", size, options.depth, options.repeats, meter, rows);
    progress.update(1, "full width");
    if (options.large_views > 0) {
      const CameraRow large = {options.large_views, std::max<int64_t>(1, options.large_views / 2),
                               image_size_from_text(options.large_size, "--large-size")};
      measure_storage("large", large, options.large_depth, 1, meter, rows);
      progress.update(2, "large");
      extrapolate_storage(rows);
    }
  }
  progress.update(3, "memory");
  if (!options.small_model.empty()) measure_small(options, meter, rows);
  progress.update(4, "small model");
  measure_optimiser(options, rows);
  progress.update(5, "optimiser");
  progress.finish();
  for (auto& row : rows) {
    if (row.threads == 0 || row.seconds == 0) continue;
    const double flop = row.tflop * 1e12;
    row.fraction_of_peak = flop / row.seconds / meter.peak(row.threads);
    const std::string& reduced = compute_precision_name(kReduced);  // its unit does more than float32's peak
    if (row.variant.find(reduced) != std::string::npos) continue;
    meter.reached(row.name + ", " + row.variant, flop, row.seconds_low, row.threads);
  }
  return rows;
}

Table train_benchmark_table(const std::vector<TrainBenchmarkRow>& rows) {
  Table table({"case", "variant", "seconds", "tflop", "fraction_of_peak", "peak_bytes"});
  for (const auto& row : rows) {
    table.add_row({row.name, row.variant, if_measured(row.seconds), if_measured(row.tflop),
                   if_measured(row.fraction_of_peak), row.peak_bytes});
  }
  return table;
}

int run_train_benchmark(const TrainBenchmarkOptions& options) {
  RunFolder folder(options.out, "bench train", options, earlier_run(options.overwrite));
  use_threads(options.threads);
  PeakMeter meter;
  meter.measure_with_product();
  const auto rows = train_benchmark_rows(options, meter);
  meter.measure_with_product();
  const double multiply_add = meter.peak(thread_count()), sgemm = meter.product();
  std::string text = fmt::format(
      "# Training steps\n"
      "\n"
      "With {} threads the multiply-add peak is {:.0f} GFLOP/s and a large matrix product ({}) "
      "reaches {:.0f}. A step counts three forward passes of the cost model. "
      "Memory is what a step adds at its peak to weights and gradients. {}\n"
      "\n",
      thread_count(), multiply_add * 1e-9, blas_text(), sgemm * 1e-9,
      has_matrix_unit(kReduced)
          ? fmt::format("Rows of {} are fractions of the same float32 peak.", precision_text(kReduced))
          : "This processor has no unit for bfloat16, so that training in it was not measured.");
  double share = 0;
  if (options.full_width) {
    share = optimiser_share(rows);
    text += fmt::format(
        "M1 at full width has {}+{} blocks here, in the large case {}+{}; "
        "extrapolated rows are full depth, from models of few blocks and tokens. "
        "The optimiser takes {:.2g} % of a full-size step. Recomputing activations, {}{}.\n"
        "\n",
        options.depth[0], options.depth[1], options.large_depth[0], options.large_depth[1], 100 * share,
        ratio_text(rows, "full_width"), options.large_views > 0 ? "; " + ratio_text(rows, "large") : "");
  }
  text += overview(rows).markdown();
  BenchmarkResults results;
  results.text = text;
  results.files = {{"train.csv", train_benchmark_table(rows).csv()}, {"train.md", text}};
  results.figures = {{"train", train_figure(rows)}};
  results.report = {{"command", "bench train"},  {"options", to_json(options)},
                    {"threads", thread_count()}, {"multiply_add_peak", multiply_add},
                    {"sgemm_peak", sgemm},       {"optimiser_share", share},
                    {"blas", blas_name()}};
  results.notes = {{"cases", "train.csv"}, {"table", "train.md"}, {"plot", "train.png"}};
  return finish_measured_benchmark(folder, results, meter.problems());
}

}  // namespace gld
