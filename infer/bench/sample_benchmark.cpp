#include "infer/bench/sample_benchmark.h"

#include "datasets/loading/dataset.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/metrics/metric_list.h"
#include "gld/report/benchmark_results.h"
#include "gld/report/plot.h"
#include "gld/report/progress.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/device.h"
#include "gld/tensors/torch_version.h"
#include "infer/bench/relative_rms.h"
#include "infer/method/sampling_method.h"
#include "infer/pipeline/bundle_models.h"
#include "infer/pipeline/scene_request.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <memory>
#include <set>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr int64_t kReferenceEvaluations = 20000;
constexpr double kNotMeasured = std::numeric_limits<double>::quiet_NaN();
const std::string kEverywhere = "everywhere";

// What means over scenes are taken of.
constexpr double SampleRow::*kAveraged[] = {&SampleRow::boundary_error, &SampleRow::shallowest_error,
                                            &SampleRow::seconds};

SamplingVariant variant_of(SolverKind solver, ScheduleKind schedule, int64_t evaluations, double scale) {
  SamplingVariant variant;
  variant.solver.solver = solver;
  variant.solver.evaluations = evaluations;
  variant.solver.schedule.schedule = schedule;
  variant.solver.schedule.shift = 0;  // the model's
  variant.guidance.guidance_scale = scale;
  return variant;
}

std::string guidance_text(const GuidanceOptions& guidance) {
  if (guidance.guidance_scale == 1) return "none";
  if (guidance.guidance_tolerance > 0) return fmt::format("dropped below {:g}", guidance.guidance_tolerance);
  if (guidance.guidance_interval[0] > 0) return fmt::format("from t = {:g}", guidance.guidance_interval[0]);
  return kEverywhere;
}

// Loading a model anew for each sample would hide what a small one takes; of a large one only the present stage's
// weights fit beside each other, as in gld sample.
PipelineModels models_of(const ModelBundle& bundle, const torch::Device& device) {
  constexpr uintmax_t kKeptBytes = 1'000'000'000;
  uintmax_t bytes = 0;
  for (const auto& entry : std::filesystem::directory_iterator(bundle.folder())) {
    if (entry.is_regular_file()) bytes += entry.file_size();
  }
  return bytes <= kKeptBytes ? kept_bundle_models(bundle, device) : bundle_models(bundle, device);
}

// What all scenes share.
struct BenchmarkModels {
  BundleOptions bundle;
  PipelineModels models;
  std::shared_ptr<Lpips> lpips;  // null without weights
};

// A scene and everything that does not depend on how it is sampled.
class SceneSampler {
 public:
  SceneSampler(const BenchmarkModels& models, const SamplingScene& scene, int64_t noise_seed,
               const torch::Device& device)
      : models_(models), name_(scene.name) {
    request_ = scene_request(scene, models.bundle, noise_seed, device);
    const auto& truth = scene.true_images;
    if (!truth.empty() &&
        std::all_of(truth.begin(), truth.end(), [](const Image& image) { return !image.empty(); })) {
      truth_ = stacked(truth);
    }
  }

  // The converged solution that errors refer to.
  void solve_reference(double tolerance, double guidance_scale) {
    SamplingVariant variant =
        variant_of(SolverKind::kDormandPrince, ScheduleKind::kLogSnr, 1, guidance_scale);
    variant.solver.tolerance = tolerance;
    variant.solver.max_evaluations = kReferenceEvaluations;
    reference_row_ = run(variant, reference_);
    reference_row_.solver = "reference";
    reference_row_.schedule.clear();
    reference_row_.count = 0;
    reference_row_.boundary_error = reference_row_.shallowest_error = 0;
  }
  const SampleRow& reference_row() const { return reference_row_; }

  SampleRow measure(const SamplingVariant& variant) {
    PipelineResult result;
    SampleRow row = run(variant, result);
    if (row.non_finite == 0) {
      // The boundary level, which is generated first, and the shallowest.
      row.boundary_error = relative_rms(result.latents.rbegin()->second, reference_.latents.rbegin()->second);
      row.shallowest_error = relative_rms(result.latents.begin()->second, reference_.latents.begin()->second);
    }
    return row;
  }

 private:
  SampleRow run(const SamplingVariant& variant, PipelineResult& result) {
    SamplingMethod method;
    method.solver = variant.solver;
    method.guidance_interval = variant.guidance.guidance_interval;
    method.guidance_tolerance = variant.guidance.guidance_tolerance;
    request_.flow = flow_settings(method, variant.guidance, models_.bundle);
    SampleRow row;
    row.scene = name_;
    row.solver = solver_names()[static_cast<size_t>(variant.solver.solver)];
    row.schedule = schedule_names()[static_cast<size_t>(variant.solver.schedule.schedule)];
    row.count = variant.solver.evaluations;
    row.guidance_scale = variant.guidance.guidance_scale;
    row.guidance = guidance_text(variant.guidance);
    row.boundary_error = row.shallowest_error = kNotMeasured;
    StageRecords stages;
    try {
      result = run_pipeline(models_.models, request_, stages);
    } catch (const Error& error) {
      // Every stage words it like this (gld/flow/solvers/solver.h, infer/pipeline/sampling_pipeline.h); other errors
      // end the report.
      if (error.parts().expected != "finite numbers") throw;
      row.non_finite = 1;
    }
    row.seconds = stage_seconds(models_.models.levels, StageKind::kFlow, stages);
    for (const auto& stage : stages.records()) {
      row.peak_bytes = std::max(row.peak_bytes, stage.peak_bytes);
    }
    for (const auto& flow : result.flows) {
      row.evaluations += flow.evaluations;
      row.unconditional += flow.guidance.unconditional;
    }
    if (row.non_finite == 0) {
      const torch::NoGradGuard no_gradients;
      for (const Metric& metric : image_metric_list()) {
        const MetricValue value = gld::measure(metric, inputs_of(result.images));
        if (value.absent.empty()) row.quality[metric.name] = value.mean();
      }
    }
    return row;
  }

  MetricInputs inputs_of(const torch::Tensor& images) const {
    MetricInputs inputs;
    inputs.true_images = truth_;
    inputs.images = images;
    if (models_.lpips) {
      inputs.perceptual_distance = [this](const torch::Tensor& a, const torch::Tensor& b) {
        return models_.lpips->forward(a, b);
      };
    }
    return inputs;
  }

  const BenchmarkModels& models_;
  std::string name_;
  PipelineRequest request_;
  torch::Tensor truth_;
  PipelineResult reference_;
  SampleRow reference_row_;
};

// The scenes to sample, loaded one at a time.
class BenchmarkScenes {
 public:
  BenchmarkScenes(const SampleBenchmarkOptions& options, const BundleOptions& bundle)
      : options_(options), bundle_(bundle) {
    if (options.scenes.empty()) {
      const auto size = bundle.image_sizes().front();
      generator_.seed = options.synthetic_seed;
      generator_.scene_count = options.synthetic;
      generator_.width = size.width;
      generator_.height = size.height;
      return;
    }
    dataset_ = std::make_unique<FolderDataset>(options.scenes, options.reading);
  }

  int64_t size() const {
    return dataset_ ? std::min(options_.max_scenes, dataset_->size()) : options_.synthetic;
  }

  SamplingScene load(int64_t index) const {
    if (!dataset_) {
      const SampleKey key = held_out_key(options_.synthetic_seed, index);
      return load_held_out_scene(make_synthetic_scene(generator_, index), held_out_views(), key, bundle_);
    }
    const Scene scene = dataset_->scene(index);
    const auto size = choose_size(options_.size, scene, bundle_.image_sizes(), bundle_.backbone.patch_side());
    return load_sampling_scene(scene, options_.views, size);
  }

 private:
  const SampleBenchmarkOptions& options_;
  const BundleOptions& bundle_;
  SyntheticOptions generator_;
  std::unique_ptr<FolderDataset> dataset_;  // none: generated scenes
};

enum class RowValue { kError, kPsnr };

double value_of(const SampleRow& row, RowValue value) {
  return value == RowValue::kError ? row.shallowest_error : row.quality_of("psnr");
}

// Error or quality against seconds, one line a variant, at one guidance scale.
PlotPanel work_panel(const std::vector<SampleRow>& means, RowValue value, const std::string& label,
                     double guidance_scale) {
  const bool error = value == RowValue::kError;
  PlotPanel panel;
  panel.title = label + fmt::format(", guidance {:g}", guidance_scale);
  panel.x = {"seconds for both levels", AxisScale::kLog, 0, 0};
  panel.y = {label, error ? AxisScale::kLog : AxisScale::kLinear, 0, 0};
  PlotSeries front{"Pareto front", SeriesStyle::kFront, {}};
  for (const auto& row : means) {
    if (row.guidance_scale != guidance_scale || !std::isfinite(value_of(row, value))) continue;
    if (error && row.is_reference()) continue;
    auto series = std::find_if(panel.series.begin(), panel.series.end(),
                               [&](const PlotSeries& entry) { return entry.name == row.variant(); });
    if (series == panel.series.end()) {
      panel.series.push_back({row.variant(), SeriesStyle::kLine, {}});
      series = panel.series.end() - 1;
    }
    series->points.emplace_back(row.seconds, value_of(row, value));
    if (error ? row.on_error_front : row.on_quality_front)
      front.points.emplace_back(row.seconds, value_of(row, value));
  }
  std::sort(front.points.begin(), front.points.end());
  panel.series.push_back(std::move(front));
  return panel;
}

bool has_quality(const std::vector<SampleRow>& rows) {
  return std::any_of(rows.begin(), rows.end(),
                     [](const SampleRow& row) { return row.quality.count("psnr") > 0; });
}

Figure sample_figure(const std::vector<SampleRow>& means, double guidance_scale) {
  Figure figure;
  figure.title = "Sampling: error and quality against time";
  figure.panels = {work_panel(means, RowValue::kError, "relative latent error", guidance_scale)};
  if (has_quality(means))
    figure.panels.push_back(work_panel(means, RowValue::kPsnr, "PSNR (dB)", guidance_scale));
  return figure;
}

}  // namespace

void SampleBenchmarkOptions::visit(FieldVisitor& visitor) {
  visitor.text({"model", "model bundle: a folder with model.yaml"}, model);
  visit_scenes(visitor, scenes, "generated ones, with views of their own");
  visitor.integer({"max_scenes", "how many scenes of --scenes to take"}, max_scenes, {1, 100000});
  visitor.integer({"synthetic", "number of generated scenes, in the place of --scenes; those of gld eval"},
                  synthetic, {0, 100000});
  visitor.integer({"synthetic_seed", "seed of the generated scenes; training must not have used it"},
                  synthetic_seed, {0, 1'000'000'000'000});
  visitor.group({"reading", "how scenes are read"}, reading);
  visitor.group({"views", "which views"}, views);
  visitor.text({"size", "WIDTHxHEIGHT in pixels, or auto: the trained size of the nearest aspect"}, size);
  visit_seed(visitor, seed, "the first scene's noise, each next scene has the next one");
  visitor.integers({"counts", "function evaluations a level to try"}, counts, {1, 100000});
  visitor.reals({"guidance_scales", "guidance scales to try; the last is plotted"}, guidance_scales,
                {0, 1000});
  visitor.real({"reference_tolerance", "tolerance of the adaptive reference solve"}, reference_tolerance,
               {1e-10, 0.1});
  lpips.visit(visitor);
  visit_device(visitor, device);
  visit_threads(visitor, threads);
  visit_out(visitor, out, overwrite);
}

void SampleBenchmarkOptions::check() const {
  if (scenes.empty() == (synthetic == 0)) {
    fail({"--scenes, --synthetic", "either folders of scenes or a number of generated scenes",
          scenes.empty() ? "neither" : "both", "add for example --synthetic 4"});
  }
  if (!scenes.empty()) views.ViewSelection::check();
  lpips.check();
  check_out(out, "runs/bench");
  if (counts.empty() || guidance_scales.empty()) {
    fail(
        {"counts and guidance_scales", "at least one value each", "an empty list", "write for example [16]"});
  }
}

std::vector<SamplingVariant> sampling_variants(const std::vector<int64_t>& counts, double guidance_scale) {
  std::vector<SamplingVariant> variants;
  for (const int64_t count : counts) {
    for (const auto& [solver, schedule] : {std::pair{SolverKind::kEuler, ScheduleKind::kPublished},
                                           {SolverKind::kEuler, ScheduleKind::kLogSnr},
                                           {SolverKind::kDpmSolver2M, ScheduleKind::kLogSnr},
                                           {SolverKind::kUniPc2, ScheduleKind::kLogSnr},
                                           {SolverKind::kUniPc3, ScheduleKind::kLogSnr}}) {
      variants.push_back(variant_of(solver, schedule, count, guidance_scale));
    }
    if (guidance_scale == 1) continue;
    auto early = variant_of(SolverKind::kUniPc3, ScheduleKind::kLogSnr, count, guidance_scale);
    early.guidance.guidance_interval = {0.9, 1};
    variants.push_back(early);
    auto adaptive = variant_of(SolverKind::kUniPc3, ScheduleKind::kLogSnr, count, guidance_scale);
    adaptive.guidance.guidance_tolerance = 0.01;
    variants.push_back(adaptive);
  }
  return variants;
}

double SampleRow::quality_of(const std::string& metric) const {
  const auto found = quality.find(metric);
  return found == quality.end() ? kNotMeasured : found->second;
}

std::string SampleRow::variant() const {
  if (is_reference()) return solver;
  const bool plain = guidance.empty() || guidance == kEverywhere || guidance_scale == 1;
  return solver + ", " + schedule + (plain ? "" : ", guided " + guidance);
}

void mark_pareto_fronts(std::vector<SampleRow>& rows) {
  // Fronts minimise; quality is better when larger.
  const auto mark = [&](const SampleRow& first, RowValue value, double sign, bool SampleRow::*on_front) {
    std::vector<std::pair<double, double>> points;
    const auto takes_part = [&](const SampleRow& row) {
      return row.scene == first.scene && row.guidance_scale == first.guidance_scale && !row.is_reference() &&
             std::isfinite(value_of(row, value));
    };
    for (const auto& row : rows) {
      if (takes_part(row)) points.emplace_back(row.seconds, sign * value_of(row, value));
    }
    const auto front = pareto_front(points);
    for (auto& row : rows) {
      const std::pair<double, double> point(row.seconds, sign * value_of(row, value));
      row.*on_front =
          takes_part(row) ? std::find(front.begin(), front.end(), point) != front.end() : row.*on_front;
    }
  };
  std::set<std::pair<std::string, double>> done;
  for (size_t i = 0; i < rows.size(); ++i) {
    if (!done.emplace(rows[i].scene, rows[i].guidance_scale).second) continue;
    const SampleRow first = rows[i];
    mark(first, RowValue::kError, 1, &SampleRow::on_error_front);
    mark(first, RowValue::kPsnr, -1, &SampleRow::on_quality_front);
  }
}

Table sample_table(const std::vector<SampleRow>& rows) {
  std::vector<std::string> columns{"scene",          "solver",      "schedule",    "count",
                                   "guidance_scale", "guidance",    "evaluations", "unconditional",
                                   "level1_error",   "level0_error"};
  for (const Metric& metric : image_metric_list()) columns.push_back(metric.name);
  for (const char* name : {"seconds", "peak_bytes", "non_finite", "pareto"}) columns.emplace_back(name);
  Table table(columns);
  for (const auto& row : rows) {
    const std::string front = row.on_error_front && row.on_quality_front ? "error and psnr"
                              : row.on_error_front                       ? "error"
                              : row.on_quality_front                     ? "psnr"
                                                                         : "";
    std::vector<TableCell> cells{row.scene,          row.solver,          row.schedule,    row.count,
                                 row.guidance_scale, row.guidance,        row.evaluations, row.unconditional,
                                 row.boundary_error, row.shallowest_error};
    for (const Metric& metric : image_metric_list()) {
      const auto found = row.quality.find(metric.name);
      cells.push_back(found == row.quality.end() ? TableCell(std::string()) : TableCell(found->second));
    }
    cells.insert(cells.end(), {TableCell(row.seconds), TableCell(row.peak_bytes), TableCell(row.non_finite),
                               TableCell(front)});
    table.add_row(cells);
  }
  return table;
}

std::vector<SampleRow> mean_over_scenes(const std::vector<SampleRow>& rows) {
  struct Group {
    SampleRow sum;
    int64_t scenes = 0;
  };
  const auto alike = [](const SampleRow& a, const SampleRow& b) {
    return a.solver == b.solver && a.schedule == b.schedule && a.count == b.count &&
           a.guidance_scale == b.guidance_scale && a.guidance == b.guidance;
  };
  std::vector<Group> groups;
  for (const auto& row : rows) {
    const auto group = std::find_if(groups.begin(), groups.end(),
                                    [&](const Group& candidate) { return alike(candidate.sum, row); });
    if (group == groups.end()) {
      groups.push_back({row, 1});
      groups.back().sum.scene = "mean";
      continue;
    }
    auto& sum = group->sum;
    for (auto value : kAveraged) sum.*value += row.*value;
    for (const Metric& metric : image_metric_list()) {
      if (sum.quality.count(metric.name) == 0) continue;
      sum.quality[metric.name] += row.quality_of(metric.name);
    }
    sum.evaluations += row.evaluations;
    sum.unconditional += row.unconditional;
    sum.peak_bytes = std::max(sum.peak_bytes, row.peak_bytes);
    sum.non_finite += row.non_finite;
    ++group->scenes;
  }
  std::vector<SampleRow> means;
  for (auto& group : groups) {
    auto& mean = group.sum;
    mean.evaluations /= group.scenes;
    mean.unconditional /= group.scenes;
    for (auto value : kAveraged) mean.*value /= static_cast<double>(group.scenes);
    for (auto& [name, value] : mean.quality) value /= static_cast<double>(group.scenes);
    means.push_back(mean);
  }
  mark_pareto_fronts(means);
  return means;
}

int run_sample_benchmark(const SampleBenchmarkOptions& options) {
  use_threads(options.threads);
  const auto bundle = ModelBundle::open(options.model);
  const auto device = device_from_text(options.device);
  const BenchmarkScenes scenes(options, bundle.options());
  const BenchmarkModels models{bundle.options(), models_of(bundle, device), load_lpips(options.lpips)};
  RunFolder folder(options.out, "bench sample", options, earlier_run(options.overwrite));
  size_t total = 0;
  for (const double scale : options.guidance_scales)
    total += 1 + sampling_variants(options.counts, scale).size();
  total *= static_cast<size_t>(scenes.size());

  std::vector<SampleRow> rows;
  Progress progress("bench sample", static_cast<int64_t>(total));
  const auto keep = [&](const SampleRow& row) {
    rows.push_back(row);
    write_file_atomically(folder.path() / "sample.csv", sample_table(rows).csv());
    progress.update(static_cast<int64_t>(rows.size()), row.scene + ": " + row.variant());
    stop_if_interrupted(fmt::format("{} of {} samples are in sample.csv", rows.size(), total));
  };
  for (int64_t index = 0; index < scenes.size(); ++index) {
    SceneSampler sampler(models, scenes.load(index), options.seed + index, device);
    for (const double scale : options.guidance_scales) {
      sampler.solve_reference(options.reference_tolerance, scale);
      keep(sampler.reference_row());
      for (const auto& variant : sampling_variants(options.counts, scale)) keep(sampler.measure(variant));
    }
  }
  progress.finish();
  mark_pareto_fronts(rows);
  write_file_atomically(folder.path() / "sample.csv", sample_table(rows).csv());

  const auto means = mean_over_scenes(rows);
  const std::string text =
      fmt::format(
          "# Sampling: error, quality and time\n"
          "\n"
          "Model {}, {} scenes. Latent errors are relative to a Dormand-Prince solve of the same noise at "
          "tolerance {:g}; `count` is evaluations a level; "
          "evaluations, seconds and memory are of both levels together; "
          "`pareto` says on which front of a guidance scale a row is: "
          "of seconds and level0_error, or of seconds and PSNR.\n"
          "\n",
          bundle.options().name, scenes.size(), options.reference_tolerance) +
      sample_table(means).markdown();
  BenchmarkResults results;
  results.text = text;
  results.files = {{"sample.md", text}};
  results.figures = {{"sample", sample_figure(means, options.guidance_scales.back())}};
  results.report = {
      {"command", "bench sample"}, {"options", to_json(options)}, {"model_hash", bundle.content_hash()},
      {"scenes", scenes.size()},   {"samples", rows.size()},      {"threads", thread_count()}};
  results.notes = {{"every sample", "sample.csv"},
                   {"means", "sample.md"},
                   {"error and quality against time", "sample.png"}};
  finish_benchmark(folder, results);
  return 0;
}

}  // namespace gld
