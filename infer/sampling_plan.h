#pragma once

#include "gld/guidance.h"
#include "gld/solver.h"
#include "infer/sample_options.h"
#include "models/bundle_options.h"
#include "models/cost_model.h"

#include <cstdint>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// How fast this machine computes, in floating-point operations a second, measured.
struct MachineSpeed {
  double multiply_add_peak = 0;  // independent multiply-adds in registers: what fractions of peak refer to
  double linear = 0;             // large matrix products
  double attention = 0;          // softmax attention of the models' head sizes
};
// Takes about a second, with the present thread setting.
MachineSpeed measure_machine_speed();

// What sampling is planned for.
struct PlanRequest {
  LatentGrid grid;  // of all views
  int64_t num_sources = 1;
  RequestedOutputs outputs;
  SolverOptions level1_solver;
  SolverOptions cascade_solver;
  GuidanceOptions guidance;
};

struct PlannedStage {
  std::string name;  // as in StageRecords
  bool runs = true;
  std::string reason;              // why it runs or not, in words
  int64_t evaluations = 1;         // forward passes of the conditional branch
  int64_t with_unconditional = 0;  // of them with the unconditional branch beside it
  Cost cost;                       // linear_flop and attention_flop of all passes together
  double seconds = 0;              // predicted; 0 without a measured speed
  int64_t peak_bytes = 0;          // predicted resident memory
};

struct SamplingPlan {
  std::vector<PlannedStage> stages;

  double flop() const;
  double seconds() const;
  int64_t peak_bytes() const;  // of the largest stage
};

// The stages that this request needs, with their cost. Adaptive solvers are counted with options.evaluations.
SamplingPlan plan_sampling(const BundleOptions& bundle, const PlanRequest& request);
// Fills in PlannedStage::seconds.
void predict_seconds(SamplingPlan& plan, const MachineSpeed& speed);

// A table, one line a stage, for people.
std::string plan_text(const SamplingPlan& plan);
nlohmann::ordered_json plan_json(const SamplingPlan& plan);

}  // namespace gld
