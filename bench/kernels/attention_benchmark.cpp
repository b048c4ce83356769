#include "bench/kernels/attention_benchmark.h"

#include "bench/support/benchmark_report.h"
#include "bench/support/peak_meter.h"
#include "gld/attention/attention.h"
#include "gld/attention/composed_attention.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/interrupt.h"
#include "gld/kernels/attention_kernel.h"
#include "gld/machine/timing.h"
#include "gld/report/plot.h"
#include "gld/report/progress.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/torch_version.h"

#include <algorithm>
#include <functional>
#include <optional>

#include <torch/autograd.h>
#include <torch/types.h>

#include <fmt/format.h>

namespace gld {
namespace {

// The error of so many rows is computed in double.
constexpr int64_t kCheckedRows = 64;

struct Problem {
  AttentionShape shape;
  AttentionInputs inputs;            // slices of one joint array, as after a projection
  torch::Tensor output_gradient;     // (1, tokens, heads, head_dim)
  AttentionInputs inputs_with_grad;  // the same with gradients wanted
};

Problem make_problem(int64_t tokens, int64_t heads, int64_t head_dim) {
  Problem problem;
  problem.shape = {1, heads, tokens, tokens, head_dim};
  torch::manual_seed(1);
  const auto joint = torch::randn({1, tokens, 3, heads, head_dim});
  problem.inputs.query = joint.select(2, 0);
  problem.inputs.key = joint.select(2, 1);
  problem.inputs.value = joint.select(2, 2);
  problem.output_gradient = torch::randn({1, tokens, heads, head_dim});
  problem.inputs_with_grad = problem.inputs;
  problem.inputs_with_grad.query = problem.inputs.query.detach().requires_grad_(true);
  problem.inputs_with_grad.key = problem.inputs.key.detach().requires_grad_(true);
  problem.inputs_with_grad.value = problem.inputs.value.detach().requires_grad_(true);
  return problem;
}

StridedHeads<const float> strided(const torch::Tensor& x) {
  return {x.data_ptr<float>(), x.stride(0), x.stride(1), x.stride(2)};
}

StridedHeads<float> writable(const torch::Tensor& x) {
  return {x.data_ptr<float>(), x.stride(0), x.stride(1), x.stride(2)};
}

// One way of computing attention; forward leaves its result in output, backward in the gradients.
class Variant {
 public:
  Variant(std::string name, const Problem& problem) : name_(std::move(name)), problem_(problem) {}
  virtual ~Variant() = default;
  virtual void forward() = 0;
  // Returns the seconds of the backward pass alone.
  virtual double backward() = 0;

  const std::string& name() const { return name_; }
  torch::Tensor output;
  torch::Tensor query_gradient;

 protected:
  const Problem& problem() const { return problem_; }

 private:
  std::string name_;
  const Problem& problem_;
};

class KernelVariant : public Variant {
 public:
  KernelVariant(const std::string& name, const Problem& problem, const KernelSettings& settings)
      : Variant(name, problem), settings_(settings) {
    settings_.threads = thread_count();
    output = torch::empty_like(problem.output_gradient);
    query_gradient = torch::empty_like(output);
    key_gradient_ = torch::empty_like(output);
    value_gradient_ = torch::empty_like(output);
    log_sum_exp_ = torch::empty({problem.shape.heads, problem.shape.queries});
  }

  void forward() override { attention_forward(arrays(), settings_); }

  double backward() override {
    AttentionBackward task;
    task.forward = arrays();
    task.output_gradient = strided(problem().output_gradient);
    task.query_gradient = writable(query_gradient);
    task.key_gradient = writable(key_gradient_);
    task.value_gradient = writable(value_gradient_);
    return seconds_of([&] { attention_backward(task, settings_); });
  }

 private:
  AttentionForward arrays() {
    AttentionForward task;
    task.shape = problem().shape;
    task.query = strided(problem().inputs.query);
    task.key = strided(problem().inputs.key);
    task.value = strided(problem().inputs.value);
    task.output = writable(output);
    task.log_sum_exp = log_sum_exp_.data_ptr<float>();
    return task;
  }

  KernelSettings settings_;
  torch::Tensor key_gradient_, value_gradient_, log_sum_exp_;
};

class ComposedVariant : public Variant {
 public:
  explicit ComposedVariant(const Problem& problem) : Variant("composed", problem) {}

  void forward() override {
    const torch::NoGradGuard no_grad;
    output = composed_attention(problem().inputs);
  }

  double backward() override {
    const torch::AutoGradMode with_gradients(true);
    const auto& inputs = problem().inputs_with_grad;
    const auto result = composed_attention(inputs);
    return seconds_of([&] {
      query_gradient = torch::autograd::grad({result}, {inputs.query, inputs.key, inputs.value},
                                             {problem().output_gradient})[0];
    });
  }
};

// Output and query gradient of some rows in double; a row's own results do not depend on the other rows.
struct CheckedRows {
  torch::Tensor index, output, query_gradient;
};

CheckedRows check_rows(const Problem& problem) {
  const torch::AutoGradMode with_gradients(true);
  CheckedRows rows;
  const int64_t tokens = problem.shape.queries;
  rows.index = torch::arange(0, tokens, std::max<int64_t>(1, tokens / kCheckedRows), torch::kLong);
  AttentionInputs exact;
  exact.query = problem.inputs.query.index_select(1, rows.index).to(torch::kFloat64).requires_grad_(true);
  exact.key = problem.inputs.key.to(torch::kFloat64);
  exact.value = problem.inputs.value.to(torch::kFloat64);
  rows.output = composed_attention(exact);
  const auto gradient = problem.output_gradient.index_select(1, rows.index).to(torch::kFloat64);
  rows.query_gradient = torch::autograd::grad({rows.output}, {exact.query}, {gradient})[0];
  rows.output = rows.output.detach();
  return rows;
}

double relative_error(const torch::Tensor& found, const torch::Tensor& index, const torch::Tensor& expected) {
  const auto rows = found.detach().index_select(1, index).to(torch::kFloat64);
  return ((rows - expected).abs().max() / expected.abs().max()).item<double>();
}

AttentionBenchmarkRow row_from(const Problem& problem, const Variant& variant, AttentionPass pass,
                               const std::vector<double>& samples) {
  AttentionBenchmarkRow row;
  row.pass = pass;
  row.head_dim = problem.shape.head_dim;
  row.tokens = problem.shape.queries;
  row.threads = thread_count();
  row.variant = variant.name();
  const Spread seconds = spread_of(samples);
  row.seconds = seconds.median;
  row.seconds_low = seconds.low;
  row.seconds_high = seconds.high;
  row.flop = pass == AttentionPass::kForward ? attention_forward_flops(problem.shape)
                                             : attention_backward_flops(problem.shape);
  return row;
}

void measure(const Problem& problem, int64_t repeats, PeakMeter& meter,
             std::vector<AttentionBenchmarkRow>& rows) {
  KernelSettings portable_settings, reduced;
  portable_settings.instruction_set = InstructionSet::kPortable;
  KernelVariant ours("ours", problem, {});
  ComposedVariant composed(problem);
  KernelVariant portable("portable", problem, portable_settings);
  std::vector<Variant*> variants = {&ours, &composed, &portable};
  // Where there is a unit for it; its rows are fractions of float32's peak.
  std::optional<KernelVariant> bfloat16;
  if (has_matrix_unit(ComputePrecision::kBFloat16)) {
    reduced.precision = ComputePrecision::kBFloat16;
    reduced.unit = best_matrix_unit(reduced.precision);
    variants.push_back(&bfloat16.emplace("ours_bfloat16", problem, reduced));
  }
  std::vector<std::vector<double>> forward(variants.size()), backward(variants.size());
  // The first round warms up memory and clock.
  for (int64_t repeat = -1; repeat < repeats; ++repeat) {
    for (std::size_t v = 0; v < variants.size(); ++v) {
      meter.measure(thread_count());
      const double forward_seconds = seconds_of([&] { variants[v]->forward(); });
      const double backward_seconds = variants[v]->backward();
      stop_if_interrupted(fmt::format("{} rows", rows.size()));
      if (repeat < 0) continue;
      forward[v].push_back(forward_seconds);
      backward[v].push_back(backward_seconds);
    }
  }
  const CheckedRows checked = check_rows(problem);
  for (std::size_t v = 0; v < variants.size(); ++v) {
    rows.push_back(row_from(problem, *variants[v], AttentionPass::kForward, forward[v]));
    rows.back().relative_error = relative_error(variants[v]->output, checked.index, checked.output);
    rows.push_back(row_from(problem, *variants[v], AttentionPass::kBackward, backward[v]));
    rows.back().relative_error =
        relative_error(variants[v]->query_gradient, checked.index, checked.query_gradient);
  }
}

std::vector<int64_t> thread_counts_of(const AttentionBenchmarkOptions& options) {
  if (!options.thread_counts.empty()) return options.thread_counts;
  const int64_t cores = threads_to_use(0);
  return cores == 1 ? std::vector<int64_t>{1} : std::vector<int64_t>{1, cores};
}

// Puts the thread count back.
class ThreadCountScope {
 public:
  ThreadCountScope() : before_(thread_count()) {}
  ~ThreadCountScope() { set_thread_count(before_); }
  ThreadCountScope(const ThreadCountScope&) = delete;
  ThreadCountScope& operator=(const ThreadCountScope&) = delete;

 private:
  int before_;
};

Figure attention_figure(const std::vector<AttentionBenchmarkRow>& rows) {
  Figure figure;
  figure.title = "Attention: fraction of the multiply-add peak";
  for (const AttentionPass pass : {AttentionPass::kForward, AttentionPass::kBackward}) {
    PlotPanel panel;
    panel.title = pass == AttentionPass::kForward ? "forward" : "backward";
    panel.x = {"tokens", AxisScale::kLog};
    double highest = 1;  // units of reduced precision do more than float32's peak
    for (const auto& row : rows) highest = std::max(highest, row.fraction_of_peak);
    panel.y = {"fraction of peak", AxisScale::kLinear, 0, 1.05 * highest};
    for (const auto& row : rows) {
      if (row.pass != pass) continue;
      const std::string name = fmt::format("{}, head size {}, {} thread{}", row.variant, row.head_dim,
                                           row.threads, row.threads == 1 ? "" : "s");
      auto series = std::find_if(panel.series.begin(), panel.series.end(),
                                 [&](const PlotSeries& entry) { return entry.name == name; });
      if (series == panel.series.end())
        series = panel.series.insert(panel.series.end(), {name, SeriesStyle::kLine, {}});
      series->points.emplace_back(static_cast<double>(row.tokens), row.fraction_of_peak);
    }
    figure.panels.push_back(panel);
  }
  return figure;
}

Table attention_overview(const std::vector<AttentionBenchmarkRow>& rows) {
  Table table({"pass", "head_dim", "tokens", "threads", "variant", "seconds", "lowest", "highest",
               "fraction_of_peak", "relative_error"});
  for (const auto& row : rows) {
    table.add_row({std::string(row.pass == AttentionPass::kForward ? "forward" : "backward"), row.head_dim,
                   row.tokens, row.threads, row.variant, row.seconds, row.seconds_low, row.seconds_high,
                   row.fraction_of_peak, row.relative_error});
  }
  return table;
}

}  // namespace

void AttentionBenchmarkOptions::visit(FieldVisitor& visitor) {
  visit_out(visitor, out, overwrite);
  visitor.integers({"head_dims", "channels a head"}, head_dims, {1, 256});
  visitor.integers({"tokens", "token counts; the composition needs 8 heads tokens^2 bytes"}, tokens,
                   {1, 100000});
  visitor.integers({"thread_counts", "threads to compute with; 1 and one a core when empty"}, thread_counts,
                   {1, kMostThreads});
  visitor.integer({"heads", "attention heads"}, heads, {1, 1024});
  visitor.integer({"repeats", "measurements of each, of which the median counts"}, repeats, {1, 1000});
}

void AttentionBenchmarkOptions::check() const { check_out(out, "runs/bench"); }

std::vector<AttentionBenchmarkRow> attention_benchmark_rows(const AttentionBenchmarkOptions& options,
                                                            PeakMeter& meter) {
  const ThreadCountScope restore;
  std::vector<AttentionBenchmarkRow> rows;
  const auto counts = thread_counts_of(options);
  Progress progress("bench attention",
                    static_cast<int64_t>(counts.size() * options.head_dims.size() * options.tokens.size()));
  int64_t done = 0;
  for (const int64_t head_dim : options.head_dims) {
    for (const int64_t tokens : options.tokens) {
      const Problem problem = make_problem(tokens, options.heads, head_dim);
      for (const int64_t threads : counts) {
        use_threads(threads);
        measure(problem, options.repeats, meter, rows);
        progress.update(++done,
                        fmt::format("head size {}, {} tokens, {} threads", head_dim, tokens, threads));
      }
    }
  }
  progress.finish();
  for (auto& row : rows) {
    row.fraction_of_peak = row.flop / row.seconds / meter.peak(static_cast<int>(row.threads));
    if (row.variant == "ours_bfloat16") continue;  // does more than float32's peak
    meter.reached(
        fmt::format("attention ({}, head size {}, {} tokens)", row.variant, row.head_dim, row.tokens),
        row.flop, row.seconds_low, static_cast<int>(row.threads));
  }
  return rows;
}

Table attention_benchmark_table(const std::vector<AttentionBenchmarkRow>& rows, AttentionPass pass) {
  Table table({"head_dim", "tokens", "threads", "variant", "seconds", "fraction_of_peak", "relative_error"});
  for (const auto& row : rows) {
    if (row.pass != pass) continue;
    table.add_row({row.head_dim, row.tokens, row.threads, row.variant, row.seconds, row.fraction_of_peak,
                   row.relative_error});
  }
  return table;
}

int run_attention_benchmark(const AttentionBenchmarkOptions& options) {
  RunFolder folder(options.out, "bench attention", options, earlier_run(options.overwrite));
  const ThreadCountScope restore;
  use_threads(thread_counts_of(options).back());
  PeakMeter meter;
  meter.measure_with_product();
  const auto rows = attention_benchmark_rows(options, meter);
  meter.measure_with_product();
  const double multiply_add = meter.peak(thread_count()), sgemm = meter.product();
  const std::string text = fmt::format(
      "# Attention\n"
      "\n"
      "{} vectors; with {} threads the multiply-add peak is {:.0f} GFLOP/s and a large matrix product ({}) "
      "reaches {:.0f}. Rows of ours_bfloat16 are fractions of the same float32 peak.\n"
      "\n"
      "{}",
      instruction_set_name(best_instruction_set()), thread_count(), multiply_add * 1e-9, blas_text(),
      sgemm * 1e-9, attention_overview(rows).markdown());
  BenchmarkResults results;
  results.text = text;
  results.files = {
      {"attention.csv", attention_benchmark_table(rows, AttentionPass::kForward).csv()},
      {"attention_backward.csv", attention_benchmark_table(rows, AttentionPass::kBackward).csv()},
      {"attention.md", text}};
  results.figures = {{"attention", attention_figure(rows)}};
  results.report = {{"command", "bench attention"},
                    {"options", to_json(options)},
                    {"multiply_add_peak", multiply_add},
                    {"sgemm_peak", sgemm},
                    {"blas", blas_name()}};
  results.notes = {{"forward passes", "attention.csv"},
                   {"backward passes", "attention_backward.csv"},
                   {"table", "attention.md"},
                   {"plot", "attention.png"}};
  return finish_measured_benchmark(folder, results, meter.problems());
}

}  // namespace gld
