#include "bench/device/device_benchmark.h"

#include "bench/support/benchmark_report.h"
#include "bench/support/measured_cell.h"
#include "bench/support/random_dit.h"
#include "bench/support/relative_rms.h"
#include "bench/training/repeated_scene.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/machine/precision_option.h"
#include "gld/machine/stage_record.h"
#include "gld/machine/timing.h"
#include "gld/report/progress.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/device.h"
#include "gld/tensors/out_of_memory.h"
#include "gld/tensors/torch_version.h"
#include "models/bundle/bundle.h"
#include "models/cost/cost_model.h"
#include "models/dit/dit_field.h"
#include "train/loop/micro_batches.h"
#include "train/loop/training_precision.h"
#include "train/optim/optimiser.h"

#include <algorithm>
#include <functional>
#include <map>
#include <optional>

#include <c10/util/Exception.h>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr int64_t kWarmUps = 2;  // kernels are chosen and loaded, and memory is asked for, at the first
constexpr int kParts = 3;

// What is measured: the options of a model and the sizes of its scene.
struct Setting {
  torch::Device device = torch::kCPU;
  BundleOptions bundle;
  DitOptions dit;
  CameraRow cameras;
  LatentGrid grid;
};

Setting setting_of(const DeviceBenchmarkOptions& options) {
  Setting setting;
  setting.device = device_from_text(options.device);
  if (!options.model.empty()) setting.bundle = ModelBundle::open(options.model).options();
  setting.dit = setting.bundle.generators.front().dit;
  const ImageSize size = image_size_from_text(options.size, "--size");
  setting.cameras = {options.views, options.sources, size};
  setting.grid = setting.bundle.backbone.grid_of(options.views, size.height, size.width);
  return setting;
}

// Times work, which leaves what it computes queued.
void time_into(DeviceBenchmarkRow& row, const Setting& setting, int64_t repeats,
               const std::function<void()>& work) {
  std::vector<double> seconds;
  reset_most_used_device_bytes(setting.device);
  row.resident_bytes = most_used_device_bytes(setting.device);
  for (int64_t repeat = -kWarmUps; repeat < repeats; ++repeat) {
    const double taken = seconds_of([&] {
      work();
      finish_queued_work(setting.device);
    });
    if (repeat >= 0) seconds.push_back(taken);
    stop_if_interrupted("nothing was written yet");
  }
  row.most_bytes = most_used_device_bytes(setting.device);
  const Spread spread = spread_of(seconds);
  row.seconds = spread.median;
  row.seconds_low = spread.low;
  row.seconds_high = spread.high;
}

// Makes a row of what measure fills in; where the device has no room for it, one that says so.
DeviceBenchmarkRow row_of(const std::string& part, const std::string& variant,
                          const std::function<void(DeviceBenchmarkRow&)>& measure) {
  DeviceBenchmarkRow row;
  row.part = part;
  row.variant = variant;
  try {
    measure(row);
  } catch (const c10::Error& error) {
    if (!is_out_of_memory(error)) throw;
    row = {};
    row.part = part;
    row.variant = variant;
    row.problem = "no room on the device";
  }
  return row;
}

void measure_products(const DeviceBenchmarkOptions& options, const Setting& setting,
                      std::vector<DeviceBenchmarkRow>& rows) {
  const int64_t side = options.product_side;
  for (const auto precision : {ComputePrecision::kFloat32, ComputePrecision::kBFloat16}) {
    const bool reduced = precision == ComputePrecision::kBFloat16;
    rows.push_back(row_of("product", compute_precision_name(precision), [&](DeviceBenchmarkRow& row) {
      const auto type =
          torch::TensorOptions(setting.device).dtype(reduced ? torch::kBFloat16 : torch::kFloat32);
      // Zeros would need less power, and a GPU is faster with them.
      const auto a = torch::randn({side, side}, type), b = torch::randn({side, side}, type);
      auto c = torch::mm(a, b);
      row.tflop = 2e-12 * static_cast<double>(side) * static_cast<double>(side) * static_cast<double>(side);
      time_into(row, setting, options.repeats, [&] { torch::mm_out(c, a, b); });
    }));
  }
}

void measure_evaluations(const DeviceBenchmarkOptions& options, const Setting& setting,
                         std::vector<DeviceBenchmarkRow>& rows) {
  const torch::NoGradGuard no_grad;
  const auto original = dit_with_random_weights(setting.dit);
  const RandomDitSceneSettings sizes = {setting.cameras, setting.grid};
  torch::Tensor reference;
  for (const auto precision : {ComputePrecision::kFloat32, ComputePrecision::kBFloat16}) {
    rows.push_back(row_of("evaluation", compute_precision_name(precision), [&](DeviceBenchmarkRow& row) {
      auto model = copy_on(*original, setting.device);
      if (precision != ComputePrecision::kFloat32) model = packed_copy(*model, precision);
      RandomDitScene random = random_scene_for(*model, sizes);
      DitField field(*model, std::move(random.scene));
      field.prepare_times({sizes.flow_time});
      torch::Tensor velocity;
      row.tflop = dit_cost(setting.dit, setting.grid).flop() * 1e-12;
      time_into(row, setting, options.repeats,
                [&] { velocity = field.conditional(random.noisy, sizes.flow_time); });
      velocity = velocity.to(torch::kCPU);
      if (reference.defined()) {
        row.relative_rms = relative_rms(velocity, reference);
      } else {
        reference = velocity;
      }
    }));
  }
}

void measure_training(const DeviceBenchmarkOptions& options, const Setting& setting,
                      std::vector<DeviceBenchmarkRow>& rows) {
  // Made once: random numbers for 0.8 billion parameters are the processor's, and take longer than all that is timed.
  std::optional<RepeatedScene> objective;
  std::optional<FlatParameters> parameters;
  std::optional<Optimiser> optimiser;
  const auto prepare = [&] {
    if (optimiser) return;
    // Of one for which the device had no room nothing is left.
    parameters.reset();
    objective.reset();
    objective.emplace(setting.bundle, setting.dit, setting.cameras, setting.device);
    parameters.emplace(objective->parameters());
    optimiser.emplace(*parameters, OptimiserOptions{});
  };
  const auto optimise = [&] { optimiser->step(1e-6, optimiser->gradient_norm()); };
  const std::vector<MicroBatch> batches(1);
  for (const auto storage : {ActivationStorage::kKeep, ActivationStorage::kRecompute}) {
    for (const auto precision : {ComputePrecision::kFloat32, ComputePrecision::kBFloat16}) {
      std::string variant = compute_precision_name(precision);
      if (storage == ActivationStorage::kRecompute) variant += "_recomputed";
      rows.push_back(row_of("training_step", variant, [&](DeviceBenchmarkRow& row) {
        prepare();
        objective->store(storage);
        set_training_precision(*objective, precision);
        MicroBatchWork work;
        work.precision = precision;
        row.tflop = kForwardsAStep * objective->flop() * 1e-12;
        time_into(row, setting, options.repeats, [&] {
          parameters->zero_gradients();
          add_gradients(*objective, *parameters, batches, work);
          optimise();
        });
      }));
    }
  }
  rows.push_back(
      row_of("optimiser", compute_precision_name(ComputePrecision::kFloat32), [&](DeviceBenchmarkRow& row) {
        prepare();
        time_into(row, setting, options.repeats, optimise);
      }));
}

}  // namespace

void DeviceBenchmarkOptions::visit(FieldVisitor& visitor) {
  visit_out(visitor, out, overwrite);
  visit_device(visitor, device);
  visitor.text({"model", "model bundle, of which the sizes count; empty for the full-size M1"}, model);
  visitor.integer({"views", "source and target views"}, views, {1, 1000});
  visitor.integer({"source_views", "source views"}, sources, {1, 1000});
  visitor.text({"size", "image size, width x height in pixels"}, size);
  visitor.integer({"product_side", "rows and columns of the matrices whose product is the peak"},
                  product_side, {16, 1 << 16});
  visitor.integer({"repeats", "measurements of each, of which the median counts"}, repeats, {1, 1000});
  visit_threads(visitor, threads);
}

void DeviceBenchmarkOptions::check() const {
  if (sources >= views) {
    fail({"--source-views", fmt::format("fewer than --views, {}", views), std::to_string(sources),
          "leave at least one target view"});
  }
  image_size_from_text(size, "--size");
  if (device == "cpu" && model.empty()) {
    fail({"--device", "a GPU for the full-size M1, which a CPU would train for an hour", device,
          "add --device cuda, or --model with the folder of a small model"});
  }
  check_out(out, "runs/bench");
}

std::vector<DeviceBenchmarkRow> device_benchmark_rows(const DeviceBenchmarkOptions& options) {
  const Setting setting = setting_of(options);
  std::vector<DeviceBenchmarkRow> rows;
  Progress progress("bench device", kParts);
  {
    const torch::NoGradGuard no_grad;
    measure_products(options, setting, rows);
  }
  progress.update(1, "products");
  measure_evaluations(options, setting, rows);
  progress.update(2, "evaluations");
  measure_training(options, setting, rows);
  progress.update(kParts, "training");
  progress.finish();
  std::map<std::string, double> peaks;  // operations a second, by precision
  for (const auto& row : rows) {
    if (row.part == "product" && row.seconds > 0) peaks[row.variant] = row.tflop / row.seconds_low;
  }
  for (auto& row : rows) {
    const auto peak = peaks.find(row.variant.substr(0, row.variant.find('_')));
    if (row.tflop == 0 || row.seconds == 0 || peak == peaks.end()) continue;
    row.fraction_of_peak = row.tflop / row.seconds / peak->second;
  }
  return rows;
}

Table device_benchmark_table(const std::vector<DeviceBenchmarkRow>& rows) {
  Table table({"part", "variant", "seconds", "lowest", "highest", "tflop", "fraction_of_peak", "relative_rms",
               "resident_bytes", "most_bytes", "problem"});
  for (const auto& row : rows) {
    table.add_row({row.part, row.variant, if_measured(row.seconds), if_measured(row.seconds_low),
                   if_measured(row.seconds_high), if_measured(row.tflop), if_measured(row.fraction_of_peak),
                   if_measured(row.relative_rms), if_measured(row.resident_bytes),
                   if_measured(row.most_bytes), row.problem});
  }
  return table;
}

int run_device_benchmark(const DeviceBenchmarkOptions& options) {
  RunFolder folder(options.out, "bench device", options, earlier_run(options.overwrite));
  use_threads(options.threads);
  const auto rows = device_benchmark_rows(options);
  const std::string name = device_name(device_from_text(options.device));
  const std::string text = fmt::format(
      "# M1 on {}\n"
      "\n"
      "{} views of {}. Fractions are of the products of {} x {} in the same precision, in the same run. A training step is "
      "forward and backward passes, counted as three forward passes, and the optimiser with its moving average; "
      "`optimiser` is that part alone. Memory is of tensors.\n"
      "\n"
      "{}",
      name, options.views, options.size, options.product_side, options.product_side,
      device_benchmark_table(rows).markdown());
  BenchmarkResults results;
  results.text = text;
  results.files = {{"device.csv", device_benchmark_table(rows).csv()}, {"device.md", text}};
  results.report = {{"command", "bench device"},
                    {"options", to_json(options)},
                    {"device", name},
                    {"libtorch", torch_version()}};
  results.notes = {{"parts", "device.csv"}, {"table", "device.md"}};
  return finish_measured_benchmark(folder, results);
}

}  // namespace gld
