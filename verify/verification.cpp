#include "verify/verification.h"

#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/tensors/device.h"
#include "gld/tensors/out_of_memory.h"
#include "gld/tensors/torch_version.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <new>

#include <torch/autograd.h>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {
namespace {

constexpr double kNotANumber = std::numeric_limits<double>::quiet_NaN();

std::vector<int64_t> index_of(int64_t flat, const torch::Tensor& tensor) {
  std::vector<int64_t> index(static_cast<size_t>(tensor.dim()));
  for (int64_t axis = tensor.dim() - 1; axis >= 0; --axis) {
    index[static_cast<size_t>(axis)] = flat % tensor.size(axis);
    flat /= tensor.size(axis);
  }
  return index;
}

std::string index_text(const std::vector<int64_t>& index) {
  return "[" + fmt::format("{}", fmt::join(index, ", ")) + "]";
}

nlohmann::json number_or_null(double value) {
  return std::isfinite(value) ? nlohmann::json(value) : nlohmann::json(nullptr);
}

std::string tensor_line(const TensorComparison& row) {
  const auto verdict = row.passed ? "pass" : "FAIL";
  if (!row.problem.empty()) return fmt::format("  {}  {:<32} {}\n", verdict, row.name, row.problem);
  return fmt::format(
      "  {}  {:<32} count {:>8}  max {:.2e}  mean {:.2e}  tolerance {:.2e}  worst {} {:.7g} ({:.7g})\n",
      verdict, row.name, row.count, row.max_difference, row.mean_difference, row.tolerance,
      index_text(row.worst_index), row.computed_value, row.expected_value);
}

std::string no_memory(const std::filesystem::path& folder) {
  return folder.string() + ": expected enough memory for the case, found too little; free memory.";
}

// Tensors that agree with the configuration never get here; LibTorch's own words, without its backtrace, are
// the best there is.
std::string library_fault(const std::filesystem::path& folder, const c10::Error& error) {
  if (is_out_of_memory(error)) return no_memory(folder);
  std::string words = error.what_without_backtrace();
  words = words.substr(0, words.find('\n'));
  return folder.string() + ": found tensors that do not fit together (" + words +
         "); compare them with case.json.";
}

}  // namespace

TensorComparison compare_tensor(const std::string& name, const torch::Tensor& computed,
                                const torch::Tensor& expected, double relative_tolerance) {
  TensorComparison row;
  row.name = name;
  row.count = expected.numel();
  row.max_difference = kNotANumber;
  row.mean_difference = kNotANumber;
  row.computed_value = kNotANumber;
  row.expected_value = kNotANumber;
  row.tolerance = kNotANumber;
  if (expected.numel() == 0) {
    row.problem = "the reference is empty";
    return row;
  }
  if (!computed.defined()) {
    row.problem = "missing: this kind of case computes no tensor of that name";
    return row;
  }
  if (computed.sizes() != expected.sizes()) {
    row.problem = "shape " + c10::str(computed.sizes()) + " instead of " + c10::str(expected.sizes());
    return row;
  }
  const auto a = computed.detach().to(torch::kCPU, torch::kFloat64).reshape({-1});
  const auto b = expected.detach().to(torch::kCPU, torch::kFloat64).reshape({-1});
  const auto difference = (a - b).abs();
  row.max_difference = difference.max().item<double>();  // NaN where any value is
  row.mean_difference = difference.mean().item<double>();
  row.tolerance = relative_tolerance * std::max(1.0, b.abs().max().item<double>());
  const auto finite = torch::isfinite(a) & torch::isfinite(b);
  const bool all_finite = finite.all().item<bool>();
  const int64_t worst =
      all_finite ? difference.argmax().item<int64_t>() : finite.to(torch::kInt64).argmin().item<int64_t>();
  row.worst_index = index_of(worst, expected);
  row.computed_value = a[worst].item<double>();
  row.expected_value = b[worst].item<double>();
  row.passed = all_finite && row.max_difference <= row.tolerance;
  return row;
}

std::vector<TensorComparison> compare_outputs(const ReferenceCase& reference, const NamedTensors& computed) {
  std::vector<TensorComparison> rows;
  for (const auto& [name, expected] : reference.expected) {
    const auto found = computed.find(name);
    rows.push_back(compare_tensor(name, found == computed.end() ? torch::Tensor() : found->second, expected,
                                  reference.relative_tolerance));
  }
  return rows;
}

bool CaseVerification::passed() const {
  return error.empty() && !tensors.empty() &&
         std::all_of(tensors.begin(), tensors.end(), [](const TensorComparison& row) { return row.passed; });
}

double tolerance_in(ComputePrecision precision, double relative_tolerance) {
  switch (precision) {
    case ComputePrecision::kBFloat16:
      return std::max(relative_tolerance, 0.05);
    case ComputePrecision::kInt8:
      return std::max(relative_tolerance, 0.1);
    default:
      return relative_tolerance;
  }
}

CaseVerification verify_case(const std::filesystem::path& folder, const ReferenceRunners& runners,
                             const CaseCompute& compute) {
  CaseVerification result;
  result.folder = folder;
  torch::NoGradGuard no_grad;
  const auto start = std::chrono::steady_clock::now();
  try {
    auto reference = read_reference_case(folder);
    reference.compute = compute;
    result.folder = reference.folder;
    result.kind = reference.kind;
    const auto runner = runners.find(reference.kind);
    if (runner == runners.end()) {
      std::vector<std::string> kinds;
      for (const auto& item : runners) kinds.push_back(item.first);
      const auto nearest = nearest_name(reference.kind, kinds);
      fail({(reference.folder / "case.json").string() + ": kind",
            fmt::format("one of {}", fmt::join(kinds, ", ")), reference.kind,
            nearest.empty() ? "verify a case of a known kind" : "write " + nearest});
    }
    const NamedTensors computed = runner->second(reference);
    if (*reference.precision_applied) {
      reference.relative_tolerance = tolerance_in(compute.precision, reference.relative_tolerance);
    }
    result.tensors = compare_outputs(reference, computed);
  } catch (const Interrupted&) {
    throw;
  } catch (const Error& error) {
    result.error = error.what();
  } catch (const c10::Error& error) {
    result.error = library_fault(folder, error);
  } catch (const std::bad_alloc&) {
    result.error = no_memory(folder);
  } catch (const std::filesystem::filesystem_error& error) {
    result.error = folder.string() + ": found a folder that cannot be read (" + error.code().message() +
                   "); check its permissions.";
  } catch (const std::exception& error) {
    result.error = folder.string() + ": found a fault that no check names (" + error.what() + ").";
  }
  result.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return result;
}

std::string case_text(const CaseVerification& result) {
  auto text =
      fmt::format("{}  {}  {} ({:.2f} s)\n", result.passed() ? "pass" : "FAIL", result.folder.string(),
                  result.kind.empty() ? "unknown kind" : result.kind, result.seconds);
  for (const auto& row : result.tensors) text += tensor_line(row);
  if (!result.error.empty()) text += "  " + result.error + "\n";
  return text;
}

std::string summary_text(const std::vector<CaseVerification>& cases, const CaseCompute& compute) {
  const auto passed =
      std::count_if(cases.begin(), cases.end(), [](const auto& result) { return result.passed(); });
  const std::string where =
      compute.device.is_cpu() ? "with " + blas_name() + " as BLAS" : "on " + device_name(compute.device);
  return fmt::format("{} of {} cases pass in {}, on LibTorch {} {}\n", passed, cases.size(),
                     compute_precision_name(compute.precision), torch_version(), where);
}

nlohmann::json verification_json(const std::vector<CaseVerification>& cases, const CaseCompute& compute) {
  nlohmann::json result = {{"passed", true},
                           {"libtorch", torch_version()},
                           {"blas", blas_name()},
                           {"device", device_name(compute.device)},
                           {"precision", compute_precision_name(compute.precision)},
                           {"cases", nlohmann::json::array()}};
  for (const auto& item : cases) {
    nlohmann::json tensors = nlohmann::json::array();
    for (const auto& row : item.tensors) {
      nlohmann::json entry = {{"name", row.name},
                              {"passed", row.passed},
                              {"count", row.count},
                              {"max", number_or_null(row.max_difference)},
                              {"mean", number_or_null(row.mean_difference)},
                              {"worst_index", row.worst_index},
                              {"computed", number_or_null(row.computed_value)},
                              {"expected", number_or_null(row.expected_value)},
                              {"tolerance", number_or_null(row.tolerance)}};
      if (!row.problem.empty()) entry["problem"] = row.problem;
      tensors.push_back(std::move(entry));
    }
    nlohmann::json entry = {{"folder", item.folder.string()},
                            {"kind", item.kind},
                            {"passed", item.passed()},
                            {"seconds", item.seconds},
                            {"tensors", std::move(tensors)}};
    if (!item.error.empty()) entry["error"] = item.error;
    if (!item.passed()) result["passed"] = false;
    result["cases"].push_back(std::move(entry));
  }
  return result;
}

}  // namespace gld
