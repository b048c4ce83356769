#include "infer/forecast/method_choice.h"

#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "infer/forecast/machine_rates.h"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

std::filesystem::path table_of(const ModelBundle& bundle) { return bundle.folder() / kPlanErrorsFile; }

bool same_grid(const LatentGrid& a, const LatentGrid& b) {
  return a.views == b.views && a.height == b.height && a.width == b.width;
}

// Returns what this machine is expected to take, in seconds.
double seconds_of_method(const SamplingMethod& method, const SampleOptions& options,
                         const ModelBundle& bundle, PlanRequest request, const MachineSpeed& speed) {
  request.flow = flow_settings(method, options.guidance, bundle.options());
  SamplingPlan plan = plan_sampling(bundle.options(), request);
  predict_seconds(plan, speed);
  return plan.seconds();
}

// Returns what each method takes for this request, in seconds. A small model spends its time on more than operations,
// so that time and operations do not rank methods alike: where the table was measured on scenes of this size its own
// seconds are compared, else those that this machine is expected to take.
std::vector<double> method_seconds(const PlanErrors& table, const SampleOptions& options,
                                   const ModelBundle& bundle, const PlanRequest& request,
                                   const MachineSpeed& speed) {
  const bool measured = same_grid(table.grid, request.grid) &&
                        std::all_of(table.methods.begin(), table.methods.end(),
                                    [](const MethodErrors& entry) { return entry.seconds > 0; });
  std::vector<double> seconds;
  for (const auto& entry : table.methods) {
    seconds.push_back(measured ? entry.seconds
                               : seconds_of_method(entry.method, options, bundle, request, speed));
  }
  return seconds;
}

// Returns whether a measured method may be taken with these options.
bool allowed(const MethodErrors& entry, const SampleOptions& options) {
  const ComputePrecision precision = entry.method.precision;
  if (!errors_hold_on(options.device, precision)) return false;
  const bool named =
      std::find(options.named.begin(), options.named.end(), "precision") != options.named.end() ||
      options.precision != PrecisionChoice::kFloat32;
  if (named && options.precision != PrecisionChoice::kAutomatic)
    return precision == precision_of(options.precision);
  return has_matrix_unit(precision) && entry.of_precision <= largest_automatic_error(precision);
}

std::string size_text(const LatentGrid& grid) {
  return fmt::format("{} views of {}x{} tokens", grid.views, grid.width, grid.height);
}

// Returns notes on where the scene is unlike those that were measured.
std::vector<std::string> notes_on(const PlanErrors& table, const PlanRequest& request,
                                  double guidance_scale) {
  std::vector<std::string> notes;
  const std::string measured = size_text(table.grid), here = size_text(request.grid);
  if (measured != here) {
    notes.push_back(fmt::format("The sampling error was measured on {}, this scene has {}.", measured, here));
  }
  if (guidance_scale != table.guidance_scale) {
    notes.push_back(fmt::format("The sampling error was measured with guidance scale {:g}, this is {:g}.",
                                table.guidance_scale, guidance_scale));
  }
  return notes;
}

ChosenMethod within_tolerance(const SampleOptions& options, const ModelBundle& bundle,
                              const PlanRequest& request, const MachineSpeed& speed,
                              const std::string& model_hash) {
  PlanErrors table = read_plan_errors(table_of(bundle));
  if (table.model_hash != model_hash) {
    fail({table_of(bundle).string(), "errors measured with this bundle's weights", "those of other weights",
          "measure again: gld bench sample --model " + bundle.folder().string() +
              " --synthetic 16 --write-table --out RUN"});
  }
  if (options.guidance.guidance_scale > table.guidance_scale) {
    fail({"--tolerance",
          fmt::format("a guidance scale of at most {:g}, with which errors were measured",
                      table.guidance_scale),
          fmt::format("{:g}", options.guidance.guidance_scale),
          "lower --guidance-scale, or measure with it: gld bench sample --guidance-scales"});
  }
  auto& methods = table.methods;
  methods.erase(std::remove_if(methods.begin(), methods.end(),
                               [&](const MethodErrors& entry) { return !allowed(entry, options); }),
                methods.end());
  const size_t best =
      cheapest_within(table, options.tolerance, method_seconds(table, options, bundle, request, speed));
  ChosenMethod choice;
  choice.device = options.device;
  choice.method = table.methods[best].method;
  choice.errors = table.methods[best];
  choice.measured_scenes = table.scenes;
  choice.measured_on = fmt::format("{}, guidance {:g}", size_text(table.grid), table.guidance_scale);
  choice.reason = fmt::format("the fastest of {} measured methods with an error below --tolerance {:g}",
                              table.methods.size(), options.tolerance);
  choice.notes = notes_on(table, request, options.guidance.guidance_scale);
  return choice;
}

// Takes the fastest precision whose error with this method was measured to be small enough.
void choose_precision(const PlanErrors& table, const SampleOptions& options, const ModelBundle& bundle,
                      const PlanRequest& request, const MachineSpeed& speed, SamplingMethod& method) {
  double least = seconds_of_method(method, options, bundle, request, speed);
  for (const auto& entry : table.methods) {
    SamplingMethod in_float32 = entry.method;
    in_float32.precision = ComputePrecision::kFloat32;
    SamplingMethod asked = method;
    asked.precision = ComputePrecision::kFloat32;
    if (!same_method(in_float32, asked) || !allowed(entry, options)) continue;
    const double seconds = seconds_of_method(entry.method, options, bundle, request, speed);
    if (seconds >= least) continue;
    least = seconds;
    method.precision = entry.method.precision;
  }
}

}  // namespace

ChosenMethod choose_method(const SampleOptions& options, const ModelBundle& bundle,
                           const PlanRequest& request, const MachineSpeed& speed,
                           const std::function<std::string()>& model_hash) {
  const bool measured = std::filesystem::is_regular_file(table_of(bundle));
  if (options.tolerance > 0) {
    return within_tolerance(options, bundle, request, speed, measured ? model_hash() : std::string());
  }
  const bool automatic = options.precision == PrecisionChoice::kAutomatic;
  ChosenMethod choice;
  choice.device = options.device;
  choice.method = options.method();
  choice.reason = options.quality != SamplingQuality::kOptions ? "asked for by --quality" : "by the options";
  const auto float32_because = [&](const char* reason) {
    if (!automatic) return;
    choice.notes.push_back(
        fmt::format("{}, so that --precision automatic is float32: gld bench sample measures.", reason));
  };
  if (!measured) {
    float32_because("No precision was measured with this model");
    return choice;
  }
  const PlanErrors table = read_plan_errors(table_of(bundle));
  if (table.model_hash != model_hash()) {
    float32_because("The measured errors are of other weights");
  } else if (!errors_of(table, choice.method)) {
    float32_because("No precision was measured with this method");
  }
  if (automatic && table.model_hash == model_hash()) {
    // The method is first the float32 method that was asked for, then that in the precision that was found.
    SamplingMethod found = choice.method;
    choose_precision(table, options, bundle, request, speed, found);
    choice.method.precision = found.precision;
  }
  const auto errors = errors_hold_on(options.device, choice.method.precision)
                          ? errors_of(table, choice.method)
                          : std::nullopt;
  if (!errors || table.model_hash != model_hash()) return choice;
  choice.errors = errors;
  choice.measured_scenes = table.scenes;
  choice.measured_on = fmt::format("{}, guidance {:g}", size_text(table.grid), table.guidance_scale);
  // Errors that decided nothing need no warning: what they were measured on stands beside them.
  if (automatic) choice.notes = notes_on(table, request, options.guidance.guidance_scale);
  return choice;
}

std::string choice_text(const ChosenMethod& choice) {
  const std::string error =
      choice.errors
          ? fmt::format("relative latent error at most {:.2g} (mean {:.2g}, {} scenes of {})",
                        choice.errors->bound, choice.errors->mean, choice.measured_scenes, choice.measured_on)
          : "its error was not measured";
  return fmt::format("sampling: {}: {}; {}; {}\n", choice.method.name,
                     method_text(choice.method, choice.device), choice.reason, error);
}

nlohmann::ordered_json choice_json(const ChosenMethod& choice) {
  nlohmann::ordered_json object{{"name", choice.method.name},
                                {"in_words", method_text(choice.method, choice.device)},
                                {"reason", choice.reason},
                                {"method", to_json(choice.method)}};
  if (choice.errors) {
    object["error_estimate"] = {{"largest_expected", choice.errors->bound},
                                {"mean_measured", choice.errors->mean},
                                {"largest_measured", choice.errors->largest},
                                {"scenes", choice.measured_scenes},
                                {"measured_on", choice.measured_on}};
  } else {
    object["error_estimate"] = nullptr;
  }
  return object;
}

}  // namespace gld
