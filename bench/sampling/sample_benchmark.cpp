#include "bench/sampling/sample_benchmark.h"

#include "bench/sampling/sample_table.h"
#include "bench/sampling/scene_sampler.h"
#include "bench/support/benchmark_precisions.h"
#include "bench/support/benchmark_report.h"
#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/machine/precision_option.h"
#include "gld/report/progress.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/device.h"
#include "gld/tensors/torch_version.h"
#include "infer/method/plan_errors.h"
#include "infer/pipeline/bundle_models.h"
#include "infer/request/held_out_scenes.h"
#include "infer/request/scene_request.h"

#include <atomic>
#include <exception>
#include <filesystem>
#include <functional>
#include <mutex>
#include <set>
#include <thread>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr int64_t kMostReferenceEvaluations = 20000;

// Returns whether the scene is small: what is measured is then cheap to run again, and none of it fits twice beside a
// full-size model.
bool small_scene(const LatentGrid& grid) {
  constexpr int64_t kMostTokens = 1024;
  return grid.views * grid.tokens_per_view() <= kMostTokens;
}

// Loading a model anew for each sample would hide what a small one takes; of a large one only the present stage's
// weights fit beside each other, as in gld sample.
PipelineModels models_of(const ModelBundle& bundle, const torch::Device& device, ComputePrecision precision) {
  constexpr uintmax_t kKeptBytes = 1'000'000'000;
  uintmax_t bytes = 0;
  for (const auto& entry : std::filesystem::directory_iterator(bundle.folder())) {
    if (entry.is_regular_file()) bytes += entry.file_size();
  }
  return bytes <= kKeptBytes ? kept_bundle_models(bundle, device, precision)
                             : bundle_models(bundle, device, precision);
}

// The scenes to sample, loaded one at a time.
class BenchmarkScenes {
 public:
  BenchmarkScenes(const SampleBenchmarkOptions& options, const BundleOptions& bundle)
      : options_(options), bundle_(bundle) {
    if (!options.scenes.empty()) {
      dataset_ = std::make_unique<FolderDataset>(options.scenes, options.reading);
      return;
    }
    SyntheticOptions generator = options.generator;
    const SyntheticOptions usual;
    if (generator.width == usual.width && generator.height == usual.height) {
      const auto trained = bundle.image_sizes().front();
      generator.width = trained.width;
      generator.height = trained.height;
    }
    dataset_ = held_out_dataset({}, generator, options.synthetic_seed, options.synthetic);
  }

  int64_t size() const {
    return options_.scenes.empty() ? dataset_->size() : std::min(options_.max_scenes, dataset_->size());
  }

  BenchmarkScene load(int64_t index) const {
    const Scene scene = dataset_->scene(index);
    const SampleKey key = held_out_key(options_.synthetic_seed, index);
    const bool given = !options_.views.sources.empty();
    const SamplingScene loaded =
        given ? load_sampling_scene(
                    scene, options_.views,
                    choose_size(options_.size, scene, bundle_.image_sizes(), bundle_.backbone.patch_side()))
              : load_held_out_scene(scene, options_.drawn_views, key, bundle_);
    BenchmarkScene result;
    result.name = loaded.name;
    result.request = scene_request(loaded, bundle_, options_.seed + index, device_from_text(options_.device));
    result.grid = bundle_.backbone.grid_of(loaded.views.size(), loaded.size.height, loaded.size.width);
    const auto& truth = loaded.true_images;
    if (!truth.empty() &&
        std::none_of(truth.begin(), truth.end(), [](const Image& image) { return image.empty(); })) {
      result.truth = stacked(truth);
    }
    return result;
  }

 private:
  const SampleBenchmarkOptions& options_;
  const BundleOptions& bundle_;
  std::unique_ptr<Dataset> dataset_;
};

// Returns what errors refer to: the default solver with many evaluations, or an adaptive one.
ComparedMethod reference_method(const SampleBenchmarkOptions& options, double guidance_scale,
                                double refinement) {
  ComparedMethod reference;
  reference.guidance_scale = guidance_scale;
  if (options.reference_tolerance == 0) {
    reference.method =
        plain_method(std::lround(static_cast<double>(options.reference_evaluations) * refinement));
    return reference;
  }
  reference.method.name = "reference";
  reference.method.solver.solver = SolverKind::kDormandPrince;
  reference.method.solver.tolerance = options.reference_tolerance / refinement;
  reference.method.solver.max_evaluations = kMostReferenceEvaluations;
  return reference;
}

std::string reference_text(const SampleBenchmarkOptions& options) {
  return options.reference_tolerance == 0
             ? fmt::format("{} evaluations of the default solver", options.reference_evaluations)
             : fmt::format("a Dormand-Prince solve at tolerance {:g}", options.reference_tolerance);
}

// Calls work(worker, index) for every index, several at a time; rethrows what the first failure threw.
void for_each_index(int64_t count, int64_t workers, const std::function<void(int64_t, int64_t)>& work) {
  std::atomic<int64_t> next{0};
  std::mutex mutex;
  std::exception_ptr problem;
  const auto loop = [&](int64_t worker) {
    for (int64_t i = next++; i < count; i = next++) {
      try {
        work(worker, i);
      } catch (...) {
        const std::lock_guard<std::mutex> lock(mutex);
        if (!problem) problem = std::current_exception();
        next = count;
      }
    }
  };
  std::vector<std::thread> threads;
  for (int64_t worker = 1; worker < workers; ++worker) threads.emplace_back(loop, worker);
  loop(0);
  for (auto& thread : threads) thread.join();
  if (problem) std::rethrow_exception(problem);
}

// The table is of the methods that --tolerance may take, with the largest guidance scale: errors hold up to it.
// reference_error, of what errors refer to, is added to every bound.
PlanErrors errors_table(const std::vector<MethodRow>& rows, const ModelBundle& bundle,
                        const SampleBenchmarkOptions& options, const LatentGrid& grid,
                        double reference_error) {
  PlanErrors table;
  table.model_hash = bundle.content_hash();
  table.guidance_scale = *std::max_element(options.guidance_scales.begin(), options.guidance_scales.end());
  table.grid = grid;
  for (const auto& row : rows) {
    table.scenes = static_cast<int64_t>(row.samples.size());
    if (row.compared.guidance_scale != table.guidance_scale || !row.compared.is_offered() || !row.finite())
      continue;
    std::vector<double> errors;
    double of_precision = 0;
    for (const Sample& sample : row.samples) {
      errors.push_back(sample.error());
      of_precision = std::max(of_precision, sample.precision_error);
    }
    table.methods.push_back({row.compared.method, row.mean_error, row.largest_error,
                             error_bound(errors) + reference_error, of_precision, row.seconds});
  }
  return table;
}

std::vector<MethodRow> rows_of(const SampleBenchmarkOptions& options, const BundleOptions& bundle,
                               int64_t scenes) {
  std::vector<ComparedMethod> methods;
  for (const double scale : options.guidance_scales) {
    for (auto& method :
         compared_methods(options.counts, benchmark_precisions(options.precisions), scale, bundle)) {
      methods.push_back(std::move(method));
    }
  }
  std::vector<MethodRow> rows;
  for (auto& method : of_families(std::move(methods), options.families)) {
    MethodRow row;
    row.compared = std::move(method);
    row.samples.resize(static_cast<size_t>(scenes));
    rows.push_back(std::move(row));
  }
  return rows;
}

// Everything of one run of the benchmark.
struct Comparison {
  std::vector<MethodRow> rows;
  std::map<double, std::vector<Sample>> references;  // by guidance scale, one a scene
  LatentGrid grid;                                   // of the first scene
  int64_t workers = 1;
  double reference_error = 0;  // of the reference itself, on the first scene
};

int64_t workers_of(const SampleBenchmarkOptions& options, const Comparison& comparison, int64_t scenes,
                   int threads) {
  const int64_t wanted = options.workers > 0 ? options.workers : small_scene(comparison.grid) ? threads : 1;
  return std::min(wanted, scenes);
}

// Errors are measured on every scene, several at a time.
void measure_errors(const SampleBenchmarkOptions& options, const ModelBundle& bundle,
                    const BenchmarkScenes& scenes, int threads, const RunFolder& folder,
                    Comparison& comparison) {
  const auto device = device_from_text(options.device);
  const std::shared_ptr<Lpips> lpips = load_lpips(options.lpips);
  std::vector<std::unique_ptr<SceneSampler>> samplers;
  for (int64_t worker = 0; worker < comparison.workers; ++worker) {
    samplers.push_back(std::make_unique<SceneSampler>(
        bundle.options(), [&](ComputePrecision precision) { return models_of(bundle, device, precision); },
        lpips));
  }
  set_thread_count(std::max(1, threads / static_cast<int>(comparison.workers)));
  const auto total =
      scenes.size() * static_cast<int64_t>(comparison.rows.size() + comparison.references.size());
  Progress progress("bench sample", total);
  std::mutex mutex;
  int64_t done = 0;
  const auto keep = [&](Sample& place, Sample sample, const std::string& method) {
    const std::lock_guard<std::mutex> lock(mutex);
    place = std::move(sample);
    write_file_atomically(folder.path() / "sample.csv",
                          sample_table(comparison.rows, comparison.references).csv());
    progress.update(++done, place.scene + ": " + method);
    stop_if_interrupted(fmt::format("{} of {} samples are in sample.csv", done, total));
  };
  for_each_index(scenes.size(), comparison.workers, [&](int64_t worker, int64_t index) {
    const torch::NoGradGuard no_gradients;
    SceneSampler& sampler = *samplers[static_cast<size_t>(worker)];
    const BenchmarkScene scene = scenes.load(index);
    for (auto& [scale, references] : comparison.references) {
      const SampledScene reference = sampler.run(scene, reference_method(options, scale, 1));
      keep(references[static_cast<size_t>(index)], sampler.reference_sample(scene, reference), "reference");
      for (auto& row : comparison.rows) {
        if (row.compared.guidance_scale != scale) continue;
        keep(row.samples[static_cast<size_t>(index)], sampler.measure(scene, row.compared, reference),
             row.compared.method.name);
      }
    }
  });
  set_thread_count(threads);
  progress.finish();
  const torch::NoGradGuard no_gradients;
  // The table of errors is of the largest scale.
  const double scale = *std::max_element(options.guidance_scales.begin(), options.guidance_scales.end());
  const BenchmarkScene first = scenes.load(0);
  const SampledScene finer = samplers.front()->run(first, reference_method(options, scale, 2));
  comparison.reference_error =
      samplers.front()->measure(first, reference_method(options, scale, 1), finer).error();
}

// Time and memory are measured on one scene, one method after the other, with one stage's weights at a time as gld
// sample has them.
void measure_times(const SampleBenchmarkOptions& options, const ModelBundle& bundle,
                   const BenchmarkScenes& scenes, Comparison& comparison) {
  const auto device = device_from_text(options.device);
  const torch::NoGradGuard no_gradients;
  SceneSampler alone(bundle.options(),
                     [&](ComputePrecision precision) { return bundle_models(bundle, device, precision); },
                     {});
  const BenchmarkScene first = scenes.load(0);
  Progress progress("timing", options.repeats * static_cast<int64_t>(comparison.rows.size()));
  int64_t done = 0;
  for (int64_t repeat = 0; repeat < options.repeats; ++repeat) {
    for (auto& row : comparison.rows) {
      stop_if_interrupted("methods were being timed; every sample is in sample.csv");
      const SampledScene run = alone.run(first, row.compared);
      row.seconds = repeat == 0 ? run.seconds : std::min(row.seconds, run.seconds);
      row.peak_bytes = std::max(row.peak_bytes, run.peak_bytes);
      progress.update(++done, row.compared.method.name);
    }
  }
  progress.finish();
}

std::string report_text(const SampleBenchmarkOptions& options, const BundleOptions& bundle,
                        const Comparison& comparison, const BoundCheck& bounds, int64_t scenes) {
  const LatentGrid& grid = comparison.grid;
  return fmt::format(
             "# Ways to sample\n"
             "\n"
             "Model {}, {} scenes of {} views ({}x{} tokens). "
             "Errors are relative RMS differences of the normalised latents (the worse of level 1 and level 0) "
             "from {} with the same noise, whose own error is {:.2g} (against a finer one). "
             "GFLOP and seconds are of M1, the cascade and a refiner of what they made, of one scene; `count` is evaluations a level. "
             "`error_at_equal_gflop` and `error_at_equal_seconds` are what the default solver has for as much "
             "(another precision saves time and not GFLOP); `pareto` says on which front of a guidance scale a row "
             "is: of seconds and mean_error, or of seconds and PSNR. "
             "Error bounds from half of the scenes were exceeded by {} of {} samples of the other half.\n"
             "\n",
             bundle.name, scenes, grid.views, grid.width, grid.height, reference_text(options),
             comparison.reference_error, bounds.exceeded, bounds.samples) +
         method_table(comparison.rows).markdown() + precisions_text(comparison.rows);
}

}  // namespace

void BenchmarkViews::check() const {
  ViewSelection::check();
  if (!sources.empty() || !targets.empty() || !path.path.empty()) require_complete();
}

SampleBenchmarkOptions::SampleBenchmarkOptions() : drawn_views(held_out_views()) {}

void SampleBenchmarkOptions::visit(FieldVisitor& visitor) {
  visitor.text({"model", "model bundle: a folder with model.yaml"}, model);
  visit_scenes(visitor, scenes, "generated ones");
  visitor.integer({"max_scenes", "how many scenes of --scenes to take"}, max_scenes, {1, 100000});
  visitor.integer({"synthetic", "number of generated scenes, in the place of --scenes"}, synthetic,
                  {0, 100000});
  visitor.integer({"synthetic_seed", "seed of the generated scenes; training must not have used it"},
                  synthetic_seed, {0, 1'000'000'000'000});
  visitor.group({"generator",
                 "generated scenes; seed and number come from the options above, and the size from the "
                 "model where it is the usual one"},
                generator);
  visitor.group({"reading", "how scenes are read"}, reading);
  visitor.group({"views", "frames that are views in every scene of --scenes; none: they are drawn"}, views);
  visitor.group({"drawn_views", "which frames are drawn as sources and targets"}, drawn_views);
  visitor.text(
      {"size", "of given views: WIDTHxHEIGHT in pixels, or auto: the trained size of the nearest aspect"},
      size);
  visitor.integers({"counts", "evaluations a level of every solver"}, counts, {1, 100000});
  visitor.reals({"guidance_scales",
                 "guidance scales; the last is plotted, and errors of the table hold up to "
                 "the largest"},
                guidance_scales, {0, 1000});
  visitor.texts(
      {"families", "kinds of methods to measure beside fewer evaluations, as the plot names them; none: all"},
      families);
  visitor.texts({"precisions", "to measure beside float32: bfloat16, int8"}, precisions);
  visitor.integer({"reference_evaluations", "evaluations a level of the solve that errors refer to"},
                  reference_evaluations, {8, 100000});
  visitor.real(
      {"reference_tolerance", "of an adaptive solve that errors refer to instead (Dormand-Prince); 0: none"},
      reference_tolerance, {0, 0.1});
  visitor.integer({"repeats", "timed runs of each method, of which the shortest counts"}, repeats, {1, 100});
  visitor.integer({"workers", "scenes measured at the same time; 0: one a thread where scenes are small"},
                  workers, {0, 256});
  visitor.boolean({"write_table", "put plan_errors.json into the model bundle, where --tolerance finds it"},
                  write_table);
  lpips.visit(visitor);
  visit_seed(visitor, seed, "the first scene's noise, each next scene has the next one");
  visit_device(visitor, device);
  visit_threads(visitor, threads);
  visit_out(visitor, out, overwrite);
}

void SampleBenchmarkOptions::check() const {
  if (scenes.empty() == (synthetic == 0)) {
    fail({"--scenes, --synthetic", "either folders of scenes or a number of generated scenes",
          scenes.empty() ? "neither" : "both", "add for example --synthetic 4"});
  }
  lpips.check();
  check_out(out, "runs/bench");
  for (const ComputePrecision precision : benchmark_precisions(precisions))
    check_precision_on(device, precision);
  if (write_table && device != "cpu") {
    fail({"--write-table", "--device cpu, whose kernels the table's errors and seconds are of", device,
          "leave one of the two out"});
  }
  if (counts.empty() || guidance_scales.empty()) {
    fail(
        {"counts and guidance_scales", "at least one value each", "an empty list", "write for example [16]"});
  }
  const auto repeated = std::adjacent_find(counts.begin(), counts.end(), std::greater_equal<>());
  if (repeated != counts.end()) {
    fail({"--counts", "each number once, in rising order",
          fmt::format("{} before {}", *repeated, *std::next(repeated)), "write for example 8,16"});
  }
  if (drawn_views.most_sources >= drawn_views.views) {
    fail({"drawn_views.most_sources", "fewer sources than views", std::to_string(drawn_views.most_sources),
          "leave at least one target"});
  }
}

int run_sample_benchmark(const SampleBenchmarkOptions& options) {
  const int threads = use_threads(options.threads);
  const auto bundle = ModelBundle::open(options.model);
  const BenchmarkScenes scenes(options, bundle.options());
  Comparison comparison;
  comparison.rows = rows_of(options, bundle.options(), scenes.size());
  for (const double scale : options.guidance_scales)
    comparison.references[scale].resize(static_cast<size_t>(scenes.size()));
  RunFolder folder(options.out, "bench sample", options, earlier_run(options.overwrite));
  comparison.grid = scenes.load(0).grid;
  comparison.workers = workers_of(options, comparison, scenes.size(), threads);
  measure_errors(options, bundle, scenes, threads, folder, comparison);
  measure_times(options, bundle, scenes, comparison);

  summarise(comparison.rows, comparison.references);
  const BoundCheck bounds = check_bounds(comparison.rows);
  const PlanErrors table =
      errors_table(comparison.rows, bundle, options, comparison.grid, comparison.reference_error);
  const std::string table_text = plan_errors_json(table).dump(1) + "\n";
  if (options.write_table) write_file_atomically(bundle.folder() / kPlanErrorsFile, table_text);
  BenchmarkResults results;
  results.text = report_text(options, bundle.options(), comparison, bounds, scenes.size());
  results.files = {{"sample.csv", sample_table(comparison.rows, comparison.references).csv()},
                   {"methods.csv", method_table(comparison.rows).csv()},
                   {"sample.md", results.text},
                   {kPlanErrorsFile, table_text}};
  results.figures = {{"sample", sample_figure(comparison.rows, options.guidance_scales.back())}};
  results.report = {{"command", "bench sample"},         {"options", to_json(options)},
                    {"model_hash", table.model_hash},    {"scenes", scenes.size()},
                    {"methods", comparison.rows.size()}, {"reference_error", comparison.reference_error},
                    {"bound_samples", bounds.samples},   {"bound_exceeded", bounds.exceeded},
                    {"workers", comparison.workers},     {"threads", threads}};
  results.notes = {{"methods", "methods.csv"},
                   {"table", "sample.md"},
                   {"error and quality against work and time", "sample.png"},
                   {"every sample", "sample.csv"},
                   {"measured errors for --tolerance", kPlanErrorsFile}};
  return finish_measured_benchmark(folder, results);
}

}  // namespace gld
