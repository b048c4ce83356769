#include "infer/sample_options.h"

#include "gld/configuration.h"
#include "gld/error.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {
namespace {

constexpr int64_t kPublishedEvaluations = 49;  // 50 times

}  // namespace

SampleOptions::SampleOptions() {
  solver.schedule.shift = 0;  // the model's
}

void SampleOptions::visit(FieldVisitor& visitor) {
  visitor.text({"model", "model bundle: a folder with model.yaml"}, model);
  visitor.text({"scene", "folder of the scene: images with cameras"}, scene);
  visitor.group({"reading", "how the scene is read"}, reading);
  visitor.group({"views", "which views"}, views);
  visitor.text({"size", "WIDTHxHEIGHT in pixels, or auto: the trained size of the nearest aspect"}, size);
  visitor.texts({"outputs", "what to make: image, depth, rays, points, latents"}, outputs);
  visitor.integer({"seed", "seed of the noise; the same seed gives the same bytes"}, seed, {0});
  visit_choice(visitor, {"preset", "published: the release's sampler, whatever the solver options say"},
               preset, {"options", "published"});
  visitor.group({"solver", "how the flow is integrated"}, solver);
  visitor.group({"guidance", "classifier-free guidance"}, guidance);
  visitor.texts({"no_skip", "exact savings to switch off, so that they can be measured: " +
                                fmt::format("{}", fmt::join(exact_saving_names(), ", "))},
                no_skip);
  visitor.text({"device", "cpu, cuda or cuda:N"}, device);
  visitor.integer({"threads", "threads; 0: one a core"}, threads, {0, 4096});
  visitor.text({"out", "run folder to write"}, out);
}

void SampleOptions::check() const {
  if (scene.empty()) {
    fail({"--scene", "a folder of images with cameras", "nothing", "add for example --scene my_photos"});
  }
  if (out.empty()) fail({"--out", "a folder to write into", "nothing", "add for example --out runs/sample"});
  requested();
  savings();
}

ExactSavings SampleOptions::savings() const {
  ExactSavings savings;
  for (const auto& name : no_skip) disable_exact_saving(savings, name);
  return savings;
}

RequestedOutputs SampleOptions::requested() const {
  RequestedOutputs requested;
  struct Output {
    const char* name;
    bool RequestedOutputs::*member;
  };
  const std::vector<Output> known{{"image", &RequestedOutputs::image},
                                  {"depth", &RequestedOutputs::depth},
                                  {"rays", &RequestedOutputs::rays},
                                  {"points", &RequestedOutputs::points},
                                  {"latents", &RequestedOutputs::latents}};
  std::vector<std::string> names;
  for (const auto& output : known) names.emplace_back(output.name);
  for (const auto& name : outputs) {
    bool found = false;
    for (const auto& output : known) {
      if (name != output.name) continue;
      requested.*(output.member) = true;
      found = true;
    }
    if (!found) {
      const auto near = nearest_name(name, names);
      fail({"--outputs", "image, depth, rays, points or latents", "'" + name + "'",
            near.empty() ? "choose among them" : "did you mean '" + near + "'?"});
    }
  }
  if (outputs.empty()) fail({"--outputs", "at least one output", "none", "add for example --outputs image"});
  return requested;
}

SolverOptions SampleOptions::resolved_solver(double model_shift) const {
  SolverOptions resolved = solver;
  if (preset == SamplingPreset::kPublished) {
    resolved = SolverOptions();
    resolved.solver = SolverKind::kEuler;
    resolved.evaluations = kPublishedEvaluations;
    resolved.schedule.schedule = ScheduleKind::kPublished;
    resolved.schedule.shift = 0;
  }
  if (resolved.schedule.shift == 0) resolved.schedule.shift = model_shift;
  return resolved;
}

}  // namespace gld
