#include "infer/method/sampling_method.h"

#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/machine/precision_option.h"

#include <algorithm>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr int64_t kPublishedEvaluations = 49;  // 50 times

SamplingMethod default_solver_method(const std::string& name, int64_t evaluations) {
  SamplingMethod method;
  method.name = name;
  method.solver.solver = SolverKind::kUniPc3;
  method.solver.evaluations = evaluations;
  method.solver.schedule.schedule = ScheduleKind::kLogSnr;
  return method;
}

// A file of times says how many evaluations a fixed-step solver takes, whatever the option evaluations says.
SolverOptions with_evaluations_of_file(SolverOptions solver) {
  if (solver.schedule.schedule != ScheduleKind::kFile || is_adaptive(solver.solver)) return solver;
  const auto steps = static_cast<int64_t>(schedule_times(solver.schedule, 1).size()) - 1;
  int64_t evaluations = 1;
  while (steps_for_evaluations(solver.solver, evaluations) < steps) ++evaluations;
  // One step is the least of any number of evaluations: two of them tell what a step costs.
  if (steps == 1) {
    while (steps_for_evaluations(solver.solver, evaluations) < 2) ++evaluations;
    int64_t three = evaluations;
    while (steps_for_evaluations(solver.solver, three) < 3) ++three;
    evaluations -= three - evaluations;
  }
  solver.evaluations = evaluations;
  return solver;
}

}  // namespace

SamplingMethod::SamplingMethod() {
  solver.schedule.shift = 0;  // the model's
}

void SamplingMethod::visit(FieldVisitor& visitor) {
  visitor.text({"name", "what it is called"}, name);
  visitor.group({"solver", "how the flow is integrated"}, solver);
  visitor.reals({"guidance_interval", "flow times [low, high] where guidance acts, both included"},
                guidance_interval, {0, 1});
  visitor.group({"approximate", "approximate savings"}, approximate);
  visitor.boolean({"refine", "repair what the flows made in one call a target view"}, refine);
  visit_choice(visitor, {"precision", "what models multiply in"}, precision, compute_precision_names());
}

SamplingMethod method_of_options(const SolverOptions& solver, const GuidanceOptions& guidance,
                                 const ApproximateSavings& approximate, ComputePrecision precision) {
  SamplingMethod method;
  method.name = "as the options say";
  method.solver = solver;
  method.guidance_interval = guidance.guidance_interval;
  method.approximate = approximate;
  method.precision = precision;
  return method;
}

bool same_method(const SamplingMethod& a, const SamplingMethod& b) {
  SamplingMethod renamed = b;
  renamed.name = a.name;
  return to_json(a) == to_json(renamed);
}

std::string method_text(const SamplingMethod& method, const std::string& device) {
  const SolverOptions solver = with_evaluations_of_file(method.solver);
  std::string text = fmt::format("{} on {}, ", solver_names()[static_cast<size_t>(solver.solver)],
                                 schedule_names()[static_cast<size_t>(solver.schedule.schedule)]);
  text += is_adaptive(solver.solver) ? fmt::format("tolerance {:g}", solver.tolerance)
                                     : fmt::format("{} evaluations a level", solver.evaluations);
  if (method.guidance_interval[0] > 0 || method.guidance_interval[1] < 1) {
    text += fmt::format("; guidance from t = {:g} to {:g}", method.guidance_interval[1],
                        method.guidance_interval[0]);
  }
  const auto& savings = method.approximate;
  if (savings.cascade_encoder_nodes > 0) {
    text += fmt::format("; cascade encoder at {} flow times", savings.cascade_encoder_nodes);
  }
  if (method.refine) text += "; refined";
  if (method.precision != ComputePrecision::kFloat32) text += "; " + precision_text(method.precision, device);
  return text;
}

const std::vector<std::string>& sampling_quality_names() {
  static const std::vector<std::string> names{"options", "published", "exact", "fast"};
  return names;
}

bool can_have_encoder_nodes(const BundleOptions& bundle) {
  return std::any_of(bundle.generators.begin(), bundle.generators.end(), [](const GeneratorOptions& part) {
    return part.generator.is_cascade() && !part.dit.encoder_sees_noisy();
  });
}

SamplingMethod quality_method(SamplingQuality quality) {
  SamplingMethod method;
  switch (quality) {
    case SamplingQuality::kOptions:
    case SamplingQuality::kExact:
      method = default_solver_method("exact", 16);
      break;
    case SamplingQuality::kPublished:
      method.name = "published";
      method.solver.solver = SolverKind::kEuler;
      method.solver.evaluations = kPublishedEvaluations;
      method.solver.schedule.schedule = ScheduleKind::kPublished;
      break;
    case SamplingQuality::kFast:
      method = default_solver_method("fast", 6);
      break;
  }
  return method;
}

void require_sample_refiner(const BundleOptions& bundle) {
  if (bundle.refiner.repairs_samples()) return;
  fail({"--refine", "a model with a refiner of samples",
        (bundle.refiner.exists() ? "one of splats in " : "none in ") + bundle.name,
        "train one with gld train sample-refiner, or leave --refine out"});
}

FlowSettings flow_settings(const SamplingMethod& method, const GuidanceOptions& guidance,
                           const BundleOptions& bundle) {
  if (method.refine) require_sample_refiner(bundle);
  FlowSettings settings;
  for (const auto& part : bundle.generators) {
    SolverOptions solver = with_evaluations_of_file(method.solver);
    if (solver.schedule.shift == 0) solver.schedule.shift = part.time_shift.evaluation;
    settings.solvers.push_back(solver);
  }
  settings.guidance = guidance;
  settings.guidance.guidance_interval = method.guidance_interval;
  settings.approximate = method.approximate;
  settings.refine = method.refine;
  settings.precision = method.precision;
  return settings;
}

FlowSettings mean_prediction_settings(const BundleOptions& bundle) {
  SamplingMethod method;
  method.name = "mean prediction";
  method.solver.evaluations = 1;
  GuidanceOptions guidance;
  guidance.guidance_scale = 1;
  return flow_settings(method, guidance, bundle);
}

}  // namespace gld
