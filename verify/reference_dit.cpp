#include "verify/reference_dit.h"

#include "gld/base/error.h"
#include "gld/cameras/camera_checks.h"
#include "models/dit/dit_field.h"
#include "models/weights/weight_loading.h"
#include "verify/reference_runners.h"

#include <cstdlib>

#include <fmt/format.h>

namespace gld {
namespace {

// Beside the model there is the guidance of the outputs "guided.t*".
struct DitVelocityCaseOptions : DitCaseOptions {
  double guidance_scale = 1;
  std::vector<double> guidance_interval = {0, 1};

  void visit(FieldVisitor& visitor) override {
    DitCaseOptions::visit(visitor);
    visitor.real({"guidance_scale", "guidance scale"}, guidance_scale, {0, 1000});
    visitor.reals({"guidance_interval", "flow times [low, high] where guidance acts"}, guidance_interval,
                  {0, 1});
  }
};

struct SampleCaseOptions : DitCaseOptions {
  CaseSamplerOptions sampler;

  void visit(FieldVisitor& visitor) override {
    DitCaseOptions::visit(visitor);
    sampler.visit(visitor);
  }
};

// Reads the flow time in "velocity.t0.02"; returns false for another name.
bool time_of_output(const std::string& name, const std::string& prefix, double& time) {
  if (name.compare(0, prefix.size(), prefix) != 0) return false;
  const char* text = name.c_str() + prefix.size();
  char* end = nullptr;
  time = std::strtod(text, &end);
  return end != text && *end == '\0';
}

}  // namespace

void DitCaseOptions::visit(FieldVisitor& visitor) {
  model.visit(visitor);
  visitor.integer({"height", "image height in pixels"}, height, {1, 1 << 16});
  visitor.integer({"width", "image width in pixels"}, width, {1, 1 << 16});
  visitor.integer({"num_views", "source and target views"}, num_views, {1, 1 << 16});
  visitor.integer({"num_sources", "source views, which come first"}, num_sources, {1, 1 << 16});
}

void DitCaseOptions::check() const {
  model.check();
  if (num_sources > num_views) {
    fail({"num_sources", fmt::format("at most num_views, {}", num_views), std::to_string(num_sources),
          "correct it"});
  }
}

void CaseSamplerOptions::visit(FieldVisitor& visitor) {
  visit_choice(visitor, {"solver", "how the flow is integrated"}, solver, solver_names());
  visitor.integer({"num_times", "flow times, one more than Euler steps"}, num_times, {2, 100000});
  visitor.real({"time_shift", "shift of the flow times"}, time_shift, {1, 100000});
  visitor.real({"last_time", "last flow time before the shift"}, last_time, {0, 0.999});
  visitor.real({"guidance_scale", "guidance scale"}, guidance_scale, {0, 1000});
  visitor.reals({"guidance_interval", "flow times [low, high] where guidance acts"}, guidance_interval,
                {0, 1});
}

SolverOptions CaseSamplerOptions::solver_options() const {
  SolverOptions options;
  options.solver = solver;
  options.evaluations = num_times - 1;
  options.schedule.schedule = ScheduleKind::kPublished;
  options.schedule.shift = time_shift;
  options.schedule.last_time = last_time;
  return options;
}

GuidanceOptions CaseSamplerOptions::guidance_options() const {
  GuidanceOptions options;
  options.guidance_scale = guidance_scale;
  options.guidance_interval = guidance_interval;
  return options;
}

Views reference_views(const ReferenceCase& reference, const CaseViewSizes& sizes) {
  const auto poses =
      reference.input("camera_to_world", {sizes.num_views, 4, 4}).to(torch::kFloat64).contiguous();
  const auto intrinsics =
      reference.input("intrinsics", {sizes.num_views, 3, 3}).to(torch::kFloat64).contiguous();
  Views views;
  views.num_sources = sizes.num_sources;
  using RowMajor4 = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;
  using RowMajor3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
  for (int64_t view = 0; view < sizes.num_views; ++view) {
    Camera camera;
    camera.width = sizes.width;
    camera.height = sizes.height;
    camera.world_from_camera.matrix() = Eigen::Map<const RowMajor4>(poses.data_ptr<double>() + 16 * view);
    camera.intrinsics = Eigen::Map<const RowMajor3>(intrinsics.data_ptr<double>() + 9 * view);
    views.cameras.push_back(camera);
  }
  check_cameras(views, (reference.folder / "inputs.safetensors").string());
  return views;
}

torch::Tensor reference_latent(const ReferenceCase& reference, const std::string& name,
                               const DitCaseOptions& options) {
  const auto grid = options.grid();
  const int64_t channels = options.model.in_channels, special = options.model.num_special_tokens;
  if (special > 0)
    return reference.module_input(name, {grid.views, special + grid.tokens_per_view(), channels});
  return reference.module_input(name, {grid.views, channels, grid.height, grid.width})
      .flatten(2)
      .transpose(1, 2)
      .contiguous();
}

torch::Tensor latent_in_case_layout(const torch::Tensor& tokens, const DitCaseOptions& options) {
  if (options.model.num_special_tokens > 0) return tokens;
  const auto grid = options.grid();
  return tokens.transpose(1, 2).reshape({grid.views, tokens.size(2), grid.height, grid.width});
}

DitSceneInputs reference_scene(const ReferenceCase& reference, const DitCaseOptions& options) {
  DitSceneInputs scene;
  scene.views =
      reference_views(reference, {options.num_views, options.num_sources, options.width, options.height});
  const auto source = reference_latent(reference, "source_features", options);
  if (source.slice(0, options.num_sources).abs().sum().item<double>() != 0) {
    fail({(reference.folder / "inputs.safetensors").string() + ": source_features",
          "zeros for the target views", "other numbers", "write the case again"});
  }
  scene.source_features = source.slice(0, 0, options.num_sources);
  if (options.model.conditioning == DitConditioning::kDeeperLevel) {
    scene.deeper_level = reference_latent(reference, "deeper_level", options);
  }
  return scene;
}

std::shared_ptr<DitDh> reference_dit(const ReferenceCase& reference, const DitOptions& options,
                                     const std::string& prefix) {
  auto model = std::make_shared<DitDh>(options, reference.placement());
  WeightSelection selection;
  selection.prefix = prefix;
  load_strict(*model, reference.weight_file(), selection);
  reference.apply_precision(*model, ModelKind::kGenerator);
  return model;
}

NamedTensors run_dit_case(const ReferenceCase& reference) {
  torch::NoGradGuard no_grad;
  DitVelocityCaseOptions options;
  reference.read_config(options);
  const auto model = reference_dit(reference, options.model);
  DitField field(*model, model->prepare_scene(reference_scene(reference, options)));
  GuidanceOptions guidance;
  guidance.guidance_scale = options.guidance_scale;
  guidance.guidance_interval = options.guidance_interval;
  GuidedField guided(field, guidance);

  const auto noisy = reference_latent(reference, "noisy", options);
  NamedTensors outputs;
  for (const auto& [name, expected] : reference.expected) {
    double time = 0;
    if (time_of_output(name, "velocity.t", time)) {
      outputs[name] = latent_in_case_layout(field.conditional(noisy, time), options);
    } else if (time_of_output(name, "guided.t", time)) {
      outputs[name] = latent_in_case_layout(guided.velocity(noisy, time), options);
    }
  }
  return outputs;
}

NamedTensors run_sample_case(const ReferenceCase& reference) {
  torch::NoGradGuard no_grad;
  SampleCaseOptions options;
  reference.read_config(options);
  const auto model = reference_dit(reference, options.model);
  DitField field(*model, model->prepare_scene(reference_scene(reference, options)));
  GuidedField guided(field, options.sampler.guidance_options());

  const auto solver = options.sampler.solver_options();
  const auto times = schedule_times(solver.schedule, options.sampler.num_times - 1);
  field.prepare_times(times);
  const auto solution = solve_on(guided, reference_latent(reference, "noise", options), solver, times);
  return {{"times", torch::tensor(times, torch::kFloat64)},
          {"latent", latent_in_case_layout(solution.state, options)}};
}

}  // namespace gld
