#include "infer/sampling_plan.h"

#include "gld/attention.h"
#include "gld/cpu_peak.h"
#include "gld/progress.h"
#include "gld/sgemm_peak.h"
#include "gld/stage_record.h"
#include "gld/torch_version.h"
#include "models/branch_choice.h"

#include <algorithm>
#include <chrono>
#include <limits>

#include <ATen/ops/randn.h>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr int64_t kFloatBytes = 4;
// The program, LibTorch's libraries and its allocator before any model is loaded, measured.
constexpr int64_t kProgramBytes = 350'000'000;

// Operations a second of softmax attention at head size 64: between the 48 and 128 of the published models.
double measure_attention_speed() {
  constexpr int64_t kTokens = 1440, kHeads = 4, kHeadDim = 64;
  constexpr int kRepeats = 3;
  AttentionInputs inputs;
  inputs.query = at::randn({1, kTokens, kHeads, kHeadDim});
  inputs.key = at::randn({1, kTokens, kHeads, kHeadDim});
  inputs.value = at::randn({1, kTokens, kHeads, kHeadDim});
  const torch::NoGradGuard no_gradients;
  attention(inputs);
  double best = std::numeric_limits<double>::infinity();
  for (int i = 0; i < kRepeats; ++i) {
    const auto start = std::chrono::steady_clock::now();
    attention(inputs);
    best = std::min(best, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
  }
  return 4.0 * kTokens * kTokens * kHeads * kHeadDim / best;
}

Cost times(const Cost& cost, double factor) {
  Cost scaled = cost;
  scaled.linear_flop *= factor;
  scaled.attention_flop *= factor;
  return scaled;
}

int64_t guided_evaluations(const std::vector<double>& times, const GuidanceOptions& guidance) {
  if (guidance.guidance_scale == 1) return 0;
  return std::count_if(times.begin(), times.end() - 1, [&](double t) {
    return t >= guidance.guidance_interval[0] && t <= guidance.guidance_interval[1];
  });
}

PlannedStage flow_stage(const std::string& name, const DitOptions& options, const SolverOptions& solver,
                        const PlanRequest& request) {
  const auto steps = solver_times(solver);
  const auto step_count = static_cast<double>(steps.size()) - 1;
  PlannedStage stage;
  stage.name = name;
  stage.evaluations = solver.evaluations;
  const double guided_share = static_cast<double>(guided_evaluations(steps, request.guidance)) / step_count;
  stage.with_unconditional =
      static_cast<int64_t>(guided_share * static_cast<double>(stage.evaluations) + 0.5);
  const Cost once = dit_cost(options, request.grid);
  stage.cost = times(once, static_cast<double>(stage.evaluations + stage.with_unconditional));
  const int64_t state_bytes = request.grid.views *
                              (request.grid.tokens_per_view() + options.num_special_tokens) *
                              options.in_channels * kFloatBytes;
  const bool batched =
      stage.with_unconditional > 0 && choose_branches(request.guidance, options, request.grid).batched;
  stage.peak_bytes =
      kProgramBytes + once.weight_bytes + (batched ? 2 : 1) * once.working_bytes + 6 * state_bytes;
  stage.reason = fmt::format("{} evaluations, {} with the unconditional branch{}", stage.evaluations,
                             stage.with_unconditional, batched ? " in the same pass" : "");
  return stage;
}

PlannedStage single_stage(const std::string& name, const Cost& cost, const std::string& reason) {
  PlannedStage stage;
  stage.name = name;
  stage.cost = cost;
  stage.reason = reason;
  stage.peak_bytes = kProgramBytes + cost.weight_bytes + cost.working_bytes;
  return stage;
}

PlannedStage left_out(const std::string& name, const std::string& reason) {
  PlannedStage stage;
  stage.name = name;
  stage.runs = false;
  stage.evaluations = 0;
  stage.reason = reason;
  return stage;
}

LatentGrid with_views(LatentGrid grid, int64_t views) {
  grid.views = views;
  return grid;
}

}  // namespace

MachineSpeed measure_machine_speed() {
  PeakMeasurement measurement;
  measurement.settings.threads = thread_count();
  MachineSpeed speed;
  speed.multiply_add_peak = measure_multiply_add_peak(measurement);
  speed.linear = measure_sgemm_peak();
  speed.attention = measure_attention_speed();
  return speed;
}

double SamplingPlan::flop() const {
  double total = 0;
  for (const auto& stage : stages) total += stage.cost.flop();
  return total;
}

double SamplingPlan::seconds() const {
  double total = 0;
  for (const auto& stage : stages) total += stage.seconds;
  return total;
}

int64_t SamplingPlan::peak_bytes() const {
  int64_t largest = 0;
  for (const auto& stage : stages) largest = std::max(largest, stage.peak_bytes);
  return largest;
}

SamplingPlan plan_sampling(const BundleOptions& bundle, const PlanRequest& request) {
  SamplingPlan plan;
  const auto& blocks = bundle.backbone.out_layers;
  const int64_t boundary_block = blocks.at(static_cast<size_t>(bundle.boundary_level)) + 1;
  Cost encoding =
      backbone_cost(bundle.backbone, with_views(request.grid, request.num_sources), 0, boundary_block);
  if (request.num_sources > 1) {
    const Cost alone = backbone_cost(bundle.backbone, with_views(request.grid, 1), 0, boundary_block);
    encoding.linear_flop += alone.linear_flop;
    encoding.attention_flop += alone.attention_flop;
  }
  plan.stages.push_back(
      single_stage("source encoding", encoding,
                   fmt::format("{} source views up to level {}; deeper blocks are not needed",
                               request.num_sources, bundle.boundary_level)));
  plan.stages.push_back(flow_stage("M1", bundle.level1, request.level1_solver, request));
  plan.stages.push_back(flow_stage("cascade", bundle.cascade, request.cascade_solver, request));

  const RequestedOutputs& outputs = request.outputs;
  if (outputs.needs_levels()) {
    plan.stages.push_back(single_stage(
        "propagation", backbone_cost(bundle.backbone, request.grid, boundary_block, bundle.backbone.depth),
        "levels 2 and 3 of all views, which attend to each other"));
  } else {
    plan.stages.push_back(left_out("propagation", "only latents were asked for"));
  }
  const int64_t targets = request.grid.views - request.num_sources;
  plan.stages.push_back(
      outputs.needs_image()
          ? single_stage("RGB decoding",
                         rgb_decoder_cost(bundle.rgb_decoder, with_views(request.grid, targets)),
                         fmt::format("{} target views", targets))
          : left_out("RGB decoding", "no images were asked for"));
  if (outputs.needs_geometry()) {
    const int64_t views = outputs.points ? request.grid.views : targets;
    const auto maps = outputs.needs_depth() && outputs.needs_rays() ? GeometryMaps::kDepthAndRays
                      : outputs.needs_depth()                       ? GeometryMaps::kDepth
                                                                    : GeometryMaps::kRays;
    plan.stages.push_back(single_stage("geometry",
                                       dpt_head_cost(bundle.dpt_head, with_views(request.grid, views), maps),
                                       outputs.points ? "all views, for the point cloud" : "target views"));
  } else {
    plan.stages.push_back(left_out("geometry", "no depth, rays or points were asked for"));
  }
  return plan;
}

void predict_seconds(SamplingPlan& plan, const MachineSpeed& speed) {
  for (auto& stage : plan.stages) {
    stage.seconds = stage.cost.linear_flop / speed.linear + stage.cost.attention_flop / speed.attention;
  }
}

std::string plan_text(const SamplingPlan& plan) {
  std::string text =
      fmt::format("{:<16} {:>10} {:>14} {:>10}  {}\n", "stage", "TFLOP", "time", "memory", "why");
  for (const auto& stage : plan.stages) {
    if (!stage.runs) {
      text +=
          fmt::format("{:<16} {:>10} {:>14} {:>10}  {}\n", stage.name, "-", "left out", "-", stage.reason);
      continue;
    }
    text += fmt::format("{:<16} {:>10.4g} {:>14} {:>10}  {}\n", stage.name, stage.cost.flop() / 1e12,
                        stage.seconds > 0 ? duration_text(stage.seconds) : "-", bytes_text(stage.peak_bytes),
                        stage.reason);
  }
  text +=
      fmt::format("{:<16} {:>10.4g} {:>14} {:>10}\n", "together", plan.flop() / 1e12,
                  plan.seconds() > 0 ? duration_text(plan.seconds()) : "-", bytes_text(plan.peak_bytes()));
  return text;
}

nlohmann::ordered_json plan_json(const SamplingPlan& plan) {
  auto list = nlohmann::ordered_json::array();
  for (const auto& stage : plan.stages) {
    list.push_back({{"stage", stage.name},
                    {"runs", stage.runs},
                    {"reason", stage.reason},
                    {"evaluations", stage.evaluations},
                    {"with_unconditional_branch", stage.with_unconditional},
                    {"tflop", stage.cost.flop() / 1e12},
                    {"predicted_seconds", stage.seconds},
                    {"predicted_peak_bytes", stage.peak_bytes}});
  }
  return list;
}

}  // namespace gld
