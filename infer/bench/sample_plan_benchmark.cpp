#include "infer/bench/sample_plan_benchmark.h"

#include "datasets/loading/dataset.h"
#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/machine/precision_option.h"
#include "gld/metrics/metric_list.h"
#include "gld/report/benchmark_results.h"
#include "gld/report/progress.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/device.h"
#include "gld/tensors/torch_version.h"
#include "infer/bench/benchmark_precisions.h"
#include "infer/bench/relative_rms.h"
#include "infer/bench/sample_plan_table.h"
#include "infer/method/plan_errors.h"
#include "infer/pipeline/bundle_models.h"
#include "infer/pipeline/held_out_scenes.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "infer/pipeline/scene_request.h"
#include "models/cost/cost_model.h"

#include <algorithm>
#include <atomic>
#include <exception>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

#include <fmt/format.h>

namespace gld {
namespace {

// What is measured is cheap to run again, and none of it fits twice beside a full-size model.
bool small_scene(const LatentGrid& grid) {
  constexpr int64_t kMostTokens = 1024;
  return grid.views * grid.tokens_per_view() <= kMostTokens;
}

// A scene and everything that does not depend on how it is sampled.
struct BenchScene {
  std::string name;
  PipelineRequest request;  // without the method
  torch::Tensor truth;      // (targets, 3, height, width)
};

BenchScene load_bench_scene(const Dataset& dataset, int64_t index, const SamplePlanBenchmarkOptions& options,
                            const BundleOptions& bundle) {
  const SampleKey key = held_out_key(options.synthetic_seed, index);
  const SamplingScene scene = load_held_out_scene(dataset.scene(index), options.views, key, bundle);
  return {scene.name, scene_request(scene, bundle, options.seed + index, device_from_text(options.device)),
          stacked(scene.true_images)};
}

// M1 and cascade, from what ran; and with visible pairs what it took to know them.
double flop_of(const PipelineResult& result, const BundleOptions& bundle, int64_t num_sources) {
  const double kept = result.view_pairs ? result.view_pairs->kept() : 1;
  double flop = 0;
  for (const auto& flow : result.flows) {
    const DitOptions& model = bundle.generator(flow.generator).dit;
    const auto add = [&](const Cost& cost, int64_t runs) {
      flop += static_cast<double>(runs) * (cost.linear_flop + kept * cost.attention_flop);
    };
    add(condition_encoder_cost(model, result.grid), flow.counts.condition_encoder);
    add(velocity_decoder_cost(model, result.grid), flow.counts.velocity_decoder);
  }
  if (result.view_pairs && num_sources > 1) {
    LatentGrid sources = result.grid;
    sources.views = num_sources;
    flop += bundle.backbone.architecture()
                .propagation_cost(sources, bundle.level_set().deepest_generated())
                .flop() +
            bundle.dpt_head.cost(sources, GeometryMaps::kDepthAndRays).flop();
  }
  return flop;
}

struct Run {
  PipelineResult result;
  double seconds = 0;  // of M1 and the cascade, and of finding visible pairs
  int64_t peak_bytes = 0;
};

using ModelLoader = std::function<PipelineModels(ComputePrecision)>;

// For one thread at a time.
class Sampler {
 public:
  // compared: the methods, in float32, that will be measured in other precisions too.
  Sampler(const BundleOptions& bundle, ModelLoader load, double guidance_scale,
          std::vector<SamplingMethod> compared)
      : compared_(std::move(compared)), bundle_(bundle), load_(std::move(load)) {
    guidance_.guidance_scale = guidance_scale;
  }

  Run run(const BenchScene& scene, const SamplingMethod& method) {
    auto& models = models_[method.precision];
    if (!models) models = load_(method.precision);
    PipelineRequest request = scene.request;
    request.flow = flow_settings(method, guidance_, bundle_);
    StageRecords stages;
    Run run;
    run.result = run_pipeline(*models, request, stages);
    run.seconds = stage_seconds(models->levels, StageKind::kFlow, stages) +
                  stage_seconds(models->levels, StageKind::kViewPairs, stages);
    for (const auto& stage : stages.records()) {
      run.peak_bytes = std::max(run.peak_bytes, stage.peak_bytes);
    }
    return run;
  }

  PlanSample measure(const BenchScene& scene, const SamplingMethod& method, const Run& reference) {
    const auto mean_psnr = [](const torch::Tensor& truth, const torch::Tensor& images) {
      return measure_images(metric_named("psnr"), truth, images).mean();
    };
    const Run made = run(scene, method);
    PlanSample sample;
    sample.scene = scene.name;
    // The boundary level, which is generated first, and the shallowest.
    const auto& latents = made.result.latents;
    const auto& exact = reference.result.latents;
    sample.boundary_error = relative_rms(latents.rbegin()->second, exact.rbegin()->second);
    sample.shallowest_error = relative_rms(latents.begin()->second, exact.begin()->second);
    if (method.precision == ComputePrecision::kFloat32) {
      keep_float32_latents(scene, method, latents);
    } else {
      const auto other = latents_in_float32(scene, method);
      sample.precision_error = std::max(relative_rms(latents.rbegin()->second, other.rbegin()->second),
                                        relative_rms(latents.begin()->second, other.begin()->second));
    }
    sample.psnr = mean_psnr(scene.truth, made.result.images);
    sample.psnr_difference = sample.psnr - mean_psnr(scene.truth, reference.result.images);
    sample.psnr_to_reference = mean_psnr(reference.result.images, made.result.images);
    sample.flop = flop_of(made.result, bundle_, scene.request.views.num_sources);
    return sample;
  }

 private:
  using Latents = std::map<int64_t, torch::Tensor>;

  // Of one scene at a time, and of those methods alone that are measured in another precision too.
  void keep_float32_latents(const BenchScene& scene, const SamplingMethod& method, const Latents& latents) {
    if (kept_scene_ != scene.name) float32_latents_.clear();
    kept_scene_ = scene.name;
    const bool compared = std::any_of(compared_.begin(), compared_.end(), [&](const SamplingMethod& other) {
      return same_method(other, method);
    });
    if (compared) float32_latents_.emplace_back(method, latents);
  }
  // Of the same method, kept or sampled now.
  Latents latents_in_float32(const BenchScene& scene, SamplingMethod method) {
    method.precision = ComputePrecision::kFloat32;
    for (const auto& [known, latents] : float32_latents_) {
      if (kept_scene_ == scene.name && same_method(known, method)) return latents;
    }
    return run(scene, method).result.latents;
  }

  std::vector<SamplingMethod> compared_;  // in float32
  std::string kept_scene_;
  std::vector<std::pair<SamplingMethod, Latents>> float32_latents_;
  BundleOptions bundle_;
  ModelLoader load_;
  std::map<ComputePrecision, std::optional<PipelineModels>> models_;  // those that were needed
  GuidanceOptions guidance_;
};

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

// reference_error, of what errors refer to, is added to every bound.
PlanErrors errors_table(const std::vector<PlanRow>& rows, const ModelBundle& bundle,
                        const SamplePlanBenchmarkOptions& options, const LatentGrid& grid,
                        double reference_error) {
  PlanErrors table;
  table.model_hash = bundle.content_hash();
  table.scenes = static_cast<int64_t>(rows.front().samples.size());
  table.guidance_scale = options.guidance_scale;
  table.grid = grid;
  for (const auto& row : rows) {
    if (errors_of(table, row.variant.method)) continue;
    // Which pairs are left out, and what error that makes, is up to the scene: nothing to be expected of another one.
    if (row.variant.method.approximate.view_pairs != ViewPairs::kAll) continue;
    std::vector<double> errors;
    for (const auto& sample : row.samples) errors.push_back(sample.error());
    double of_precision = 0;
    for (const auto& sample : row.samples) of_precision = std::max(of_precision, sample.precision_error);
    table.methods.push_back({row.variant.method, row.mean_error, row.largest_error,
                             error_bound(errors) + reference_error, of_precision, row.seconds});
  }
  return table;
}

// What precisions other than float32 differ from it by, with the same method and noise.
std::string precisions_text(const std::vector<PlanRow>& rows) {
  Table table({"method", "precision_error_mean", "precision_error_largest", "limit"});
  bool any = false;
  for (const auto& row : rows) {
    const ComputePrecision precision = row.variant.method.precision;
    if (precision == ComputePrecision::kFloat32) continue;
    double mean = 0, largest = 0;
    for (const auto& sample : row.samples) {
      mean += sample.precision_error / static_cast<double>(row.samples.size());
      largest = std::max(largest, sample.precision_error);
    }
    table.add_row({row.variant.method.name, mean, largest, largest_automatic_error(precision)});
    any = true;
  }
  return any ? "\nAgainst the same method in float32, relative RMS of the latents, and above what --precision automatic "
               "leaves a precision out:\n\n" +
                   table.markdown()
             : "";
}

// The error of the reference itself, on the first scene: its distance from a solve with twice the evaluations.
double reference_error(Sampler& sampler, const BenchScene& scene, int64_t evaluations) {
  const Run twice = sampler.run(scene, exact_method(2 * evaluations));
  return sampler.measure(scene, exact_method(evaluations), twice).error();
}

}  // namespace

SamplePlanBenchmarkOptions::SamplePlanBenchmarkOptions() : views(held_out_views()) {}

void SamplePlanBenchmarkOptions::visit(FieldVisitor& visitor) {
  visitor.text({"model", "model bundle: a folder with model.yaml"}, model);
  visitor.integer({"synthetic", "number of generated scenes; with --scenes the most that are taken of them"},
                  synthetic, {2, 100000});
  visitor.integer({"synthetic_seed", "seed of the generated scenes; training must not have used it"},
                  synthetic_seed, {0, 1'000'000'000'000});
  visit_scenes(visitor, scenes, "generated ones");
  visitor.group({"generator", "generated scenes; seed and number come from the options above"}, generator);
  visitor.group({"views", "which frames are sources and targets"}, views);
  visitor.real({"guidance_scale", "guidance scale; errors hold up to it"}, guidance_scale, {0, 1000});
  visitor.integers({"counts", "evaluations a level of the default solver"}, counts, {2, 100000});
  visitor.texts(
      {"families", "kinds of methods to measure beside fewer evaluations, as the plot names them; none: all"},
      families);
  visitor.texts({"precisions", "to measure beside float32: bfloat16, bfloat16x3, int8"}, precisions);
  visitor.integer({"reference_evaluations", "evaluations a level of the solve that errors refer to"},
                  reference_evaluations, {8, 100000});
  visitor.integer({"repeats", "timed runs of each method, of which the shortest counts"}, repeats, {1, 100});
  visitor.integer({"workers", "scenes measured at the same time; 0: one a thread where scenes are small"},
                  workers, {0, 256});
  visitor.boolean({"write_table", "put plan_errors.json into the model bundle, where --tolerance finds it"},
                  write_table);
  visit_seed(visitor, seed, "the noise");
  visit_device(visitor, device);
  visit_threads(visitor, threads);
  visit_out(visitor, out, overwrite);
}

void SamplePlanBenchmarkOptions::check() const {
  check_out(out, "runs/plan");
  for (const ComputePrecision precision : benchmark_precisions(precisions))
    check_precision_on(device, precision);
  if (write_table && device != "cpu") {
    fail({"--write-table", "--device cpu, whose kernels the table's errors and seconds are of", device,
          "leave one of the two out"});
  }
  if (counts.size() < 2) {
    fail({"--counts", "at least two numbers of evaluations, to compare at equal work",
          std::to_string(counts.size()), "write for example 8,16"});
  }
  const auto repeated = std::adjacent_find(counts.begin(), counts.end(), std::greater_equal<>());
  if (repeated != counts.end()) {
    fail({"--counts", "each number once, in rising order",
          fmt::format("{} before {}", *repeated, *std::next(repeated)), "write for example 8,16"});
  }
  if (views.most_sources >= views.views) {
    fail({"views.most_sources", "fewer sources than views", std::to_string(views.most_sources),
          "leave at least one target"});
  }
}

int run_sample_plan_benchmark(const SamplePlanBenchmarkOptions& options) {
  const int threads = use_threads(options.threads);
  const auto bundle = ModelBundle::open(options.model);
  const auto device = device_from_text(options.device);
  const auto dataset =
      held_out_dataset(options.scenes, options.generator, options.synthetic_seed, options.synthetic);
  const int64_t scene_count = std::min(options.synthetic, dataset->size());

  std::vector<PlanRow> rows;
  auto variants = plan_variants(options.counts, bundle.options());
  for (const ComputePrecision precision : benchmark_precisions(options.precisions)) {
    if (precision == ComputePrecision::kFloat32) continue;
    for (auto& variant : precision_variants(options.counts, bundle.options(), precision)) {
      variants.push_back(std::move(variant));
    }
  }
  for (auto& variant : of_families(std::move(variants), options.families)) {
    PlanRow row;
    row.variant = std::move(variant);
    row.samples.resize(static_cast<size_t>(scene_count));
    rows.push_back(std::move(row));
  }
  std::vector<SamplingMethod> compared;
  for (const auto& row : rows) {
    if (row.variant.method.precision == ComputePrecision::kFloat32) continue;
    compared.push_back(row.variant.method);
    compared.back().precision = ComputePrecision::kFloat32;
  }
  RunFolder folder(options.out, "bench sample-plan", options, earlier_run(options.overwrite));
  const BenchScene first = load_bench_scene(*dataset, 0, options, bundle.options());
  const LatentGrid grid =
      bundle.options().backbone.grid_of(first.request.views.size(), first.truth.size(2), first.truth.size(3));
  const int64_t workers = std::min<int64_t>(scene_count, options.workers > 0 ? options.workers
                                                         : small_scene(grid) ? threads
                                                                             : 1);

  // Errors: every scene, several at a time.
  set_thread_count(std::max(1, threads / static_cast<int>(workers)));
  std::vector<std::unique_ptr<Sampler>> samplers;
  for (int64_t worker = 0; worker < workers; ++worker) {
    const auto load = [&](ComputePrecision precision) {
      return kept_bundle_models(bundle, device, precision);
    };
    samplers.push_back(std::make_unique<Sampler>(bundle.options(), load, options.guidance_scale, compared));
  }
  Progress progress("bench sample-plan", scene_count * static_cast<int64_t>(rows.size()));
  std::mutex mutex;
  int64_t done = 0;
  for_each_index(scene_count, workers, [&](int64_t worker, int64_t index) {
    const torch::NoGradGuard no_gradients;
    Sampler& sampler = *samplers[static_cast<size_t>(worker)];
    const BenchScene scene = load_bench_scene(*dataset, index, options, bundle.options());
    const Run reference = sampler.run(scene, exact_method(options.reference_evaluations));
    for (auto& row : rows) {
      stop_if_interrupted("errors were being measured; nothing was written");
      auto& sample = row.samples[static_cast<size_t>(index)];
      sample = sampler.measure(scene, row.variant.method, reference);
      const std::lock_guard<std::mutex> lock(mutex);
      progress.update(++done, scene.name);
    }
  });
  set_thread_count(threads);
  progress.finish();

  // Time and memory: one scene, one method after the other, with one stage's weights at a time as gld sample has them.
  const double of_reference = reference_error(*samplers.front(), first, options.reference_evaluations);
  samplers.clear();
  Sampler alone(bundle.options(),
                [&](ComputePrecision precision) { return bundle_models(bundle, device, precision); },
                options.guidance_scale, {});
  Progress timing("timing", options.repeats * static_cast<int64_t>(rows.size()));
  done = 0;
  for (int64_t repeat = 0; repeat < options.repeats; ++repeat) {
    for (auto& row : rows) {
      stop_if_interrupted("methods were being timed; nothing was written");
      const Run run = alone.run(first, row.variant.method);
      row.seconds = repeat == 0 ? run.seconds : std::min(row.seconds, run.seconds);
      row.peak_bytes = std::max(row.peak_bytes, run.peak_bytes);
      timing.update(++done, row.variant.method.name);
    }
  }
  timing.finish();

  summarise(rows);
  const BoundCheck bounds = check_bounds(rows);
  const PlanErrors table = errors_table(rows, bundle, options, grid, of_reference);
  const std::string table_text = plan_errors_json(table).dump(1) + "\n";
  const std::string text =
      fmt::format(
          "# Ways to sample\n"
          "\n"
          "Model {}, {} scenes of {} views ({}x{} tokens), guidance scale {:g}. "
          "Errors are relative RMS differences of the normalised latents (the worse of level 1 and level 0) "
          "from {} evaluations of the default solver with the same noise, "
          "whose own error is {:.2g} (against twice as many). "
          "GFLOP and seconds are of M1 and the cascade of one scene. "
          "`error_of_fewer_evaluations` is what the default solver has at the same GFLOP (of methods in float32: "
          "another precision saves time and not GFLOP). "
          "Error bounds from half of the scenes were exceeded by {} of {} samples of the other half.\n"
          "\n",
          bundle.options().name, scene_count, grid.views, grid.width, grid.height, options.guidance_scale,
          options.reference_evaluations, of_reference, bounds.exceeded, bounds.samples) +
      plan_row_table(rows).markdown() + precisions_text(rows);
  if (options.write_table) write_file_atomically(bundle.folder() / kPlanErrorsFile, table_text);
  BenchmarkResults results;
  results.text = text;
  results.files = {{"samples.csv", plan_sample_table(rows).csv()},
                   {"sample_plan.csv", plan_row_table(rows).csv()},
                   {"sample_plan.md", text},
                   {kPlanErrorsFile, table_text}};
  results.figures = {{"sample_plan", plan_figure(rows)}};
  results.report = {{"command", "bench sample-plan"},
                    {"options", to_json(options)},
                    {"model_hash", table.model_hash},
                    {"scenes", scene_count},
                    {"methods", rows.size()},
                    {"reference_error", of_reference},
                    {"bound_samples", bounds.samples},
                    {"bound_exceeded", bounds.exceeded},
                    {"workers", workers},
                    {"threads", threads}};
  results.notes = {{"methods", "sample_plan.csv"},
                   {"table", "sample_plan.md"},
                   {"error and quality against work and time", "sample_plan.png"},
                   {"every sample", "samples.csv"},
                   {"measured errors for --tolerance", kPlanErrorsFile}};
  finish_benchmark(folder, results);
  return 0;
}

}  // namespace gld
