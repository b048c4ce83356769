#pragma once

#include "gld/cameras/camera.h"
#include "gld/flow/guidance.h"
#include "gld/flow/solvers/solver.h"
#include "gld/latents/level_statistics.h"
#include "gld/machine/stage_record.h"
#include "gld/photogrammetry/source_depth.h"
#include "infer/pipeline/sampling_stages.h"
#include "models/backbones/backbone.h"
#include "models/cost/branch_choice.h"
#include "models/decoders/geometry_head.h"
#include "models/decoders/image_decoder.h"
#include "models/dit/approximate_savings.h"
#include "models/dit/dit_dh.h"
#include "models/dit/dit_field.h"
#include "models/dit/exact_savings.h"
#include "models/refiner/denoising_unet.h"
#include "models/scene_geometry/composed_views.h"
#include "models/scene_geometry/photograph_depth.h"

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// The stages get their modules from this. Each function is called when a stage starts and what it returns is dropped
// when the stage ends, so that the weights of one stage are in memory at a time.
struct PipelineModels {
  LevelSet levels;
  std::function<std::shared_ptr<Backbone>()> backbone;
  std::function<std::shared_ptr<DitDh>(size_t generator)> generator;  // by its number in levels.generators
  std::function<std::shared_ptr<ImageDecoder>()> rgb_decoder;
  std::function<std::shared_ptr<GeometryHead>()> geometry_head;
  std::function<std::shared_ptr<PhotographBlending>()> blending;       // empty where the model has none
  std::function<std::shared_ptr<DepthRefinement>()> depth_refinement;  // likewise
  std::function<std::shared_ptr<DenoisingUnet>()> refiner;             // of samples, likewise
  // Of another model, which looks at the generated images, where geometry is what it sees; empty where geometry is read
  // off the model's own levels by geometry_head.
  std::function<std::shared_ptr<Backbone>()> geometry_model_backbone;
  std::function<std::shared_ptr<GeometryHead>()> geometry_model_head;
  std::vector<LevelStatistics> statistics;  // of what each generator makes
};

// The flows are run with these.
struct FlowSettings {
  std::vector<SolverOptions> solvers;  // one a generator: each has its time shift
  GuidanceOptions guidance;
  ApproximateSavings approximate;
  bool refine = false;  // repair what the flows made (infer/pipeline/sample_refinement.h)
  ComputePrecision precision =
      ComputePrecision::kFloat32;  // what the models were loaded for (bundle_models.h)
};

struct PipelineRequest {
  Views views;                  // one size, in whole patches
  torch::Tensor source_images;  // (source views, 3, height, width), RGB in [0, 1]
  // Depth of the source views where something else than the model's geometry head says it.
  std::optional<SourceDepth> source_depth;
  // The geometry head's unit is so many of the cameras' units long where it sees a single source view and nothing
  // guesses it of that; where this is 0, a single source is not carried.
  double single_source_unit = 0;
  double single_source_unit_deviation = 0;  // of its logarithm; 0: not known
  PhotographUse photographs;
  // Of the source views, for depth that they agree on and for composition; without, source_images serve.
  SourcePhotographs source_photographs;
  // One a generator: (views, special + patch tokens, channels), standard normal: the state at flow time 1.
  std::vector<torch::Tensor> noise;
  FlowSettings flow;
  ExactSavings savings;
  DecodedViews image_views = DecodedViews::kTargets;
  DecodedViews geometry_views = DecodedViews::kNone;
  GeometryMaps geometry_maps = GeometryMaps::kDepthAndRays;
  GeometryCameras geometry_cameras = GeometryCameras::kFound;  // for models.geometry_model_backbone
  torch::Device device = torch::kCPU;
  // Called when a flow-matching stage starts (step 0) and after each accepted step.
  std::function<void(const std::string& stage, const SolveProgress& progress)> on_step;
  // After so many evaluations of a flow, and again after as many, on_preview gets the target views that its present
  // prediction decodes to, with what no flow has made yet at its mean and nothing of the photographs laid over, (target
  // views, 3, height, width). The decoder, and a backbone that completes levels, are in memory beside the flow's model
  // for it. 0 stands for never.
  int64_t preview_every = 0;
  std::function<void(const std::string& stage, const torch::Tensor& images)> on_preview;
  // Asked before each evaluation of a flow and each stage whether to stop, beside Ctrl-C; may be empty. Interrupted is
  // thrown then.
  std::function<bool()> stop_requested;
  bool stop_asked() const;
  // These levels are there already, as PipelineResult::latents holds them: their flows are not run.
  std::map<int64_t, torch::Tensor> kept_latents;
  // Called when a flow has generated its level.
  std::function<void(int64_t level, const torch::Tensor& latent)> on_latent;
  // Whether the latents of all views are wanted, so that none is left out of the flows.
  bool all_latents = false;
  // Called when the images are there and geometry is still to come, so that they can be written already; composed as in
  // PipelineResult.
  std::function<void(const torch::Tensor& images, const std::optional<ComposedViews>& composed)> on_images;

  StageRequest stage_request() const;
};

// What a flow-matching stage did.
struct FlowReport {
  std::string stage;
  LevelGenerator generator;
  bool kept = false;  // not run: its level was among PipelineRequest::kept_latents
  std::vector<double> times;
  int64_t evaluations = 0;
  int64_t rejected = 0;
  GuidanceReport guidance;
  BranchChoice branches;
  DitCounts counts;
};

struct PipelineResult {
  LatentGrid grid;  // of all views
  // Generated levels by number: normalised latents, (views, special + patch tokens, channels), on the CPU.
  std::map<int64_t, torch::Tensor> latents;
  // All levels as decoders take them, (views, patch tokens, channels); empty when nothing is decoded, and a level that
  // is neither generated nor propagated is undefined.
  std::vector<torch::Tensor> levels;
  torch::Tensor
      leading;  // of the last level and all views (CompletedLevels); undefined when nothing is decoded
  torch::Tensor images;  // (decoded views, 3, height, width), RGB, not clamped; undefined when not asked for
  // What the photographs agree on, of the source views; undefined members where they were not matched.
  std::optional<StereoScene> stereo;
  // What the geometry head alone says of the source views, in the unit of their cameras; none where it was not
  // asked for their depth or the unit is not known.
  std::vector<PlanarDepth> head_depth;
  // Where that unit is a guess (GeometryOutput::single_view, or PipelineRequest::single_source_unit), this is the
  // deviation of its logarithm, if known.
  double head_depth_log_deviation = 0;
  // One a generator: how far the source views' latents are from its statistics (gld/latents/latent_divergence.h).
  std::vector<double> divergences;
  // Of the target views, where photographs were kept in them: images are then the composed ones.
  std::optional<ComposedViews> composed;
  torch::Tensor generated_images;  // before composition; undefined where there was none, or not for all views
  // These target views, by number from 0, come from photographs alone: no flow was run for them. Then latents, levels,
  // leading and grid are of the other views, and geometry is what the head sees in the pictures of all.
  std::vector<int64_t> carried_only;
  GeometryOutput geometry;  // of the decoded views; maps not asked for are undefined
  // Of the views of geometry.depth, in the unit of their cameras, where photographs were matched and tell it: what they
  // agree on, and the head's depth for the rest (fused_view_depths()).
  std::vector<PlanarDepth> view_depth;
  std::string view_depth_from;  // who says it, for people
  std::vector<FlowReport> flows;
  int64_t refined = 0;  // target views whose latents were repaired, behind the flows
  std::vector<std::string> warnings;
};

// Runs sampling_stages() (docs/DESIGN.md section 1). Each stage is recorded, and can be interrupted between steps.
// Throws Error naming the stage, and for flows the step and time, where a number is not finite.
PipelineResult run_pipeline(const PipelineModels& models, const PipelineRequest& request,
                            StageRecords& stages);

}  // namespace gld
