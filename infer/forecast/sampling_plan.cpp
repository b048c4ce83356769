#include "infer/forecast/sampling_plan.h"

#include "gld/cameras/latent_grid.h"
#include "gld/flow/flow.h"
#include "infer/forecast/dit_speed.h"
#include "infer/forecast/splat_forecast.h"
#include "infer/forecast/stage_speed.h"
#include "models/blending/photograph_blending.h"
#include "models/cost/branch_choice.h"
#include "models/depth_refinement/depth_refinement.h"
#include "models/dit/encoder_nodes.h"
#include "models/refiner/latent_refining.h"

#include <algorithm>

#include <fmt/format.h>

namespace gld {
namespace {

// Returns the flow time that each evaluation starts its step from.
std::vector<double> evaluation_times(const SolverOptions& solver) {
  const auto steps = solver_times(solver);
  const auto step_count = static_cast<int64_t>(steps.size()) - 1;
  std::vector<double> times;
  for (int64_t i = 0; i < solver.evaluations; ++i) {
    times.push_back(steps[static_cast<size_t>(i * step_count / solver.evaluations)]);
  }
  return times;
}

int64_t guided_evaluations(const SolverOptions& solver, const GuidanceOptions& guidance) {
  const auto times = evaluation_times(solver);
  return std::count_if(times.begin(), times.end(), [&](double t) { return guidance.acts_at(t); });
}

bool is_cascade(const DitOptions& options) { return options.conditioning == DitConditioning::kDeeperLevel; }

// Returns the bytes of the conditions that the approximate savings keep.
int64_t kept_conditions_bytes(const DitOptions& options, const SolverOptions& solver,
                              const PlanRequest& request) {
  const FlowSettings& flow = request.flow;
  int64_t kept = 0;
  if (is_cascade(options) && flow.approximate.cascade_encoder_nodes > 0) {
    for (const auto& nodes : encoder_nodes(solver, flow.guidance, flow.approximate.cascade_encoder_nodes)) {
      kept += static_cast<int64_t>(nodes.size());
    }
  }
  return kept * request.grid.views * (request.grid.tokens_per_view() + options.num_special_tokens) *
         options.encoder_width() * kFloatBytes;
}

int64_t latent_bytes(int64_t channels, const LatentGrid& grid) {
  return grid.views * grid.tokens_per_view() * channels * kFloatBytes;
}

void price_flow(PlannedStage& stage, const DitOptions& options, SolverOptions solver,
                const PlanRequest& request) {
  solver.schedule.shift = resolved_time_shift(solver.schedule.shift, request.grid, options.in_channels);
  const GuidanceOptions& guidance = request.flow.guidance;
  stage.evaluations = solver.evaluations;
  stage.with_unconditional = guided_evaluations(solver, guidance);
  stage.parts = planned_runs(options, solver, request.flow);
  const Cost once = dit_cost(options, request.grid);
  const Cost encoder = condition_encoder_cost(options, request.grid);
  const Cost decoder = velocity_decoder_cost(options, request.grid);
  const auto encoder_runs = static_cast<double>(stage.parts.condition_encoder);
  const auto decoder_runs = static_cast<double>(stage.parts.velocity_decoder);
  stage.cost.linear_flop = encoder_runs * encoder.linear_flop + decoder_runs * decoder.linear_flop;
  stage.cost.attention_flop = encoder_runs * encoder.attention_flop + decoder_runs * decoder.attention_flop;
  const bool batched =
      stage.with_unconditional > 0 && choose_branches(guidance, options, request.grid).batched;
  // Noise and latents of both levels, source features, the state, its next, and what the solver remembers.
  constexpr int64_t kLatents = 8;
  stage.memory.held = kLatents * latent_bytes(options.in_channels, request.grid) +
                      kept_conditions_bytes(options, solver, request);
  stage.memory.working = (batched ? 2 : 1) * once.working_bytes;
  stage.reason = fmt::format("{} evaluations, {} with the unconditional branch{}", stage.evaluations,
                             stage.with_unconditional, batched ? " in the same pass" : "");
  if (stage.parts.condition_encoder < stage.parts.velocity_decoder) {
    stage.reason += fmt::format("; condition encoder {} times instead of {}", stage.parts.condition_encoder,
                                stage.parts.velocity_decoder);
  }
}

// The parts that a stage loads, one after another, and how many latents of all views are there while a stage outside
// the flows runs: noise and latents of the generated levels, source features, levels to decode.
struct StageNeeds {
  std::vector<BundlePart> parts;
  int64_t latents = 0;
};

StageNeeds needs_of(const SamplingStage& stage, const BundleOptions& bundle, const StageRequest& request) {
  const auto generated = static_cast<int64_t>(bundle.generators.size()), levels = bundle.backbone.levels();
  switch (stage.kind) {
    case StageKind::kSourceEncoding:
      return {{BundlePart::backbone()}, generated};
    case StageKind::kSourceDepth: {
      StageNeeds needs{{}, 2 * generated + 1};
      if (!uses_source_depth(bundle.level_set(), request)) return needs;
      needs.parts = {BundlePart::geometry_head()};
      if (mends_source_depth(bundle.level_set(), request))
        needs.parts.push_back(BundlePart::depth_refinement());
      return needs;
    }
    case StageKind::kSourceWarp: {
      StageNeeds needs{{}, 2 * generated + 1};
      if (!needs_source_depth(bundle.level_set(), request)) return needs;
      needs.parts = {BundlePart::backbone()};
      if (!has_source_depth_stage(bundle.level_set(), request))
        needs.parts.push_back(BundlePart::geometry_head());
      return needs;
    }
    case StageKind::kComposition: {
      StageNeeds needs{{}, 2 + 2 * levels};
      if (request.photographs.blends()) needs.parts = {BundlePart::blending()};
      return needs;
    }
    case StageKind::kFlow:
      return {{BundlePart::of(bundle.generators.at(stage.generator).generator)}, 0};
    case StageKind::kSampleRefinement:
      // Noise, latents before and behind it, both as maps too, and the source views' features.
      return {{BundlePart::refiner()}, 8 * generated};
    case StageKind::kPropagation:
      return {{BundlePart::backbone()}, 2 + levels};
    case StageKind::kRgbDecoding:
      return {{bundle.has_rgb_decoder() ? BundlePart::rgb_decoder() : BundlePart::backbone()},
              2 + 2 * levels};
    case StageKind::kGeometry:
      return {{BundlePart::geometry_head()}, 2 + 2 * levels};
  }
  return {};
}

// Nearly all weights are those of packed layers.
int64_t packed_bytes(int64_t float32_bytes, ComputePrecision precision) {
  switch (precision) {
    case ComputePrecision::kBFloat16:
      return float32_bytes / 2;
    case ComputePrecision::kInt8:
      return float32_bytes / 4;
    default:
      return float32_bytes;
  }
}

// Returns the bytes of source photographs as they are matched and kept, and of what is carried of them: colours of
// float32 once in the scene and once in the request; where views are laid together, once more with their depth, once
// evened for a target, and once as they are carried with their weights; and of each target view what is shown, its
// picture, what was generated as large, and all of them stacked.
int64_t photographs_held(const PlannedStage& stage, const BundleOptions& bundle, const PlanRequest& request) {
  const StageRequest stages = request.stage_request();
  if (!stages.photographs.matches() && !stages.photographs.composes()) return 0;
  constexpr int64_t kColours = 3 * kFloatBytes, kHeldPhotograph = 2 * kColours,
                    kCarriedPhotograph = 3 * kColours + 2 * kFloatBytes, kShownView = 15 * kFloatBytes;
  const int64_t side = request.photograph_magnification * bundle.backbone.patch_side();
  const int64_t pixels = request.grid.tokens_per_view() * side * side;
  int64_t bytes = request.num_sources * pixels * kHeldPhotograph;
  if (stage.kind == StageKind::kComposition) {
    bytes += request.num_sources * pixels * kCarriedPhotograph;
    bytes += (request.grid.views - request.num_sources) * pixels * kShownView;
  }
  return bytes;
}

void predict_memory(PlannedStage& stage, const BundleOptions& bundle, const PlanRequest& request) {
  const StageNeeds needs = needs_of(stage, bundle, request.stage_request());
  if (stage.kind == StageKind::kGeometry && request.geometry_model) {
    stage.memory.weights = weight_bytes_of(BundlePart::backbone(), *request.geometry_model) +
                           weight_bytes_of(BundlePart::geometry_head(), *request.geometry_model);
  } else {
    for (const BundlePart& part : needs.parts) {
      stage.memory.weights = std::max(stage.memory.weights, weight_bytes_of(part, bundle));
      const auto converted = request.converted_bytes.find(bundle_part_name(part));
      if (converted != request.converted_bytes.end())
        stage.memory.converted = std::max(stage.memory.converted, converted->second);
    }
  }
  stage.memory.held += photographs_held(stage, bundle, request);
  stage.read_bytes = stage.memory.weights;
  stage.memory.weights = packed_bytes(stage.memory.weights, stage.precision.linear);
  stage.memory.held += needs.latents * latent_bytes(bundle.backbone.level_channels(), request.grid);
  stage.peak_bytes = predicted_peak_bytes(stage.memory);
}

Cost image_decoding_cost(const BundleOptions& bundle, const LatentGrid& grid) {
  return bundle.has_rgb_decoder() ? rgb_decoder_cost(bundle.rgb_decoder, grid)
                                  : bundle.backbone.architecture().decoding_cost(grid);
}

// Returns the cost of geometry_of_pictures(), whose pictures have that grid.
Cost geometry_of_pictures_cost(const BundleOptions& geometry, const LatentGrid& grid, GeometryMaps maps) {
  Cost cost = geometry.backbone.architecture().encoding_cost(grid, geometry.backbone.levels() - 1);
  const Cost head = geometry.geometry_head.cost(grid, maps);
  cost.add_operations_of(head);
  cost.working_bytes = std::max(cost.working_bytes, head.working_bytes);
  return cost;
}

Cost single_cost(const SamplingStage& stage, const BundleOptions& bundle, const PlanRequest& request);

// What completes levels and what decodes them stay in memory beside a flow's model, and all levels are there while a
// preview is made, between two evaluations.
void add_preview_memory(PlannedStage& flow, const BundleOptions& bundle, const PlanRequest& request) {
  const StageRequest stages = request.stage_request();
  for (const StageKind kind : {StageKind::kPropagation, StageKind::kRgbDecoding}) {
    SamplingStage stage;
    stage.kind = kind;
    const StageNeeds needs = needs_of(stage, bundle, stages);
    const LayerPrecision precision = layer_precision(request.flow.precision, model_kind_of(kind));
    for (const BundlePart& part : needs.parts)
      flow.memory.weights += packed_bytes(weight_bytes_of(part, bundle), precision.linear);
    flow.memory.working = std::max(flow.memory.working, single_cost(stage, bundle, request).working_bytes);
    if (kind == StageKind::kRgbDecoding)
      flow.memory.held += needs.latents * latent_bytes(bundle.backbone.level_channels(), request.grid);
  }
  flow.peak_bytes = predicted_peak_bytes(flow.memory);
}

PlannedStage photo_cameras_stage(const BundleOptions& bundle, const PlanRequest& request) {
  const BundleOptions& geometry = request.geometry_model ? *request.geometry_model : bundle;
  const LatentGrid pictures = with_views(request.grid, request.photographs);
  const LatentGrid grid = geometry_model_grid(geometry, bundle, pictures);
  PlannedStage stage;
  stage.kind = StageKind::kGeometry;
  stage.name = kPhotoCamerasStage;
  stage.before_pipeline = true;
  stage.reason = fmt::format("{} photograph{}, whose cameras {} sees", request.photographs,
                             request.photographs == 1 ? "" : "s", geometry.name);
  stage.precision = layer_precision(ComputePrecision::kFloat32, model_kind_of(stage.kind));
  stage.cost = geometry_of_pictures_cost(geometry, grid, GeometryMaps::kDepthAndRays);
  stage.read_bytes = weight_bytes_of(BundlePart::backbone(), geometry) +
                     weight_bytes_of(BundlePart::geometry_head(), geometry);
  stage.memory.weights = stage.read_bytes;
  stage.memory.working = stage.cost.working_bytes;
  // All levels, raw and as the head takes them, and the pictures: bytes, tensors, and what the backbone was given.
  const int64_t side = bundle.backbone.patch_side();
  const int64_t pixels = pictures.views * pictures.tokens_per_view() * side * side;
  stage.memory.held =
      2 * geometry.backbone.levels() * latent_bytes(geometry.backbone.level_channels(), grid) +
      pixels * 3 * (1 + 2 * kFloatBytes);
  // Before any of it, it reads the photographs one after another as they were taken, with bytes of the file's order and
  // of ours.
  StageMemory reading;
  reading.held = pixels * 3 + 2 * 3 * request.photograph_pixels;
  stage.peak_bytes = std::max(predicted_peak_bytes(stage.memory), predicted_peak_bytes(reading));
  return stage;
}

// Returns the cost of the stages that run once.
Cost single_cost(const SamplingStage& stage, const BundleOptions& bundle, const PlanRequest& request) {
  const auto& backbone = bundle.backbone.architecture();
  const LatentGrid sources = with_views(request.grid, request.num_sources);
  const StageRequest stages = request.stage_request();
  switch (stage.kind) {
    case StageKind::kSourceEncoding: {
      Cost cost = backbone.encoding_cost(sources, deepest_encoded_level(bundle.level_set(), stages));
      if (stages.decodes() && backbone.encodes_leading(request.num_sources)) {
        cost.add_operations_of(
            backbone.encoding_cost(with_views(request.grid, backbone.leading_rows()), bundle.boundary_level));
      }
      return cost;
    }
    case StageKind::kSourceDepth: {
      if (!uses_source_depth(bundle.level_set(), stages)) return Cost();
      Cost cost = bundle.geometry_head.cost(sources, GeometryMaps::kDepthAndRays);
      if (mends_source_depth(bundle.level_set(), stages)) {
        const ImageSize matched = largest_matched_size(bundle, request);
        Cost mending = depth_refinement_cost(bundle.depth_refinement, matched.height, matched.width);
        // It mends all views at once.
        mending.convolution_flop *= static_cast<double>(stages.num_sources);
        cost.add_operations_of(mending);
        cost.working_bytes = std::max(cost.working_bytes, mending.working_bytes * stages.num_sources);
      }
      return cost;
    }
    case StageKind::kSourceWarp: {
      const LevelSet levels = bundle.level_set();
      if (!needs_source_depth(levels, stages)) return Cost();
      Cost cost = has_source_depth_stage(levels, stages)
                      ? Cost()
                      : bundle.geometry_head.cost(sources, GeometryMaps::kDepthAndRays);
      cost.add_operations_of(backbone.encoding_cost(request.grid, levels.deepest_generated()));
      return cost;
    }
    case StageKind::kComposition: {
      if (!stages.photographs.blends()) return Cost();
      const int64_t side = bundle.backbone.patch_side();
      Cost cost = blending_cost(bundle.blending, side * request.grid.height, side * request.grid.width);
      const auto targets = static_cast<double>(stages.views - stages.num_sources);
      cost.convolution_flop *= targets;
      return cost;
    }
    case StageKind::kFlow:
      break;
    case StageKind::kSampleRefinement: {
      const int64_t references = references_taken(bundle.refiner, request.num_sources);
      Cost cost = refiner_cost(bundle.refiner, 1 + references, request.grid.height, request.grid.width);
      cost.multiply_operations(static_cast<double>(request.grid.views - request.num_sources));
      return cost;
    }
    case StageKind::kPropagation:
      return backbone.propagation_cost(request.grid, bundle.boundary_level);
    case StageKind::kRgbDecoding:
      return image_decoding_cost(bundle, with_views(request.grid, stages.decoded_views(stages.image_views)));
    case StageKind::kGeometry:
      if (request.geometry_model) {
        return geometry_of_pictures_cost(*request.geometry_model,
                                         geometry_model_grid(*request.geometry_model, bundle, request.grid),
                                         request.outputs.geometry_maps());
      }
      return bundle.geometry_head.cost(with_views(request.grid, stages.decoded_views(stages.geometry_views)),
                                       request.outputs.geometry_maps());
  }
  return Cost();
}

}  // namespace

StageRequest PlanRequest::stage_request() const {
  StageRequest stages;
  stages.views = grid.views;
  stages.num_sources = num_sources;
  stages.image_views = outputs.image_views();
  stages.geometry_views = outputs.geometry_views();
  stages.single_source_unit_known = single_source_unit_known;
  stages.source_depth_given = source_depth_given;
  stages.photographs = photographs_used;
  stages.refines_samples = flow.refine;
  return stages;
}

LatentGrid geometry_model_grid(const BundleOptions& geometry, const BundleOptions& bundle,
                               const LatentGrid& pictures) {
  const auto tokens = [&](int64_t count) {
    return nearest_whole_patches(count * bundle.backbone.patch_side(), geometry.backbone.patch_side());
  };
  return {pictures.views, tokens(pictures.height), tokens(pictures.width)};
}

PlannedRuns planned_runs(const DitOptions& model, const SolverOptions& solver, const FlowSettings& flow) {
  PlannedRuns runs;
  runs.velocity_decoder = solver.evaluations + guided_evaluations(solver, flow.guidance);
  runs.condition_encoder = runs.velocity_decoder;
  const auto& savings = flow.approximate;
  if (is_cascade(model) && savings.cascade_encoder_nodes > 0) {
    runs.condition_encoder = 0;
    for (const auto& nodes : encoder_nodes(solver, flow.guidance, savings.cascade_encoder_nodes)) {
      runs.condition_encoder += static_cast<int64_t>(nodes.size());
    }
  }
  return runs;
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

ImageSize largest_matched_size(const BundleOptions& bundle, const PlanRequest& request) {
  const int64_t side = bundle.backbone.patch_side();
  const ImageSize shown{side * request.grid.width, side * request.grid.height};
  const int64_t longer = std::max(shown.width, shown.height);
  const int64_t matched = std::max(longer, request.photographs_used.stereo.largest_side);
  return {shown.width * matched / longer, shown.height * matched / longer};
}

SamplingPlan plan_sampling(const BundleOptions& bundle, const PlanRequest& request) {
  SamplingPlan plan;
  if (request.photographs > 0) plan.stages.push_back(photo_cameras_stage(bundle, request));
  for (auto& listed : sampling_stages(bundle.level_set(), request.stage_request())) {
    PlannedStage stage;
    static_cast<SamplingStage&>(stage) = std::move(listed);
    stage.precision = layer_precision(request.flow.precision, model_kind_of(stage.kind));
    if (!stage.runs) {
      stage.evaluations = 0;
    } else {
      if (stage.kind == StageKind::kFlow) {
        price_flow(stage, bundle.generators.at(stage.generator).dit, request.flow.solvers.at(stage.generator),
                   request);
      } else {
        stage.cost = single_cost(stage, bundle, request);
        stage.memory.working = stage.cost.working_bytes;
      }
      predict_memory(stage, bundle, request);
      if (stage.kind == StageKind::kFlow && request.preview_every > 0)
        add_preview_memory(stage, bundle, request);
    }
    plan.stages.push_back(std::move(stage));
  }
  if (request.splats) plan.stages.push_back(splat_stage(request, bundle.backbone.patch_side()));
  return plan;
}

std::vector<BundlePart> needed_parts(const BundleOptions& bundle, const StageRequest& request) {
  std::vector<BundlePart> parts;
  for (const auto& part : bundle_parts(bundle)) {
    if (part.kind == BundlePart::Kind::kStatistics || part.kind == BundlePart::Kind::kSpecialStatistics)
      parts.push_back(part);
  }
  for (const auto& stage : sampling_stages(bundle.level_set(), request)) {
    if (!stage.runs) continue;
    for (const BundlePart& part : needs_of(stage, bundle, request).parts) {
      if (std::find(parts.begin(), parts.end(), part) == parts.end()) parts.push_back(part);
    }
  }
  return parts;
}

void predict_seconds(SamplingPlan& plan, const MachineSpeed& speed) {
  for (auto& stage : plan.stages) {
    if (!stage.runs || !stage.of_products) continue;
    // A pass is one of both parts of a flow's model.
    const auto passes = static_cast<double>(stage.parts.condition_encoder + stage.parts.velocity_decoder) / 2;
    stage.seconds = model_seconds(stage.cost, std::max(1.0, passes), speed, stage.precision) +
                    static_cast<double>(stage.read_bytes) / speed.loading;
    stage.seconds *= speed.stages_in(stage.precision.linear);
  }
}

void measure_seconds(SamplingPlan& plan, const BundleOptions& bundle, const PlanRequest& request,
                     const MachineSpeed& speed) {
  // A stage that runs once may take so long for it to be run beforehand.
  constexpr double kShort = 0.2;
  for (auto& stage : plan.stages) {
    if (!stage.runs || !stage.of_products) continue;
    if (stage.kind == StageKind::kFlow) {
      const DitSpeed parts = measure_dit_speed(bundle.generators.at(stage.generator).dit, request, speed);
      stage.seconds = static_cast<double>(stage.parts.condition_encoder) * parts.condition_encoder +
                      static_cast<double>(stage.parts.velocity_decoder) * parts.velocity_decoder;
    } else {
      stage.seconds = computing_seconds(stage.cost, speed, stage.precision);
      if (stage.seconds < kShort && stage.cost.flop() > 0 && !stage.before_pipeline)
        stage.seconds = measure_stage_seconds(stage, bundle, request);
    }
    stage.seconds += static_cast<double>(stage.read_bytes) / speed.loading;
  }
}

}  // namespace gld
