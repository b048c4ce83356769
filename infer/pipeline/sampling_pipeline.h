#pragma once

#include "gld/cameras/camera.h"
#include "gld/cameras/view_visibility.h"
#include "gld/flow/guidance.h"
#include "gld/flow/solvers/solver.h"
#include "gld/latents/latent_statistics.h"
#include "gld/machine/stage_record.h"
#include "models/backbones/da3_backbone.h"
#include "models/cost/branch_choice.h"
#include "models/decoders/dpt_head.h"
#include "models/decoders/rgb_decoder.h"
#include "models/dit/approximate_savings.h"
#include "models/dit/dit_dh.h"
#include "models/dit/dit_field.h"
#include "models/dit/exact_savings.h"

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// Where the stages get their modules. Each function is called when a stage starts and what it returns is dropped when
// the stage ends, so that the weights of one stage are in memory at a time.
struct PipelineModels {
  std::function<std::shared_ptr<Da3Backbone>()> backbone;
  std::function<std::shared_ptr<DitDh>()> level1;
  std::function<std::shared_ptr<DitDh>()> cascade;
  std::function<std::shared_ptr<RgbDecoder>()> rgb_decoder;
  std::function<std::shared_ptr<DptHead>()> dpt_head;
  LatentStatistics level0_statistics;
  LatentStatistics level1_statistics;
};

// Which views are decoded.
enum class DecodedViews { kNone, kTargets, kAll };

struct PipelineRequest {
  Views views;                  // one size, in whole patches
  torch::Tensor source_images;  // (source views, 3, height, width), RGB in [0, 1]
  // (views, patch tokens, channels), standard normal: the state at flow time 1.
  torch::Tensor level1_noise;
  torch::Tensor level0_noise;
  SolverOptions level1_solver;
  SolverOptions cascade_solver;
  GuidanceOptions guidance;
  ExactSavings savings;
  ApproximateSavings approximate;
  DecodedViews image_views = DecodedViews::kTargets;
  DecodedViews geometry_views = DecodedViews::kNone;
  GeometryMaps geometry_maps = GeometryMaps::kDepthAndRays;
  torch::Device device = torch::kCPU;
  // Called when a flow-matching stage starts (step 0) and after each accepted step.
  std::function<void(const std::string& stage, const SolveProgress& progress)> on_step;
  // Called when the images are there and geometry is still to come, so that they can be written already.
  std::function<void(const torch::Tensor& images)> on_images;
};

// What a flow-matching stage did.
struct FlowReport {
  std::string stage;
  std::vector<double> times;
  int64_t evaluations = 0;
  int64_t rejected = 0;
  GuidanceReport guidance;
  BranchChoice branches;
  DitCounts counts;
};

struct PipelineResult {
  LatentGrid grid;  // of all views
  // Normalised latents, (views, patch tokens, channels), on the CPU.
  torch::Tensor level1;
  torch::Tensor level0;
  // The four levels as decoders take them, (decoded views, patch tokens, channels); undefined when not needed.
  std::array<torch::Tensor, 4> levels;
  torch::Tensor images;  // (decoded views, 3, height, width), RGB, not clamped; undefined when not asked for
  GeometryOutput geometry;  // of the decoded views; maps not asked for are undefined
  std::vector<FlowReport> flows;
  // Which views attended to each other, where request.approximate asked to leave some out.
  std::optional<ViewVisibility> view_pairs;
  std::vector<std::string> warnings;
};

// Source encoding, view pairs (only with approximate.view_pairs), M1, cascade, propagation, RGB decoding and geometry
// (DESIGN.md section 1). Each stage is recorded, and can be interrupted between steps. Throws Error naming the stage, and
// for flows the step and time, where a number is not finite.
PipelineResult run_pipeline(const PipelineModels& models, const PipelineRequest& request,
                            StageRecords& stages);

}  // namespace gld
