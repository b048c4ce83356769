#pragma once

#include "infer/forecast/sampling_plan.h"
#include "infer/method/plan_errors.h"
#include "infer/method/sample_options.h"
#include "models/bundle/bundle.h"

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// The method that a scene is sampled with.
struct ChosenMethod {
  SamplingMethod method;
  std::string device = "cpu";          // that computes it
  std::string reason;                  // who chose it, in words
  std::optional<MethodErrors> errors;  // what was measured of it with this model, if anything
  int64_t measured_scenes = 0;
  std::string measured_on;  // the size of those scenes and the guidance, in words
  // Where what decided may not hold for this scene, a sentence each.
  std::vector<std::string> notes;
};

// Returns what options ask for: their own method, the one of --quality, or for --tolerance the one that this machine is
// expected to take the least time for among those that the bundle's plan_errors.json measured
// (infer/method/plan_errors.h). Precisions without a unit of this processor do not count, nor others than that of
// --precision where it names one. On a GPU only float32 counts, whose errors are those of the CPU. --precision
// automatic takes the fastest precision whose measured error against the same method in float32 is below
// largest_automatic_error, and float32 where there is no such measurement. model_hash is only called where the bundle
// has that file. Throws Error for a tolerance without such a measurement of these weights, at a guidance scale above
// the measured one, or below every measured bound.
ChosenMethod choose_method(const SampleOptions& options, const ModelBundle& bundle,
                           const PlanRequest& request, const MachineSpeed& speed,
                           const std::function<std::string()>& model_hash);

// Returns one line: what was chosen, by whom, and the estimate of its error.
std::string choice_text(const ChosenMethod& choice);
nlohmann::ordered_json choice_json(const ChosenMethod& choice);

}  // namespace gld
