#pragma once

#include "verify/reference_case.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <torch/types.h>

#include <nlohmann/json.hpp>

namespace gld {

// The comparison of one output tensor with its reference (the rule of the reference cases):
// it passes where max|a - b| <= relative_tolerance * max(1, max|b|), a has b's shape, and every value is
// finite. A reference without elements fails.
struct TensorComparison {
  std::string name;
  bool passed = false;
  int64_t count = 0;          // elements of the reference
  double max_difference = 0;  // NaN where the values could not be compared
  double mean_difference = 0;
  std::vector<int64_t> worst_index;  // of the largest difference, or of the first non-finite value
  double computed_value = 0;         // at worst_index
  double expected_value = 0;
  double tolerance = 0;  // relative_tolerance * max(1, max|b|)
  std::string problem;   // why nothing could be compared: "missing", "empty", a shape; else empty
};

TensorComparison compare_tensor(const std::string& name, const torch::Tensor& computed,
                                const torch::Tensor& expected, double relative_tolerance);

// Returns one row an expected tensor, in the order of their names. A tensor that was not computed fails.
std::vector<TensorComparison> compare_outputs(const ReferenceCase& reference, const NamedTensors& computed);

struct CaseVerification {
  std::filesystem::path folder;
  std::string kind;  // empty where case.json could not be read
  std::vector<TensorComparison> tensors;
  std::string error;  // the sentence of what stopped the case; empty when it ran
  double seconds = 0;

  bool passed() const;
};

// Returns what a case's tolerance is in a precision: it is itself in float32; in bfloat16 and int8 it is 0.05 and 0.1
// of the largest value at least, beyond which something else than rounding is wrong. What they deviate by is in the
// comparisons.
double tolerance_in(ComputePrecision precision, double relative_tolerance);

// Reads, runs and compares one case. Never throws for a fault of the case: it becomes the error of the result. It runs
// without autograd; a runner that needs gradients switches it on for itself.
CaseVerification verify_case(const std::filesystem::path& folder, const ReferenceRunners& runners,
                             const CaseCompute& compute = {});

// Returns one line for the case and one a tensor; then one line for all, with the LibTorch that they ran on.
std::string case_text(const CaseVerification& result);
std::string summary_text(const std::vector<CaseVerification>& cases, const CaseCompute& compute = {});
// Returns {"passed", "libtorch", "blas", "device", "precision", "cases": [{"folder", "kind", "passed", "seconds",
// "tensors": [...], "error"}]}; numbers that are not finite are null.
nlohmann::json verification_json(const std::vector<CaseVerification>& cases, const CaseCompute& compute = {});

}  // namespace gld
