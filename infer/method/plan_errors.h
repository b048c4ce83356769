#pragma once

#include "gld/cameras/camera.h"
#include "infer/method/sampling_method.h"

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// What `gld bench sample` measured of one method. An error is the RMS of the latents' difference from a converged
// solve of the same noise over that solve's RMS, of level 1 or level 0, whichever is larger.
struct MethodErrors {
  SamplingMethod method;
  double mean = 0;     // over scenes
  double largest = 0;  // over scenes
  double bound = 0;    // what other scenes are expected to stay below (error_bound)
  // The largest over scenes of the same measure against the same method in float32; 0 in float32.
  double of_precision = 0;
  double seconds = 0;  // of the flows of one scene; 0 in a table of a program that did not note it
};

// Returns what of_precision may be for --precision automatic to choose a precision: 0.02 for bfloat16, 0.04 for int8;
// nothing for float32.
double largest_automatic_error(ComputePrecision precision);

// Returns an upper bound for a scene that was not measured, which one in a thousand exceeds: the predictive bound of a
// log-normal distribution, mean of the logarithms + Student's quantile * sqrt(1 + 1/n) * their deviation, and at least
// a quarter above the largest error. To the measured deviation (mostly 0.15) comes an expected one of 0.4 with the
// weight of 8 scenes: at some numbers of evaluations a single scene's error is 3.7 times the others'. errors has at
// least one number, none negative; the bound is 0 where all are 0.
double error_bound(const std::vector<double>& errors);

// The measured error model of one bundle: plan_errors.json in its folder.
struct PlanErrors {
  std::string model_hash;  // of the weights it was measured with
  int64_t scenes = 0;
  double guidance_scale = 1.5;
  LatentGrid grid;  // of the measured scenes
  std::vector<MethodErrors> methods;
};

constexpr const char* kPlanErrorsFile = "plan_errors.json";

nlohmann::ordered_json plan_errors_json(const PlanErrors& errors);
// Throws Error, naming file, when it is not such a table.
PlanErrors read_plan_errors(const std::filesystem::path& file);

// Returns, of the methods whose bound is at most the tolerance, the one with the least cost (one number a method).
// Throws Error naming the smallest tolerance that a measured method meets when none does.
size_t cheapest_within(const PlanErrors& errors, double tolerance, const std::vector<double>& cost);

// Returns whether errors measured with that precision are those of this device ("cpu", "cuda:0"): tables are of the
// CPU's kernels, with which a GPU agrees in float32 alone.
bool errors_hold_on(const std::string& device, ComputePrecision precision);

// Returns the measurement of the same method, if it is in the table.
std::optional<MethodErrors> errors_of(const PlanErrors& errors, const SamplingMethod& method);

}  // namespace gld
