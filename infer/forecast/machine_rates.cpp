#include "infer/forecast/machine_rates.h"

#include "gld/attention/attention.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/user_cache.h"
#include "gld/kernels/multiply_add_peak.h"
#include "gld/machine/block_memory.h"
#include "gld/machine/timing.h"
#include "gld/report/provenance.h"
#include "gld/tensors/packed_layer.h"
#include "gld/tensors/product_peak.h"
#include "gld/tensors/torch_version.h"
#include "gld/tensors/transposed_product.h"
#include "infer/forecast/dit_speed.h"
#include "models/layers/operation_cost.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <functional>
#include <utility>

#include <ATen/ops/randn.h>
#include <ATen/ops/zeros.h>

#include <nlohmann/json.hpp>
#include <unistd.h>

namespace gld {
namespace {

// The factors where they were not measured, from machines that were.
constexpr double kUsualSmallModel = 1.8, kUsualLargeModel = 1.15;

using Timing = std::function<double(const std::function<void()>&)>;

double once_after_another(const std::function<void()>& action) {
  action();
  return seconds_of(action);
}

// A linear layer of DA3-Base's feed-forward part, on as many tokens.
double linear_speed(int64_t rows, const Timing& timing) {
  constexpr int64_t kInputs = 768, kOutputs = 3072;
  const auto x = at::randn({rows, kInputs}), weight = at::zeros({kOutputs, kInputs});
  return 2.0 * static_cast<double>(rows * kInputs * kOutputs) / timing([&] { times_transposed(x, weight); });
}

// The same packed, as models of that precision compute them; operations a second.
double packed_speed(int64_t rows, ComputePrecision precision, const Timing& timing) {
  constexpr int64_t kInputs = 768, kOutputs = 3072;
  const auto x = at::randn({rows, kInputs}), weight = at::randn({kOutputs, kInputs});
  const PackedLayer layer(weight, 1, precision);
  return 2.0 * static_cast<double>(rows * kInputs * kOutputs) / timing([&] { layer.times(x, {}, 0, 1); });
}

double loading_speed(int64_t count) {
  const auto stored = at::zeros({count}, at::kHalf);
  release_kept_blocks();
  return static_cast<double>(count * kFloatBytes) / seconds_of([&] { stored.to(at::kFloat); });
}

// At head size 64: between the 48 and 128 of the published models.
double attention_speed(int64_t tokens, ComputePrecision precision, const Timing& timing) {
  constexpr int64_t kHeads = 4, kHeadDim = 64;
  AttentionInputs inputs;
  inputs.precision = precision;
  inputs.query = at::randn({1, tokens, kHeads, kHeadDim});
  inputs.key = at::randn({1, tokens, kHeads, kHeadDim});
  inputs.value = at::randn({1, tokens, kHeads, kHeadDim});
  return 4.0 * static_cast<double>(tokens * tokens * kHeads * kHeadDim) / timing([&] { attention(inputs); });
}

// The models that the two factors are measured with.
DitOptions small_model() {
  DitOptions options;
  options.in_channels = 256;
  options.hidden_size = {160, 288};
  options.depth = {6, 1};
  options.num_heads = {4, 6};
  return options;
}
const LatentGrid kSmallGrid{4, 8, 8}, kLargeGrid{1, 12, 15};

// Precisions without a unit run in portable code, a few times slower than float32: nothing to wait for a measurement
// of.
constexpr double kPlainUnit = 0.1;

void measure_precisions(int64_t rows, int64_t tokens, const Timing& timing, MachineSpeed& speed) {
  const auto linear = [&](ComputePrecision precision) {
    return has_matrix_unit(precision) ? packed_speed(rows, precision, timing) / speed.linear : kPlainUnit;
  };
  speed.bfloat16_linear = linear(ComputePrecision::kBFloat16);
  speed.bfloat16x3_linear = linear(ComputePrecision::kBFloat16x3);
  speed.int8_linear = linear(ComputePrecision::kInt8);
  speed.bfloat16_attention =
      has_matrix_unit(ComputePrecision::kBFloat16)
          ? attention_speed(tokens, ComputePrecision::kBFloat16, timing) / speed.attention
          : kPlainUnit;
}

double model_factor(const DitOptions& options, const LatentGrid& grid, const MachineSpeed& speed) {
  PlanRequest request;
  request.grid = grid;
  request.flow.guidance.guidance_scale = 1;
  const DitSpeed parts = measure_dit_speed(options, request, speed);
  return std::max(1.0, (parts.condition_encoder + parts.velocity_decoder) /
                           computing_seconds(dit_cost(options, grid), speed));
}

std::string processor_name() {
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line);) {
    const auto colon = line.find(": ");
    if (line.rfind("model name", 0) == 0 && colon != std::string::npos) return line.substr(colon + 2);
  }
  return "unknown";
}

struct Entry {
  const char* name;
  double MachineSpeed::*value;
};
constexpr Entry kEntries[] = {{"multiply_add_peak", &MachineSpeed::multiply_add_peak},
                              {"matrix_product", &MachineSpeed::matrix_product},
                              {"linear", &MachineSpeed::linear},
                              {"attention", &MachineSpeed::attention},
                              {"loading", &MachineSpeed::loading},
                              {"small_model", &MachineSpeed::small_model},
                              {"large_model", &MachineSpeed::large_model},
                              {"bfloat16_linear", &MachineSpeed::bfloat16_linear},
                              {"bfloat16x3_linear", &MachineSpeed::bfloat16x3_linear},
                              {"int8_linear", &MachineSpeed::int8_linear},
                              {"bfloat16_attention", &MachineSpeed::bfloat16_attention}};

nlohmann::ordered_json key_json(const RateKey& key) {
  return {
      {"host", key.host}, {"processor", key.processor}, {"threads", key.threads}, {"program", key.program}};
}

// The file's list of measurements; an empty one where it is missing or is not what keep_machine_speed writes.
nlohmann::ordered_json kept_list(const std::filesystem::path& file) {
  constexpr uint64_t kMostBytes = 1'000'000;
  std::error_code error;
  if (!std::filesystem::is_regular_file(file, error)) return nlohmann::ordered_json::array();
  try {
    auto list = parse_ordered_json(read_file(file, kMostBytes), file.string()).at("rates");
    if (list.is_array()) return list;
  } catch (const std::exception&) {
    // Unreadable or no JSON: a cache that counts for nothing.
  }
  return nlohmann::ordered_json::array();
}

bool has_key(const nlohmann::ordered_json& entry, const RateKey& key) {
  return entry.is_object() && entry.contains("of") && entry["of"] == key_json(key);
}

}  // namespace

MachineSpeed measure_machine_speed() {
  const torch::NoGradGuard no_gradients;
  PeakMeasurement measurement;
  measurement.settings.threads = thread_count();
  MachineSpeed speed;
  speed.multiply_add_peak = measure_multiply_add_peak(measurement);
  speed.matrix_product = measure_sgemm_peak();
  speed.linear = linear_speed(1296, fastest_seconds_of);
  speed.attention = attention_speed(1440, ComputePrecision::kFloat32, fastest_seconds_of);
  measure_precisions(1296, 1440, fastest_seconds_of, speed);
  speed.loading = loading_speed(16'000'000);
  speed.small_model = model_factor(small_model(), kSmallGrid, speed);
  speed.large_model = model_factor(DitOptions(), kLargeGrid, speed);
  return speed;
}

MachineSpeed estimate_machine_speed() {
  const torch::NoGradGuard no_gradients;
  MachineSpeed speed;
  speed.linear = linear_speed(256, once_after_another);
  speed.attention = attention_speed(512, ComputePrecision::kFloat32, once_after_another);
  measure_precisions(256, 512, once_after_another, speed);
  speed.loading = loading_speed(1'000'000);
  // Usual proportions; forecasts hardly depend on them.
  speed.matrix_product = speed.linear;
  speed.multiply_add_peak = speed.linear / 0.8;
  speed.small_model = kUsualSmallModel;
  speed.large_model = kUsualLargeModel;
  return speed;
}

double MachineSpeed::linear_in(ComputePrecision precision) const {
  switch (precision) {
    case ComputePrecision::kBFloat16:
      return linear * bfloat16_linear;
    case ComputePrecision::kBFloat16x3:
      return linear * bfloat16x3_linear;
    case ComputePrecision::kInt8:
      return linear * int8_linear;
    default:
      return linear;
  }
}

double MachineSpeed::attention_in(ComputePrecision precision) const {
  return precision == ComputePrecision::kBFloat16 ? attention * bfloat16_attention : attention;
}

double computing_seconds(const Cost& cost, const MachineSpeed& speed, const LayerPrecision& precision) {
  return cost.linear_flop / speed.linear_in(precision.linear) + cost.convolution_flop / speed.matrix_product +
         cost.attention_flop / speed.attention_in(precision.attention);
}

double model_seconds(const Cost& cost, double passes, const MachineSpeed& speed,
                     const LayerPrecision& precision) {
  if (cost.flop() <= 0) return 0;
  const double small = dit_cost(small_model(), kSmallGrid).flop();
  const double large = 10 * small;  // from there on products decide
  const double along = std::log(cost.flop() / passes / small) / std::log(large / small);
  const double factor =
      speed.small_model + std::clamp(along, 0.0, 1.0) * (speed.large_model - speed.small_model);
  return (factor - 1) * computing_seconds(cost, speed) + computing_seconds(cost, speed, precision);
}

RateKey present_rate_key() {
  std::array<char, 256> host{};
  if (::gethostname(host.data(), host.size() - 1) != 0) host.front() = '\0';
  return {host.data(), processor_name(), thread_count(), program_version()};
}

std::filesystem::path machine_rates_file() {
  const auto folder = user_cache_folder();
  return folder.empty() ? folder : folder / "machine_rates.json";
}

std::optional<MachineSpeed> kept_machine_speed(const std::filesystem::path& file, const RateKey& key) {
  for (const auto& entry : kept_list(file)) {
    if (!has_key(entry, key)) continue;
    MachineSpeed speed;
    for (const auto& [name, value] : kEntries) {
      const auto found = entry.find(name);
      if (found == entry.end() || !found->is_number()) return std::nullopt;
      speed.*value = found->get<double>();
      if (!(speed.*value > 0) || !std::isfinite(speed.*value)) return std::nullopt;
    }
    return speed;
  }
  return std::nullopt;
}

void keep_machine_speed(const std::filesystem::path& file, const RateKey& key, const MachineSpeed& speed) {
  auto list = nlohmann::ordered_json::array();
  for (auto& entry : kept_list(file)) {
    if (!has_key(entry, key)) list.push_back(std::move(entry));
  }
  nlohmann::ordered_json entry{{"of", key_json(key)}};
  for (const auto& [name, value] : kEntries) entry[name] = speed.*value;
  list.push_back(std::move(entry));
  std::error_code error;
  std::filesystem::create_directories(file.parent_path(), error);
  if (error) {
    fail({file.parent_path().string(), "to create the folder", "an error: " + error.message(),
          "check its permissions"});
  }
  write_file_atomically(file, json_text(nlohmann::ordered_json{{"rates", list}}, 1) + "\n");
}

KnownSpeed known_machine_speed() {
  const auto file = machine_rates_file();
  if (!file.empty()) {
    if (const auto kept = kept_machine_speed(file, present_rate_key())) {
      return {*kept, "time by this machine's rates that gld doctor measured"};
    }
  }
  return {estimate_machine_speed(),
          "time by a quick estimate of this machine's speed; gld doctor --measure measures and keeps it"};
}

KnownSpeed renew_machine_speed() {
  KnownSpeed known{measure_machine_speed(), ""};
  const auto file = machine_rates_file();
  if (file.empty()) {
    known.origin = "rates measured now and not kept: neither XDG_CACHE_HOME nor HOME names a folder";
    return known;
  }
  try {
    keep_machine_speed(file, present_rate_key(), known.speed);
    known.origin = "rates measured now and kept in " + file.string();
  } catch (const Error& error) {
    known.origin = std::string("rates measured now and not kept: ") + error.what();
  }
  return known;
}

}  // namespace gld
