#pragma once

#include "datasets/splats/scene_fit.h"
#include "gld/flow/guidance.h"
#include "gld/flow/solvers/solver.h"
#include "infer/forecast/machine_rates.h"
#include "infer/forecast/stage_memory.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "infer/pipeline/sampling_stages.h"
#include "infer/request/requested_outputs.h"
#include "models/bundle/bundle.h"
#include "models/bundle/bundle_options.h"
#include "models/cost/cost_model.h"
#include "models/decoders/geometry_head.h"

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace gld {

// What sampling is planned for.
struct PlanRequest {
  LatentGrid grid;  // of all views
  int64_t num_sources = 1;
  bool source_depth_given = false;        // StageRequest's
  bool single_source_unit_known = false;  // likewise
  PhotographUse photographs_used;
  RequestedOutputs outputs;
  FlowSettings flow;
  // Of the bundle that geometry comes from, where that is another one looking at the generated images; null where not.
  std::shared_ptr<const BundleOptions> geometry_model;
  // Photographs whose cameras are estimated before all else, by that bundle or the model itself; 0 for a scene with
  // cameras.
  int64_t photographs = 0;
  int64_t photograph_pixels = 0;          // of the largest, as it was taken
  int64_t picture_magnification = 1;      // of the pictures that are made, in the grid's
  int64_t photograph_magnification = 1;   // of the source photographs as they are matched and kept, likewise
  std::optional<SceneFitOptions> splats;  // where Gaussians are fitted to the run's pictures
  int64_t preview_every = 0;              // PipelineRequest::preview_every
  // ModelBundle::converted_bytes of parts, by name; of those that are left out 0.
  std::map<std::string, int64_t> converted_bytes;

  StageRequest stage_request() const;
};

// Returns the grid of another backbone that looks at pictures of the bundle's grid: its sides are in whole patches of
// its own.
LatentGrid geometry_model_grid(const BundleOptions& geometry, const BundleOptions& bundle,
                               const LatentGrid& pictures);

// Returns the most pixels that depth which photographs are matched for may have: they may have been taken larger than
// the model sees them.
ImageSize largest_matched_size(const BundleOptions& bundle, const PlanRequest& request);

// How often each part of a model runs in a flow, over both branches of guidance.
struct PlannedRuns {
  int64_t condition_encoder = 0;
  int64_t velocity_decoder = 0;
};
// Returns what the pipeline will count (DitCounts) with a fixed-step solver of one evaluation a step; adaptive solvers
// are counted with solver.evaluations, and staged ones as if their stages lay at the steps' starts.
PlannedRuns planned_runs(const DitOptions& model, const SolverOptions& solver, const FlowSettings& flow);

// This stage estimates the cameras of photographs, in plans and records.
inline constexpr const char* kPhotoCamerasStage = "photo cameras";

// A stage with what it takes.
struct PlannedStage : SamplingStage {
  int64_t read_bytes = 0;        // of weights, as float32 numbers
  bool before_pipeline = false;  // kPhotoCamerasStage, which is none of sampling_stages()
  bool of_products = true;  // its time is that of a model's products; not so kSplatStage, none of them either
  int64_t evaluations = 1;  // forward passes of the conditional branch, or steps of a fit
  int64_t with_unconditional = 0;  // of them with the unconditional branch beside it
  PlannedRuns parts;               // how often a flow's parts run
  Cost cost;                       // operations of all passes together
  LayerPrecision precision;        // of the modules it loads
  StageMemory memory;
  double seconds = 0;      // predicted; 0 without a measured speed
  int64_t peak_bytes = 0;  // predicted resident memory
};

struct SamplingPlan {
  std::vector<PlannedStage> stages;

  double flop() const;
  double seconds() const;
  int64_t peak_bytes() const;  // of the largest stage
};

// Returns the stages that this request needs, with their cost, that of the cameras of photographs first. Adaptive
// solvers are counted with options.evaluations.
SamplingPlan plan_sampling(const BundleOptions& bundle, const PlanRequest& request);
// Returns the parts of the model that the stages of a request load, statistics included, each once.
std::vector<BundlePart> needed_parts(const BundleOptions& bundle, const StageRequest& request);
// Fills in PlannedStage::seconds, loading included, from operations and the machine's speed. It runs nothing.
void predict_seconds(SamplingPlan& plan, const MachineSpeed& speed);
// Does the same by running: it times flows from runs of their models' parts (infer/forecast/dit_speed.h), and other
// stages where they are short from a run (infer/forecast/stage_speed.h). It takes a few seconds at full size, and is
// for gld plan --measure.
void measure_seconds(SamplingPlan& plan, const BundleOptions& bundle, const PlanRequest& request,
                     const MachineSpeed& speed);

}  // namespace gld
