#include "bench/sampling/sampling_methods.h"

#include "gld/base/configuration.h"
#include "gld/base/error.h"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

const std::string kFewerEvaluations = "fewer evaluations";
const std::string kPublished = "published";
const std::string kEncoderNodes = "encoder nodes";
const std::string kGuidanceInterval = "guidance interval";
const std::string kRefined = "refined";
constexpr int64_t kComparedEvaluations = 16;

SamplingMethod solver_method(SolverKind solver, ScheduleKind schedule, int64_t evaluations) {
  SamplingMethod method;
  method.solver.solver = solver;
  method.solver.schedule.schedule = schedule;
  method.solver.evaluations = evaluations;
  return method;
}

std::string family_of(const SamplingMethod& method) {
  return solver_names()[static_cast<size_t>(method.solver.solver)] + ", " +
         schedule_names()[static_cast<size_t>(method.solver.schedule.schedule)];
}

}  // namespace

bool ComparedMethod::is_fewer_evaluations() const { return family == kFewerEvaluations; }

bool ComparedMethod::is_offered() const {
  const auto known = {kFewerEvaluations, kPublished, kEncoderNodes, kGuidanceInterval};
  return method.precision != ComputePrecision::kFloat32 ||
         std::find(known.begin(), known.end(), family) != known.end();
}

SamplingMethod plain_method(int64_t evaluations) {
  SamplingMethod method = quality_method(SamplingQuality::kExact);
  if (evaluations == method.solver.evaluations) return method;
  method.solver.evaluations = evaluations;
  method.name = fmt::format("{} evaluations", evaluations);
  return method;
}

std::vector<ComparedMethod> compared_methods(const std::vector<int64_t>& counts,
                                             const std::vector<ComputePrecision>& precisions,
                                             double guidance_scale, const BundleOptions& bundle) {
  std::vector<ComparedMethod> methods;
  const auto add = [&](const std::string& family, SamplingMethod method) {
    const bool known = std::any_of(methods.begin(), methods.end(), [&](const ComparedMethod& other) {
      return same_method(other.method, method);
    });
    if (!known) methods.push_back({family, guidance_scale, std::move(method)});
  };
  const auto add_changed = [&](const std::string& family, int64_t evaluations, const std::string& what,
                               const auto& change) {
    SamplingMethod method = plain_method(evaluations);
    method.name = fmt::format("{} evaluations, {}", evaluations, what);
    change(method);
    add(family, std::move(method));
  };
  add(kPublished, quality_method(SamplingQuality::kPublished));
  for (const int64_t count : counts) add(kFewerEvaluations, plain_method(count));
  for (const auto& [solver, schedule] : {std::pair{SolverKind::kEuler, ScheduleKind::kPublished},
                                         {SolverKind::kEuler, ScheduleKind::kLogSnr},
                                         {SolverKind::kDpmSolver2M, ScheduleKind::kLogSnr},
                                         {SolverKind::kUniPc2, ScheduleKind::kLogSnr}}) {
    for (const int64_t count : counts) {
      SamplingMethod method = solver_method(solver, schedule, count);
      method.name = fmt::format("{}, {} evaluations", family_of(method), count);
      const std::string family = family_of(method);
      add(family, std::move(method));
    }
  }
  if (can_have_encoder_nodes(bundle)) {
    for (const auto& [evaluations, nodes] : {std::pair<int64_t, int64_t>{kComparedEvaluations, 4},
                                             {kComparedEvaluations, 6},
                                             {kComparedEvaluations, 8},
                                             {10, 6},
                                             {12, 6},
                                             {24, 8}}) {
      const int64_t count = nodes;
      add_changed(kEncoderNodes, evaluations, fmt::format("{} nodes", nodes),
                  [&](SamplingMethod& method) { method.approximate.cascade_encoder_nodes = count; });
    }
  }
  if (guidance_scale != 1) {
    for (const double low : {0.9, 0.5}) {
      add_changed(kGuidanceInterval, kComparedEvaluations, fmt::format("guided from t = {:g}", low),
                  [&](SamplingMethod& method) {
                    method.guidance_interval = {low, 1};
                  });
    }
  }
  if (bundle.refiner.repairs_samples()) {
    for (const int64_t count : {4, 6, 8}) {
      add_changed(kRefined, count, "refined", [](SamplingMethod& method) { method.refine = true; });
    }
  }
  for (const ComputePrecision precision : precisions) {
    if (precision == ComputePrecision::kFloat32) continue;
    const std::string& family = compute_precision_name(precision);
    for (const int64_t count : counts) {
      SamplingMethod method = plain_method(count);
      method.precision = precision;
      method.name += ", " + family;
      add(family, std::move(method));
    }
  }
  return methods;
}

std::vector<ComparedMethod> of_families(std::vector<ComparedMethod> methods,
                                        const std::vector<std::string>& families) {
  if (families.empty()) return methods;
  std::vector<std::string> names;
  names.reserve(methods.size());
  for (const auto& compared : methods) names.push_back(compared.family);
  const auto among = [](const std::vector<std::string>& texts, const std::string& text) {
    return std::find(texts.begin(), texts.end(), text) != texts.end();
  };
  for (const auto& family : families) {
    if (among(names, family)) continue;
    // Most have a comma in their name, at which a flag's value is cut into two.
    std::string known;
    for (const auto& name : names) {
      const std::string quoted = "'" + name + "'";
      if (known.find(quoted) == std::string::npos) known += (known.empty() ? "" : ", ") + quoted;
    }
    const bool cut = std::any_of(names.begin(), names.end(),
                                 [&](const std::string& name) { return name.rfind(family + ",", 0) == 0; });
    const auto near = nearest_name(family, names);
    fail({"--families", "kinds of methods (" + known + ")", "'" + family + "'",
          cut            ? "give a name with a comma by --set \"families=['euler, logsnr']\""
          : near.empty() ? "choose among them"
                         : "did you mean '" + near + "'?"});
  }
  methods.erase(std::remove_if(methods.begin(), methods.end(),
                               [&](const ComparedMethod& compared) {
                                 return !compared.is_fewer_evaluations() && !among(families, compared.family);
                               }),
                methods.end());
  return methods;
}

}  // namespace gld
