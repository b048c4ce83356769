#include "infer/method/plan_errors.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <unsupported/Eigen/SpecialFunctions>

namespace gld {
namespace {

constexpr const char* kFormat = "gld plan errors 1";

double number_of(const nlohmann::json& object, const char* key) {
  const double value = object.at(key).get<double>();
  if (!std::isfinite(value) || value < 0) throw std::invalid_argument(std::string(key) + " below 0");
  return value;
}

PlanErrors from_json(const nlohmann::json& document, const std::string& where) {
  PlanErrors errors;
  if (document.at("format") != kFormat) throw std::invalid_argument("another format");
  errors.model_hash = document.at("model_hash").get<std::string>();
  errors.scenes = document.at("scenes").get<int64_t>();
  errors.guidance_scale = number_of(document, "guidance_scale");
  const auto& grid = document.at("grid");
  errors.grid = {grid.at("views").get<int64_t>(), grid.at("height").get<int64_t>(),
                 grid.at("width").get<int64_t>()};
  for (const auto& entry : document.at("methods")) {
    MethodErrors method;
    load_json(method.method, entry.at("method"), where);
    method.mean = number_of(entry, "mean_error");
    method.largest = number_of(entry, "largest_error");
    method.bound = number_of(entry, "error_bound");
    if (entry.contains("seconds")) method.seconds = number_of(entry, "seconds");
    // Tables from before there were precisions are of float32.
    if (entry.contains("precision_error")) method.of_precision = number_of(entry, "precision_error");
    errors.methods.push_back(std::move(method));
  }
  return errors;
}

// Returns the t that Student's distribution exceeds with this probability (below 1/2).
double student_quantile(double degrees_of_freedom, double probability) {
  const auto exceeded = [&](double t) {
    return 0.5 * Eigen::numext::betainc(0.5 * degrees_of_freedom, 0.5,
                                        degrees_of_freedom / (degrees_of_freedom + t * t));
  };
  double low = 0, high = 1;
  while (exceeded(high) > probability) high *= 2;
  constexpr int kHalvings = 60;
  for (int i = 0; i < kHalvings; ++i) {
    const double middle = 0.5 * (low + high);
    (exceeded(middle) > probability ? low : high) = middle;
  }
  return high;
}

}  // namespace

double largest_automatic_error(ComputePrecision precision) {
  switch (precision) {
    case ComputePrecision::kFloat32:
      return 0;
    case ComputePrecision::kInt8:
      return 0.04;
    default:
      return 0.02;
  }
}

bool errors_hold_on(const std::string& device, ComputePrecision precision) {
  return device == "cpu" || precision == ComputePrecision::kFloat32;
}

double error_bound(const std::vector<double>& errors) {
  constexpr double kSafety = 1.25, kExceeded = 1e-3;
  constexpr double kExpectedDeviation = 0.4, kExpectedDegrees = 8;
  const auto count = static_cast<double>(errors.size());
  const double largest = *std::max_element(errors.begin(), errors.end());
  if (largest == 0) return 0;
  // A scene where a method happens to be exact says nothing about the spread of the others.
  const auto log_of = [&](double error) { return std::log(std::max(error, 1e-3 * largest)); };
  double mean = 0, squares = 0;
  for (const double error : errors) mean += log_of(error) / count;
  for (const double error : errors) squares += (log_of(error) - mean) * (log_of(error) - mean);
  const double degrees = kExpectedDegrees + count - 1;
  const double deviation =
      std::sqrt((kExpectedDegrees * kExpectedDeviation * kExpectedDeviation + squares) / degrees);
  const double predicted = mean + student_quantile(degrees, kExceeded) * std::sqrt(1 + 1 / count) * deviation;
  return std::max(kSafety * largest, std::exp(predicted));
}

nlohmann::ordered_json plan_errors_json(const PlanErrors& errors) {
  auto methods = nlohmann::ordered_json::array();
  for (const auto& entry : errors.methods) {
    methods.push_back({{"method", to_json(entry.method)},
                       {"mean_error", entry.mean},
                       {"largest_error", entry.largest},
                       {"error_bound", entry.bound},
                       {"precision_error", entry.of_precision},
                       {"seconds", entry.seconds}});
  }
  return {
      {"format", kFormat},
      {"model_hash", errors.model_hash},
      {"scenes", errors.scenes},
      {"guidance_scale", errors.guidance_scale},
      {"grid", {{"views", errors.grid.views}, {"height", errors.grid.height}, {"width", errors.grid.width}}},
      {"methods", methods}};
}

PlanErrors read_plan_errors(const std::filesystem::path& file) {
  constexpr uint64_t kLimit = uint64_t{1} << 24;
  const std::string remedy =
      "measure it again: gld bench sample --model BUNDLE --synthetic 16 --write-table --out RUN";
  if (!std::filesystem::is_regular_file(file)) {
    fail({file.string(), "the measured errors of sampling with this model", "no such file", remedy});
  }
  const std::string text = read_file(file, kLimit);
  nlohmann::json document;
  try {
    document = parse_json(text, file.string());
  } catch (const Error& problem) {
    fail({problem.parts().where, "a table of gld bench sample", problem.parts().found, remedy});
  }
  try {
    return from_json(document, file.string());
  } catch (const nlohmann::json::exception&) {
    fail({file.string(), "a table of gld bench sample",
          "a key that is missing or has a value of another kind", remedy});
  } catch (const std::invalid_argument& problem) {
    fail({file.string(), "a table of gld bench sample", problem.what(), remedy});
  }
}

size_t cheapest_within(const PlanErrors& errors, double tolerance, const std::vector<double>& cost) {
  size_t best = errors.methods.size(), most_exact = 0;
  for (size_t i = 0; i < errors.methods.size(); ++i) {
    if (errors.methods[i].bound < errors.methods[most_exact].bound) most_exact = i;
    if (errors.methods[i].bound > tolerance) continue;
    if (best == errors.methods.size() || cost[i] < cost[best]) best = i;
  }
  if (best < errors.methods.size()) return best;
  if (errors.methods.empty())
    fail({"--tolerance", "a measured method", "an empty table", "measure it again"});
  const auto& closest = errors.methods[most_exact];
  fail({"--tolerance",
        fmt::format("at least {:.2g}, the bound of the most exact method that was measured ({})",
                    closest.bound, closest.method.name),
        fmt::format("{:g}", tolerance), "raise it, or choose --solver and --evaluations yourself"});
}

std::optional<MethodErrors> errors_of(const PlanErrors& errors, const SamplingMethod& method) {
  for (const auto& entry : errors.methods) {
    if (same_method(entry.method, method)) return entry;
  }
  return std::nullopt;
}

}  // namespace gld
