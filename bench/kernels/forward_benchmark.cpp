#include "bench/kernels/forward_benchmark.h"

#include "bench/kernels/composed_dit.h"
#include "bench/support/benchmark_precisions.h"
#include "bench/support/benchmark_report.h"
#include "bench/support/peak_meter.h"
#include "bench/support/random_dit.h"
#include "bench/support/relative_rms.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/kernels/packed_product.h"
#include "gld/machine/precision_option.h"
#include "gld/machine/timing.h"
#include "gld/report/plot.h"
#include "gld/report/progress.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/torch_version.h"
#include "models/bundle/bundle.h"
#include "models/cost/cost_model.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <torch/types.h>

#include <fmt/format.h>

namespace gld {
namespace {

const std::string kOurs = "ours";
const std::string kComposed = "composed";

// A model, a scene and everything that exact savings compute once.
struct Setting {
  std::shared_ptr<DitDh> model;  // not packed
  std::map<ComputePrecision, std::shared_ptr<DitDh>> packed;
  RandomDitSceneSettings sizes;
  RandomDitScene random;
};

Setting make_setting(const ForwardBenchmarkOptions& options) {
  BundleOptions bundle;
  Setting setting;
  if (options.model.empty()) {
    setting.model = dit_with_random_weights(bundle.generators.front().dit);
  } else {
    const auto opened = ModelBundle::open(options.model);
    bundle = opened.options();
    setting.model = opened.load_generator(bundle.generators.front().generator);
  }
  for (const ComputePrecision precision : benchmark_precisions(options.precisions)) {
    setting.packed[precision] = packed_copy(*setting.model, precision);
  }
  const ImageSize size = image_size_from_text(options.size, "--size");
  setting.sizes.cameras = {options.views, options.sources, size};
  setting.sizes.grid = bundle.backbone.grid_of(options.views, size.height, size.width);
  setting.random = random_scene_for(*setting.model, setting.sizes);
  return setting;
}

// One evaluation in the order of DitDh::velocity, timed in two parts that add up to it.
struct Evaluation {
  double encoder_seconds = 0;
  double decoder_seconds = 0;  // with the embedding of the noisy latent and the last layer
  torch::Tensor condition;
  torch::Tensor velocity;
};

template <class Model>
Evaluation evaluate(const Setting& setting, const DitDh& outside, const Model& model) {
  Evaluation result;
  const RandomDitScene& random = setting.random;
  const DitPasses pass{{&random.scene, &random.time, DitBranch::kConditional}};
  DitNoisyTokens tokens;
  result.decoder_seconds += seconds_of([&] { tokens = outside.embed_noisy(random.scene, random.noisy); });
  result.encoder_seconds = seconds_of([&] { result.condition = model.condition_encoder(pass, tokens); });
  result.decoder_seconds += seconds_of([&] {
    result.velocity = outside.velocity_from_features(model.velocity_features(pass, tokens, result.condition),
                                                     random.noisy, setting.sizes.flow_time);
  });
  return result;
}

// The repeats of one variant.
struct ForwardTimes {
  std::string variant;
  std::vector<Evaluation> evaluations;
};

double relative_difference(const torch::Tensor& x, const torch::Tensor& reference) {
  return ((x - reference).abs().max() / reference.abs().max()).item<double>();
}

struct Part {
  std::string name;
  Cost cost;
  double (*seconds)(const Evaluation&);
  const torch::Tensor& (*result)(const Evaluation&);
};

std::vector<Part> parts_of(const Setting& setting) {
  const auto& options = setting.model->options();
  const auto velocity = [](const Evaluation& e) -> const torch::Tensor& { return e.velocity; };
  return {{"condition_encoder", condition_encoder_cost(options, setting.sizes.grid),
           [](const Evaluation& e) { return e.encoder_seconds; },
           [](const Evaluation& e) -> const torch::Tensor& { return e.condition; }},
          {"velocity_decoder", velocity_decoder_cost(options, setting.sizes.grid),
           [](const Evaluation& e) { return e.decoder_seconds; }, velocity},
          {"evaluation", dit_cost(options, setting.sizes.grid),
           [](const Evaluation& e) { return e.encoder_seconds + e.decoder_seconds; }, velocity}};
}

ForwardBenchmarkRow row_from(const Part& part, const ForwardTimes& samples, const ForwardTimes& reference) {
  std::vector<double> seconds;
  for (const auto& evaluation : samples.evaluations) seconds.push_back(part.seconds(evaluation));
  ForwardBenchmarkRow row;
  row.part = part.name;
  row.variant = samples.variant;
  const Spread spread = spread_of(seconds);
  row.seconds = spread.median;
  row.seconds_low = spread.low;
  row.seconds_high = spread.high;
  row.tflop = part.cost.flop() * 1e-12;
  row.relative_difference =
      relative_difference(part.result(samples.evaluations.back()), part.result(reference.evaluations.back()));
  row.relative_rms =
      relative_rms(part.result(samples.evaluations.back()), part.result(reference.evaluations.back()));
  return row;
}

Figure forward_figure(const std::vector<ForwardBenchmarkRow>& rows) {
  PlotPanel panel;
  panel.title = "time and use of the processor";
  panel.x = {"seconds", AxisScale::kLog};
  panel.y = {"float32 multiply-add peaks", AxisScale::kLinear, 0, 1};
  for (const auto& row : rows) panel.y.high = std::max(panel.y.high, 1.05 * row.fraction_of_peak);
  for (const auto& row : rows) {
    panel.series.push_back(
        {row.part + ", " + row.variant, SeriesStyle::kMarkers, {{row.seconds, row.fraction_of_peak}}});
  }
  Figure figure;
  figure.title = "One evaluation of M1";
  figure.panels = {panel};
  return figure;
}

}  // namespace

void ForwardBenchmarkOptions::visit(FieldVisitor& visitor) {
  visit_out(visitor, out, overwrite);
  visitor.text({"model", "model bundle; empty for the full-size M1 with random weights"}, model);
  visitor.integer({"views", "source and target views"}, views, {1, 1000});
  visitor.integer({"source_views", "source views"}, sources, {1, 1000});
  visitor.text({"size", "image size, width x height in pixels"}, size);
  visitor.texts({"precisions", "to measure beside float32: bfloat16, int8"}, precisions);
  visitor.boolean({"composed", "measure LibTorch's composition too"}, composed);
  visitor.integer({"repeats", "measurements of each, of which the median counts"}, repeats, {1, 1000});
  visit_threads(visitor, threads);
}

void ForwardBenchmarkOptions::check() const {
  if (sources >= views) {
    fail({"--source-views", fmt::format("fewer than --views, {}", views), std::to_string(sources),
          "leave at least one target view"});
  }
  const ImageSize image = image_size_from_text(size, "--size");
  if (model.empty()) BundleOptions().backbone.grid_of(views, image.height, image.width);
  benchmark_precisions(precisions);
  check_out(out, "runs/bench");
}

std::vector<ForwardBenchmarkRow> forward_benchmark_rows(const ForwardBenchmarkOptions& options,
                                                        PeakMeter& meter) {
  const torch::NoGradGuard no_grad;
  const Setting setting = make_setting(options);
  const ComposedDit composed(*setting.model);
  ForwardTimes plain = {kComposed, {}};
  std::vector<std::pair<ComputePrecision, ForwardTimes>> ours;
  for (const ComputePrecision precision : benchmark_precisions(options.precisions)) {
    const bool first = precision == ComputePrecision::kFloat32;
    ours.push_back({precision, {first ? kOurs : compute_precision_name(precision), {}}});
  }
  const auto variants = static_cast<int64_t>(ours.size()) + (options.composed ? 1 : 0);
  Progress progress("bench forward", options.repeats * variants);
  int64_t done = 0;
  const auto sample = [&](ForwardTimes& samples, Evaluation evaluation) {
    samples.evaluations.push_back(std::move(evaluation));
    meter.measure(thread_count());
    progress.update(++done, samples.variant);
    stop_if_interrupted("nothing was written yet");
  };
  for (int64_t repeat = 0; repeat < options.repeats; ++repeat) {
    // Its blocks are kept for its next one, as between the evaluations of a flow.
    for (auto& [precision, times] : ours) {
      const DitDh& model = *setting.packed.at(precision);
      sample(times, evaluate(setting, model, model));
    }
    if (!options.composed) continue;
    const LibraryTensorMemory library_memory;
    sample(plain, evaluate(setting, *setting.model, composed));
  }
  std::vector<ForwardBenchmarkRow> rows;
  const ForwardTimes& reference = ours.front().second;  // in float32
  for (const Part& part : parts_of(setting)) {
    for (const auto& [precision, times] : ours) rows.push_back(row_from(part, times, reference));
    if (options.composed) rows.push_back(row_from(part, plain, reference));
  }
  progress.finish();
  for (auto& row : rows) {
    const double flop = row.tflop * 1e12;
    row.fraction_of_peak = flop / row.seconds / meter.peak(thread_count());
    if (row.variant != kOurs && row.variant != kComposed) continue;  // units do more than float32's peak
    meter.reached(fmt::format("{}, {}", row.part, row.variant), flop, row.seconds_low, thread_count());
  }
  return rows;
}

Table forward_benchmark_table(const std::vector<ForwardBenchmarkRow>& rows) {
  Table table({"part", "variant", "seconds", "lowest", "highest", "tflop", "fraction_of_peak",
               "relative_difference", "relative_rms"});
  for (const auto& row : rows) {
    table.add_row({row.part, row.variant, row.seconds, row.seconds_low, row.seconds_high, row.tflop,
                   row.fraction_of_peak, row.relative_difference, row.relative_rms});
  }
  return table;
}

int run_forward_benchmark(const ForwardBenchmarkOptions& options) {
  RunFolder folder(options.out, "bench forward", options, earlier_run(options.overwrite));
  use_threads(options.threads);
  PeakMeter meter;
  meter.measure_with_product();
  const auto rows = forward_benchmark_rows(options, meter);
  meter.measure_with_product();
  const double multiply_add = meter.peak(thread_count()), sgemm = meter.product();
  const auto whole = [&](const std::string& variant) {
    return std::find_if(rows.begin(), rows.end(),
                        [&](const ForwardBenchmarkRow& row) {
                          return row.part == "evaluation" && row.variant == variant;
                        })
        ->seconds;
  };
  std::string beside;
  nlohmann::ordered_json speedup;
  if (options.composed) {
    speedup = whole(kComposed) / whole(kOurs);
    beside = fmt::format(
        "`composed` is LibTorch's operations with LibTorch's own memory, in turns with ours; both start from a scene "
        "prepared once. The parts add up to the evaluation, which is {:.2f} times as fast. ",
        speedup.get<double>());
  }
  std::string in_precisions;
  nlohmann::ordered_json precisions_json = nlohmann::ordered_json::array();
  for (const ComputePrecision precision : benchmark_precisions(options.precisions)) {
    if (precision == ComputePrecision::kFloat32) continue;
    const double ratio = whole(kOurs) / whole(compute_precision_name(precision));
    const double unit_peak = measure_precision_peak(precision, thread_count());
    in_precisions +=
        fmt::format("In {} (peak of its unit {:.0f} GFLOP/s) it is {:.2f} times as fast as ours in float32. ",
                    precision_text(precision), unit_peak * 1e-9, ratio);
    precisions_json.push_back(
        {{"precision", precision_text(precision)}, {"unit_peak", unit_peak}, {"over_float32", ratio}});
  }
  const std::string text = fmt::format(
      "# One evaluation of M1, {} views of {}\n"
      "\n"
      "With {} threads the multiply-add peak is {:.0f} GFLOP/s and a large matrix product ({}) "
      "reaches {:.0f}. {}{}\n"
      "\n"
      "{}",
      options.views, options.size, thread_count(), multiply_add * 1e-9, blas_text(), sgemm * 1e-9, beside,
      in_precisions, forward_benchmark_table(rows).markdown());
  BenchmarkResults results;
  results.text = text;
  results.files = {{"forward.csv", forward_benchmark_table(rows).csv()}, {"forward.md", text}};
  results.figures = {{"forward", forward_figure(rows)}};
  results.report = {{"command", "bench forward"},    {"options", to_json(options)},
                    {"threads", thread_count()},     {"multiply_add_peak", multiply_add},
                    {"sgemm_peak", sgemm},           {"speedup", speedup},
                    {"precisions", precisions_json}, {"blas", blas_name()}};
  results.notes = {{"parts", "forward.csv"}, {"table", "forward.md"}, {"plot", "forward.png"}};
  return finish_measured_benchmark(folder, results, meter.problems());
}

}  // namespace gld
