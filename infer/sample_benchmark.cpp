#include "infer/sample_benchmark.h"

#include "datasets/batching.h"
#include "gld/atomic_file.h"
#include "gld/configuration.h"
#include "gld/error.h"
#include "gld/interrupt.h"
#include "gld/plot.h"
#include "gld/progress.h"
#include "gld/random.h"
#include "gld/run_folder.h"
#include "gld/torch_version.h"
#include "infer/bundle_models.h"
#include "infer/image_metrics.h"

#include <algorithm>
#include <cmath>
#include <iostream>
#include <limits>
#include <thread>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr int64_t kReferenceEvaluations = 20000;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

torch::Tensor stacked(const std::vector<Image>& images) {
  std::vector<torch::Tensor> tensors;
  tensors.reserve(images.size());
  for (const auto& image : images) tensors.push_back(to_tensor(image));
  return torch::stack(tensors);
}

SamplingVariant variant_of(SolverKind solver, ScheduleKind schedule, int64_t evaluations, double scale) {
  SamplingVariant variant;
  variant.solver.solver = solver;
  variant.solver.evaluations = evaluations;
  variant.solver.schedule.schedule = schedule;
  variant.guidance.guidance_scale = scale;
  variant.name =
      solver_names()[static_cast<size_t>(solver)] + ", " + schedule_names()[static_cast<size_t>(schedule)];
  return variant;
}

// A scene, its model and everything that does not depend on how it is sampled.
class SceneSampler {
 public:
  SceneSampler(const ModelBundle& bundle, SamplingScene scene, const SampleBenchmarkOptions& options)
      : options_(bundle.options()), scene_(std::move(scene)) {
    const auto device = device_from_text(options.device);
    models_ = bundle_models(bundle, device);
    const LatentGrid grid =
        options_.backbone.grid_of(scene_.views.size(), scene_.size.height, scene_.size.width);
    const auto noise = [&](const char* stream, int64_t channels) {
      return views_noise(static_cast<uint64_t>(options.seed), stream, grid.views,
                         {grid.tokens_per_view(), channels});
    };
    request_.views = scene_.views;
    request_.source_images = stacked(scene_.source_images);
    request_.level1_noise = noise("level 1", options_.level1.in_channels);
    request_.level0_noise = noise("level 0", options_.cascade.in_channels);
    request_.device = device;
    const auto& truth = scene_.true_images;
    if (!truth.empty() &&
        std::all_of(truth.begin(), truth.end(), [](const Image& i) { return !i.rgb.empty(); })) {
      truth_ = stacked(truth);
    }
  }

  // The converged solution that errors refer to.
  void solve_reference(double tolerance, double guidance_scale) {
    SamplingVariant variant =
        variant_of(SolverKind::kDormandPrince, ScheduleKind::kLogSnr, 1, guidance_scale);
    variant.name = "reference";
    variant.solver.tolerance = tolerance;
    variant.solver.max_evaluations = kReferenceEvaluations;
    reference_row_ = run(variant, reference_);
    reference_row_.level1_error = reference_row_.level0_error = 0;
  }
  const SampleRow& reference_row() const { return reference_row_; }

  SampleRow measure(const SamplingVariant& variant) {
    PipelineResult result;
    SampleRow row = run(variant, result);
    if (row.non_finite == 0) {
      row.level1_error = relative_error(result.level1, reference_.level1);
      row.level0_error = relative_error(result.level0, reference_.level0);
    }
    return row;
  }

 private:
  static double relative_error(const torch::Tensor& latent, const torch::Tensor& reference) {
    return ((latent - reference).norm() / reference.norm()).item<double>();
  }

  SampleRow run(const SamplingVariant& variant, PipelineResult& result) {
    request_.level1_solver = request_.cascade_solver = variant.solver;
    request_.level1_solver.schedule.shift = options_.level1_time_shift.evaluation;
    request_.cascade_solver.schedule.shift = options_.cascade_time_shift.evaluation;
    request_.guidance = variant.guidance;
    SampleRow row;
    row.scene = scene_.name;
    row.variant = variant.name;
    row.guidance_scale = variant.guidance.guidance_scale;
    row.psnr = row.ssim = row.level1_error = row.level0_error = kNan;
    StageRecords stages;
    try {
      result = run_pipeline(models_, request_, stages);
    } catch (const Error& error) {
      // Every stage words it like this (gld/solver.h, infer/sampling_pipeline.h); other errors end the report.
      if (error.parts().expected != "finite numbers") throw;
      row.non_finite = 1;
    }
    for (const auto& stage : stages.records()) {
      if (stage.name == "M1" || stage.name == "cascade") row.seconds += stage.seconds;
      row.peak_bytes = std::max(row.peak_bytes, stage.peak_bytes);
    }
    for (const auto& flow : result.flows) {
      row.evaluations += flow.evaluations;
      row.unconditional += flow.guidance.unconditional;
    }
    if (row.non_finite == 0 && truth_.defined()) {
      row.psnr = psnr(truth_, result.images).mean().item<double>();
      row.ssim = ssim(truth_, result.images).mean().item<double>();
    }
    return row;
  }

  BundleOptions options_;
  SamplingScene scene_;
  PipelineModels models_;
  PipelineRequest request_;
  torch::Tensor truth_;
  PipelineResult reference_;
  SampleRow reference_row_;
};

std::vector<TrainedSize> trained_sizes(const BundleOptions& options) {
  std::vector<TrainedSize> sizes;
  for (const auto& size : options.image_sizes()) sizes.push_back({size.width, size.height});
  return sizes;
}

SamplingScene load_scene(const SceneLocation& location, const SampleBenchmarkOptions& options,
                         const BundleOptions& bundle) {
  SceneReading reading = options.reading;
  if (!location.part.empty()) reading.part = location.part;
  const Scene scene = open_scene(location.path, reading);
  const auto size = choose_size(options.size, scene, trained_sizes(bundle), bundle.backbone.patch_size);
  return load_sampling_scene(scene, options.views, size);
}

// Error or quality against seconds, one line a variant, at one guidance scale.
PlotPanel work_panel(const std::vector<SampleRow>& means, double SampleRow::*quality,
                     const std::string& label, double guidance_scale) {
  const bool error = quality == &SampleRow::level0_error;
  PlotPanel panel;
  panel.title = label + fmt::format(", guidance {:g}", guidance_scale);
  panel.x = {"seconds for both levels", AxisScale::kLog, 0, 0};
  panel.y = {label, error ? AxisScale::kLog : AxisScale::kLinear, 0, 0};
  std::vector<std::pair<double, double>> all;
  for (const auto& row : means) {
    if (row.guidance_scale != guidance_scale || !std::isfinite(row.*quality)) continue;
    if (error && row.variant == "reference") continue;
    auto series = std::find_if(panel.series.begin(), panel.series.end(),
                               [&](const PlotSeries& entry) { return entry.name == row.variant; });
    if (series == panel.series.end()) {
      panel.series.push_back({row.variant, SeriesStyle::kLine, {}});
      series = panel.series.end() - 1;
    }
    series->points.emplace_back(row.seconds, row.*quality);
    // The front minimises; quality in dB is better when larger.
    all.emplace_back(row.seconds, error ? row.*quality : -(row.*quality));
  }
  auto front = pareto_front(all);
  if (!error) {
    for (auto& point : front) point.second = -point.second;
  }
  panel.series.push_back({"Pareto front", SeriesStyle::kFront, front});
  return panel;
}

bool has_quality(const std::vector<SampleRow>& rows) {
  return std::any_of(rows.begin(), rows.end(), [](const SampleRow& row) { return std::isfinite(row.psnr); });
}

Figure sample_figure(const std::vector<SampleRow>& means, double guidance_scale) {
  Figure figure;
  figure.title = "Sampling: error and quality against time";
  figure.panels = {work_panel(means, &SampleRow::level0_error, "relative latent error", guidance_scale)};
  if (has_quality(means))
    figure.panels.push_back(work_panel(means, &SampleRow::psnr, "PSNR (dB)", guidance_scale));
  return figure;
}

}  // namespace

void SampleBenchmarkOptions::visit(FieldVisitor& visitor) {
  visitor.text({"model", "model bundle: a folder with model.yaml"}, model);
  visitor.text({"scene", "folder of a scene, or of several"}, scene);
  visitor.integer({"max_scenes", "how many scenes of the folder to take"}, max_scenes, {1, 100000});
  visitor.group({"reading", "how scenes are read"}, reading);
  visitor.group({"views", "which views"}, views);
  visitor.text({"size", "WIDTHxHEIGHT in pixels, or auto: the trained size of the nearest aspect"}, size);
  visitor.integer({"seed", "seed of the noise"}, seed, {0});
  visitor.integers({"counts", "function evaluations a level to try"}, counts, {1, 100000});
  visitor.reals({"guidance_scales", "guidance scales to try; the last is plotted"}, guidance_scales,
                {0, 1000});
  visitor.real({"reference_tolerance", "tolerance of the adaptive reference solve"}, reference_tolerance,
               {1e-10, 0.1});
  visitor.text({"device", "cpu, cuda or cuda:N"}, device);
  visitor.integer({"threads", "threads; 0: one a core"}, threads, {0, 4096});
  visitor.text({"out", "run folder to write"}, out);
}

void SampleBenchmarkOptions::check() const {
  if (scene.empty()) {
    fail({"--scene", "a folder of images with cameras", "nothing", "add for example --scene my_photos"});
  }
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
    early.name += ", guided from t = 0.9";
    variants.push_back(early);
    auto adaptive = variant_of(SolverKind::kUniPc3, ScheduleKind::kLogSnr, count, guidance_scale);
    adaptive.guidance.guidance_tolerance = 0.01;
    adaptive.name += ", guidance dropped below 0.01";
    variants.push_back(adaptive);
  }
  return variants;
}

Table sample_table(const std::vector<SampleRow>& rows) {
  Table table({"scene", "variant", "guidance_scale", "evaluations", "unconditional", "level1_error",
               "level0_error", "psnr", "ssim", "seconds", "peak_bytes", "non_finite"});
  for (const auto& row : rows) {
    table.add_row({row.scene, row.variant, row.guidance_scale, row.evaluations, row.unconditional,
                   row.level1_error, row.level0_error, row.psnr, row.ssim, row.seconds, row.peak_bytes,
                   row.non_finite});
  }
  return table;
}

std::vector<SampleRow> mean_over_scenes(const std::vector<SampleRow>& rows) {
  // Rows of one variant differ in evaluations where the reference is adaptive; its mean is taken as well.
  struct Group {
    SampleRow sum;
    int64_t count = 0;
    int64_t key_evaluations = 0;
  };
  std::vector<Group> groups;
  for (const auto& row : rows) {
    auto group = std::find_if(groups.begin(), groups.end(), [&](const Group& candidate) {
      return candidate.sum.variant == row.variant && candidate.sum.guidance_scale == row.guidance_scale &&
             (row.variant == "reference" || candidate.key_evaluations == row.evaluations);
    });
    if (group == groups.end()) {
      groups.push_back({row, 1, row.evaluations});
      groups.back().sum.scene = "mean";
      continue;
    }
    auto& sum = group->sum;
    sum.evaluations += row.evaluations;
    sum.unconditional += row.unconditional;
    sum.level1_error += row.level1_error;
    sum.level0_error += row.level0_error;
    sum.psnr += row.psnr;
    sum.ssim += row.ssim;
    sum.seconds += row.seconds;
    sum.peak_bytes = std::max(sum.peak_bytes, row.peak_bytes);
    sum.non_finite += row.non_finite;
    ++group->count;
  }
  std::vector<SampleRow> means;
  for (auto& group : groups) {
    const auto count = static_cast<double>(group.count);
    auto& mean = group.sum;
    mean.evaluations /= group.count;
    mean.unconditional /= group.count;
    for (double* value : {&mean.level1_error, &mean.level0_error, &mean.psnr, &mean.ssim, &mean.seconds})
      *value /= count;
    means.push_back(mean);
  }
  return means;
}

int run_sample_benchmark(const SampleBenchmarkOptions& options) {
  install_interrupt_handler();
  set_thread_count(options.threads > 0 ? static_cast<int>(options.threads)
                                       : static_cast<int>(std::max(1U, std::thread::hardware_concurrency())));
  const auto bundle = ModelBundle::open(options.model);
  auto locations = list_scenes(options.scene, options.reading);
  locations.resize(std::min(locations.size(), static_cast<size_t>(options.max_scenes)));
  RunFolder folder(options.out, "bench sample", options);
  size_t total = 0;
  for (const double scale : options.guidance_scales)
    total += 1 + sampling_variants(options.counts, scale).size();
  total *= locations.size();

  std::vector<SampleRow> rows;
  Progress progress("bench sample", static_cast<int64_t>(total));
  const auto keep = [&](const SampleRow& row) {
    rows.push_back(row);
    write_file_atomically(folder.path() / "sample.csv", sample_table(rows).csv());
    progress.update(static_cast<int64_t>(rows.size()), row.scene + ": " + row.variant);
    stop_if_interrupted(fmt::format("{} of {} samples are in sample.csv", rows.size(), total));
  };
  for (const auto& location : locations) {
    SceneSampler sampler(bundle, load_scene(location, options, bundle.options()), options);
    for (const double scale : options.guidance_scales) {
      sampler.solve_reference(options.reference_tolerance, scale);
      keep(sampler.reference_row());
      for (const auto& variant : sampling_variants(options.counts, scale)) keep(sampler.measure(variant));
    }
  }
  progress.finish();

  const auto means = mean_over_scenes(rows);
  const std::string text =
      fmt::format(
          "# Sampling: error, quality and time\n\nModel {}, {} scenes. Latent errors are relative to a "
          "Dormand-Prince solve of the same noise at tolerance {:g}; evaluations, seconds and memory are of "
          "both levels together.\n\n",
          bundle.options().name, locations.size(), options.reference_tolerance) +
      sample_table(means).markdown();
  write_file_atomically(folder.path() / "sample.md", text);
  const auto figure = sample_figure(means, options.guidance_scales.back());
  write_svg(figure, folder.path() / "sample.svg");
  write_png(figure, folder.path() / "sample.png");
  folder.write_report({{"command", "bench sample"},
                       {"options", to_json(options)},
                       {"model_hash", bundle.content_hash()},
                       {"scenes", locations.size()},
                       {"samples", rows.size()},
                       {"threads", thread_count()}});
  std::cout << text << "\n";
  folder.note("every sample", "sample.csv");
  folder.note("means", "sample.md");
  folder.note("error and quality against time", "sample.png");
  folder.note("report", "report.json");
  std::cout << folder.closing_box();
  return 0;
}

}  // namespace gld
