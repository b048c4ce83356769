#include "infer/forecast/doctor.h"

#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/machine/instruction_set.h"
#include "gld/machine/matrix_unit.h"
#include "gld/machine/stage_record.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/process_libraries.h"
#include "gld/tensors/torch_version.h"
#include "infer/forecast/machine_rates.h"
#include "infer/forecast/plan_report.h"
#include "infer/forecast/sampling_plan.h"
#include "infer/method/sampling_method.h"
#include "infer/pipeline/bundle_models.h"
#include "models/bundle/bundle.h"

#include <optional>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

struct Machine {
  std::string torch;
  std::string blas;
  std::vector<std::string> openmp;           // paths of the runtimes
  std::vector<std::string> process_engines;  // of this build
  std::string instruction_set;
  int cores = 1;
  int threads = 1;
  int64_t total_memory = 0;
  int64_t available_memory = 0;
  MachineSpeed speed;
  std::string origin;               // of the speed, a sentence
  std::vector<std::string> doubts;  // about it
};

Machine examine_machine(const DoctorOptions& options) {
  Machine machine;
  machine.torch = torch_version();
  machine.blas = blas_name();
  machine.openmp = openmp_runtimes();
  machine.instruction_set = instruction_set_name(best_instruction_set());
  machine.cores = static_cast<int>(threads_to_use(0));
  machine.threads = thread_count();
  machine.total_memory = total_memory_bytes();
  machine.available_memory = available_memory_bytes();
  const auto file = machine_rates_file();
  const auto kept =
      options.measure || file.empty() ? std::nullopt : kept_machine_speed(file, present_rate_key());
  const KnownSpeed known = kept ? known_machine_speed() : renew_machine_speed();
  machine.speed = known.speed;
  machine.origin =
      kept ? known.origin + ", kept in " + file.string() + "; --measure renews them" : known.origin;
  machine.doubts = known.doubts;
  return machine;
}

std::vector<std::string> complaints(const Machine& machine) {
  std::vector<std::string> list = machine.doubts;
  if (machine.blas == "reference") {
    list.emplace_back(
        "libblas.so.3 is the reference BLAS, tens of times too slow: install libopenblas0-pthread.");
  } else if (machine.speed.matrix_product < 0.4 * machine.speed.multiply_add_peak) {
    list.push_back(fmt::format(
        "BLAS products reach {:.0f} % of the multiply-add peak; a good BLAS reaches 75 % or more: install "
        "libopenblas0-pthread, or stop what else is running.",
        100 * machine.speed.matrix_product / machine.speed.multiply_add_peak));
  }
  if (machine.openmp.size() > 1) {
    list.push_back(fmt::format(
        "{} OpenMP runtimes are in the process, each with threads of its own that take the cores from the other: "
        "configure the build anew, which links the one that LibTorch brings.",
        machine.openmp.size()));
  }
  for (auto& warning : thread_warnings(machine.threads)) list.push_back(std::move(warning));
  if (machine.threads < machine.cores) {
    list.push_back(fmt::format("{} of {} cores are used: raise --threads.", machine.threads, machine.cores));
  }
  return list;
}

struct Forecast {
  SamplingPlan plan;
  std::string memory_problem;  // empty where it fits
  std::vector<std::string> advice;
};

std::string memory_problem_of(const SamplingPlan& plan, const Machine& machine) {
  if (machine.available_memory <= 0 || plan.peak_bytes() <= machine.available_memory) return "";
  return fmt::format(
      "The forecast needs {} and {} are free: use fewer views, a smaller --size, or close programs.",
      bytes_text(plan.peak_bytes()), bytes_text(machine.available_memory));
}

std::vector<std::string> advice_for(const SamplingPlan& plan, const DoctorOptions& options) {
  std::vector<std::string> advice;
  int64_t guided = 0, evaluations = 0;  // of flows: other stages run once, without guidance
  for (const auto& stage : plan.stages) {
    if (stage.kind != StageKind::kFlow) continue;
    guided += stage.with_unconditional;
    evaluations += stage.evaluations;
  }
  if (guided > 0) {
    advice.push_back(
        fmt::format("Guidance doubles {} of {} evaluations: --guidance-scale 1 removes it, "
                    "--guidance-interval 0.9,1 keeps it where it matters most.",
                    guided, evaluations));
  }
  if (options.solver.evaluations > 16 && !is_adaptive(options.solver.solver)) {
    advice.emplace_back(
        "A second-order solver with 16 evaluations (the default) comes closer to the exact solution "
        "than 49 Euler steps on the published grid.");
  }
  advice.emplace_back(
      "Time grows with the square of views x tokens: half the views take a third of the time.");
  return advice;
}

// Checks what can be told before the machine is measured.
void check_forecast(const DoctorOptions& options) {
  const ImageSize size = image_size_from_text(options.size, "--size");
  if (!options.model.empty()) {
    ModelBundle::open(options.model).options().backbone.grid_of(options.views, size.height, size.width);
  }
}

Forecast forecast(const DoctorOptions& options, const Machine& machine) {
  const ModelBundle bundle = ModelBundle::open(options.model);
  const ImageSize size = image_size_from_text(options.size, "--size");
  PlanRequest request;
  request.grid = bundle.options().backbone.grid_of(options.views, size.height, size.width);
  request.num_sources = options.sources;
  request.outputs.image = true;
  request.outputs.depth = request.outputs.points =
      bundle.options().has_geometry() && bundle.options().geometry_head.predicts_rays();
  SamplingMethod method;
  method.solver = options.solver;
  method.guidance_interval = options.guidance.guidance_interval;
  request.flow = flow_settings(method, options.guidance, bundle.options());
  request.photographs_used = photograph_use_of(PhotographOptions(), bundle);
  for (const BundlePart& part : needed_parts(bundle.options(), request.stage_request()))
    request.converted_bytes[bundle_part_name(part)] = bundle.converted_bytes(part);
  Forecast result;
  result.plan = plan_sampling(bundle.options(), request);
  predict_seconds(result.plan, machine.speed);
  result.memory_problem = memory_problem_of(result.plan, machine);
  result.advice = advice_for(result.plan, options);
  return result;
}

nlohmann::ordered_json machine_json(const Machine& machine) {
  return {{"libtorch", machine.torch},
          {"blas", machine.blas},
          {"openmp", machine.openmp},
          {"process_engines", machine.process_engines},
          {"vectors", machine.instruction_set},
          {"cores", machine.cores},
          {"threads", machine.threads},
          {"total_memory_bytes", machine.total_memory},
          {"available_memory_bytes", machine.available_memory},
          {"multiply_add_gflops", machine.speed.multiply_add_peak / 1e9},
          {"sgemm_gflops", machine.speed.matrix_product / 1e9},
          {"linear_gflops", machine.speed.linear / 1e9},
          {"attention_gflops", machine.speed.attention / 1e9},
          {"matrix_units",
           {{"bfloat16",
             matrix_unit_name(best_matrix_unit(ComputePrecision::kBFloat16), ComputePrecision::kBFloat16)},
            {"int8", matrix_unit_name(best_matrix_unit(ComputePrecision::kInt8), ComputePrecision::kInt8)}}},
          {"bfloat16_linear_over_float32", machine.speed.bfloat16_linear},
          {"int8_linear_over_float32", machine.speed.int8_linear},
          {"bfloat16_attention_over_float32", machine.speed.bfloat16_attention},
          {"loading_gigabytes_per_second", machine.speed.loading / 1e9},
          {"small_model_factor", machine.speed.small_model},
          {"large_model_factor", machine.speed.large_model},
          {"rates", machine.origin}};
}

std::string machine_text(const Machine& machine) {
  const MachineSpeed& speed = machine.speed;
  return fmt::format(
      "LibTorch         {} with {} as BLAS\n"
      "OpenMP           {}\n"
      "processes        {}\n"
      "processor        {} cores, {} threads in use, {} vectors\n"
      "memory           {} of {} free\n"
      "multiply-adds    {:.0f} GFLOP/s (the peak)\n"
      "BLAS products    {:.0f} GFLOP/s, {:.0f} % of the peak\n"
      "linear layers    {:.0f} GFLOP/s, {:.0f} % of the peak\n"
      "attention        {:.0f} GFLOP/s, {:.0f} % of the peak\n"
      "in bfloat16      {}: linear layers {:.2f} times as fast, attention {:.2f}\n"
      "in int8          {}: linear layers {:.2f} times as fast\n"
      "loading weights  {:.1f} GB/s\n"
      "small models     {:.2f} of the time of their products, large ones {:.2f}\n"
      "                 {}\n",
      machine.torch, blas_text(), fmt::join(machine.openmp, ", "),
      machine.process_engines.empty()
          ? "one alone trains: this build has no engine for several"
          : fmt::format("several train together, by {}", fmt::join(machine.process_engines, ", ")),
      machine.cores, machine.threads, machine.instruction_set, bytes_text(machine.available_memory),
      bytes_text(machine.total_memory), speed.multiply_add_peak / 1e9, speed.matrix_product / 1e9,
      100 * speed.matrix_product / speed.multiply_add_peak, speed.linear / 1e9,
      100 * speed.linear / speed.multiply_add_peak, speed.attention / 1e9,
      100 * speed.attention / speed.multiply_add_peak,
      matrix_unit_name(best_matrix_unit(ComputePrecision::kBFloat16), ComputePrecision::kBFloat16),
      speed.bfloat16_linear, speed.bfloat16_attention,
      matrix_unit_name(best_matrix_unit(ComputePrecision::kInt8), ComputePrecision::kInt8), speed.int8_linear,
      speed.loading / 1e9, speed.small_model, speed.large_model, machine.origin);
}

}  // namespace

DoctorOptions::DoctorOptions() {
  solver.schedule.shift = 0;  // the model's
}

void DoctorOptions::visit(FieldVisitor& visitor) {
  visitor.text({"model", "model bundle to forecast for; empty: examine the machine only"}, model);
  visitor.integer({"views", "views of the forecast, sources included"}, views, {2, 1000});
  visitor.integer({"source_views", "source views among them"}, sources, {1, 999});
  visitor.text({"size", "WIDTHxHEIGHT of the forecast, in pixels"}, size);
  visitor.group({"solver", "how the flow is integrated"}, solver);
  visitor.group({"guidance", "classifier-free guidance"}, guidance);
  visit_threads(visitor, threads);
  visitor.boolean({"measure", "measure the machine's rates anew, also where some are kept"}, measure);
  visit_json(visitor, json);
}

void DoctorOptions::check() const {
  if (sources >= views) {
    fail({"--source-views", "fewer source views than views", fmt::format("{} of {}", sources, views),
          "leave at least one target view"});
  }
}

ReportText doctor_report(const DoctorOptions& options, const std::vector<std::string>& process_engines) {
  use_threads(options.threads);
  check_forecast(options);
  Machine machine = examine_machine(options);
  machine.process_engines = process_engines;
  const auto wrong = complaints(machine);
  std::vector<std::string> warnings = wrong;
  std::optional<Forecast> made;
  if (!options.model.empty()) {
    made = forecast(options, machine);
    if (!made->memory_problem.empty()) warnings.push_back(made->memory_problem);
  }
  if (options.json) {
    nlohmann::ordered_json report{{"machine", machine_json(machine)}, {"complaints", wrong}};
    if (made) {
      report["forecast"] = plan_json(made->plan);
      report["advice"] = made->advice;
    }
    report["warnings"] = warnings;
    return {json_text(report, 2) + "\n", warnings};
  }
  std::string text = machine_text(machine);
  if (wrong.empty()) text += "Nothing is wrong.\n";
  if (!made) return {text, warnings};
  text += fmt::format("\nForecast for {} with {} views ({} sources) at {}:\n", options.model, options.views,
                      options.sources, options.size);
  text += plan_text(made->plan);
  for (const auto& line : made->advice) text += "- " + line + "\n";
  return {text, warnings};
}

}  // namespace gld
