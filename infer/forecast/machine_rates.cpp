#include "infer/forecast/machine_rates.h"

#include "gld/attention/attention.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/user_cache.h"
#include "gld/kernels/multiply_add_peak.h"
#include "gld/machine/block_memory.h"
#include "gld/machine/processor_name.h"
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
#include <ctime>
#include <functional>
#include <utility>

#include <ATen/ops/randn.h>
#include <ATen/ops/zeros.h>

#include <fmt/format.h>
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

// Returns the speed of a linear layer of DA3-Base's feed-forward part, on as many tokens.
double linear_speed(int64_t rows, const Timing& timing) {
  constexpr int64_t kInputs = 768, kOutputs = 3072;
  const auto x = at::randn({rows, kInputs}), weight = at::zeros({kOutputs, kInputs});
  return 2.0 * static_cast<double>(rows * kInputs * kOutputs) / timing([&] { times_transposed(x, weight); });
}

// Returns the same speed of packed layers, as models of that precision compute them, in operations a second.
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

// Precisions without a unit run in portable code, a few times slower than float32: a measurement of them is nothing to
// wait for.
constexpr double kPlainUnit = 0.1;

void measure_precisions(int64_t rows, int64_t tokens, const Timing& timing, MachineSpeed& speed) {
  const auto linear = [&](ComputePrecision precision) {
    return has_matrix_unit(precision) ? packed_speed(rows, precision, timing) / speed.linear : kPlainUnit;
  };
  speed.bfloat16_linear = linear(ComputePrecision::kBFloat16);
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
                              {"int8_linear", &MachineSpeed::int8_linear},
                              {"bfloat16_attention", &MachineSpeed::bfloat16_attention}};

// Rates that contradict themselves below these bounds are noise: what LibTorch's products reach of a peak that was
// measured in the same second, and repeats.
constexpr double kAbovePeak = 1.05, kWidestSpread = 0.3, kLeastInt8 = 0.5;
constexpr size_t kRepeats = 5;
// So many runs of a precision are remembered.
constexpr size_t kRemembered = 8;

// One repeat of all kinds of work.
MachineSpeed one_repeat() {
  const Timing timing = [](const std::function<void()>& action) {
    action();
    return std::min(seconds_of(action), seconds_of(action));
  };
  PeakMeasurement measurement;
  measurement.settings.threads = thread_count();
  MachineSpeed speed;
  speed.multiply_add_peak = measure_multiply_add_peak(measurement);
  speed.matrix_product = measure_sgemm_peak();
  speed.linear = linear_speed(1296, timing);
  speed.attention = attention_speed(1440, ComputePrecision::kFloat32, timing);
  measure_precisions(1296, 1440, timing, speed);
  speed.loading = loading_speed(16'000'000);
  speed.small_model = model_factor(small_model(), kSmallGrid, speed);
  speed.large_model = model_factor(DitOptions(), kLargeGrid, speed);
  return speed;
}

double median_of(std::vector<double> values) { return spread_of(std::move(values)).median; }

constexpr std::pair<ComputePrecision, double MachineSpeed::*> kStages[] = {
    {ComputePrecision::kFloat32, &MachineSpeed::float32_stages},
    {ComputePrecision::kBFloat16, &MachineSpeed::bfloat16_stages},
    {ComputePrecision::kInt8, &MachineSpeed::int8_stages}};

// Sets them from the runs that are remembered.
void set_stages(MeasuredSpeed& measured) {
  for (const auto& [precision, stages] : kStages) {
    auto ratios = measured.runs[precision];
    ratios.push_back(1);
    measured.speed.*stages = median_of(std::move(ratios));
  }
}

std::string time_text(int64_t seconds) {
  const auto time = static_cast<std::time_t>(seconds);
  std::tm parts{};
  std::array<char, 64> text{};
  if (::gmtime_r(&time, &parts) == nullptr) return "an unknown day";
  std::strftime(text.data(), text.size(), "%Y-%m-%d %H:%M UTC", &parts);
  return text.data();
}

// Returns for example "measured on 2026-11-24 03:50 UTC, repeats within 6 %, and mended by 3 runs".
std::string certainty_text(const MeasuredSpeed& measured) {
  size_t runs = 0;
  for (const auto& [precision, ratios] : measured.runs) runs += ratios.size();
  return fmt::format("measured on {}, repeats within {:.0f} %{}", time_text(measured.measured_at),
                     100 * measured.spread,
                     runs == 0 ? "" : fmt::format(", and mended by {} run{}", runs, runs == 1 ? "" : "s"));
}

nlohmann::ordered_json key_json(const RateKey& key) {
  return {
      {"host", key.host}, {"processor", key.processor}, {"threads", key.threads}, {"program", key.program}};
}

// Returns the file's list of measurements, or an empty one where the file is missing or is not what keep_machine_speed
// writes.
nlohmann::ordered_json kept_list(const std::filesystem::path& file) {
  constexpr uint64_t kMostBytes = 1'000'000;
  std::error_code error;
  if (!std::filesystem::is_regular_file(file, error)) return nlohmann::ordered_json::array();
  try {
    auto list = parse_ordered_json(read_file(file, kMostBytes), file.string()).at("rates");
    if (list.is_array()) return list;
  } catch (const std::exception&) {
    // The file is unreadable or no JSON: a cache that counts for nothing.
  }
  return nlohmann::ordered_json::array();
}

bool has_key(const nlohmann::ordered_json& entry, const RateKey& key) {
  return entry.is_object() && entry.contains("of") && entry["of"] == key_json(key);
}

}  // namespace

MeasuredSpeed measure_machine_speed() {
  const torch::NoGradGuard no_gradients;
  std::vector<MachineSpeed> repeats;
  repeats.reserve(kRepeats);
  for (size_t i = 0; i < kRepeats; ++i) repeats.push_back(one_repeat());
  MeasuredSpeed measured;
  measured.measured_at = static_cast<int64_t>(std::time(nullptr));
  for (const auto& [name, value] : kEntries) {
    std::vector<double> values;
    values.reserve(repeats.size());
    for (const auto& repeat : repeats) values.push_back(repeat.*value);
    std::sort(values.begin(), values.end());
    if (value == &MachineSpeed::multiply_add_peak) {
      measured.speed.*value = values.back();
      continue;
    }
    const double median = values[kRepeats / 2], spread = (values[kRepeats - 2] - values[1]) / median;
    measured.speed.*value = median;
    if (spread <= measured.spread) continue;
    measured.spread = spread;
    measured.widest = name;
  }
  return measured;
}

std::vector<std::string> contradictions(const MeasuredSpeed& measured) {
  const MachineSpeed& speed = measured.speed;
  std::vector<std::string> sentences;
  const std::pair<const char*, double> parts[] = {{"BLAS products", speed.matrix_product},
                                                  {"Linear layers", speed.linear},
                                                  {"Attention", speed.attention}};
  for (const auto& [name, rate] : parts) {
    if (rate <= kAbovePeak * speed.multiply_add_peak) continue;
    sentences.push_back(fmt::format("{} reached {:.0f} % of the multiply-add peak, which nothing can.", name,
                                    100 * rate / speed.multiply_add_peak));
  }
  const bool units = speed.int8_linear != kPlainUnit && speed.bfloat16_linear != kPlainUnit;
  if (units && speed.int8_linear < kLeastInt8 * speed.bfloat16_linear) {
    sentences.push_back(fmt::format(
        "Linear layers were {:.2f} times as fast in int8 as in bfloat16, and a processor with both is no slower.",
        speed.int8_linear / speed.bfloat16_linear));
  }
  if (measured.spread > kWidestSpread) {
    sentences.push_back(
        fmt::format("Repeats of {} lay {:.0f} % apart.", measured.widest, 100 * measured.spread));
  }
  return sentences;
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
    case ComputePrecision::kInt8:
      return linear * int8_linear;
    default:
      return linear;
  }
}

double MachineSpeed::attention_in(ComputePrecision precision) const {
  return precision == ComputePrecision::kBFloat16 ? attention * bfloat16_attention : attention;
}

double MachineSpeed::stages_in(ComputePrecision precision) const {
  for (const auto& [known, stages] : kStages) {
    if (known == precision) return this->*stages;
  }
  return float32_stages;
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

std::optional<MeasuredSpeed> kept_machine_speed(const std::filesystem::path& file, const RateKey& key) {
  for (const auto& entry : kept_list(file)) {
    if (!has_key(entry, key)) continue;
    try {
      MeasuredSpeed measured;
      for (const auto& [name, value] : kEntries) {
        const double rate = measured.speed.*value = entry.at(name).get<double>();
        if (!(rate > 0) || !std::isfinite(rate)) return std::nullopt;
      }
      measured.spread = entry.at("spread").get<double>();
      measured.widest = entry.at("widest").get<std::string>();
      measured.measured_at = entry.at("measured_at").get<int64_t>();
      for (const auto& [precision, stages] : kStages) {
        for (const auto& ratio : entry.at("runs").at(compute_precision_name(precision))) {
          measured.runs[precision].push_back(ratio.get<double>());
        }
      }
      set_stages(measured);
      if (!contradictions(measured).empty()) return std::nullopt;
      return measured;
    } catch (const nlohmann::json::exception&) {
      return std::nullopt;  // of a program that kept less, or damaged
    }
  }
  return std::nullopt;
}

void keep_machine_speed(const std::filesystem::path& file, const RateKey& key,
                        const MeasuredSpeed& measured) {
  auto list = nlohmann::ordered_json::array();
  for (auto& entry : kept_list(file)) {
    if (!has_key(entry, key)) list.push_back(std::move(entry));
  }
  nlohmann::ordered_json entry{{"of", key_json(key)},
                               {"measured_at", measured.measured_at},
                               {"spread", measured.spread},
                               {"widest", measured.widest}};
  for (const auto& [name, value] : kEntries) entry[name] = measured.speed.*value;
  for (const auto& [precision, stages] : kStages) {
    const auto found = measured.runs.find(precision);
    entry["runs"][compute_precision_name(precision)] =
        found == measured.runs.end() ? std::vector<double>() : found->second;
  }
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
  KnownSpeed known;
  if (const auto kept = file.empty() ? std::nullopt : kept_machine_speed(file, present_rate_key())) {
    known.speed = kept->speed;
    known.origin = "time by this machine's rates, " + certainty_text(*kept);
    known.kept = true;
    return known;
  }
  known.speed = estimate_machine_speed();
  known.origin =
      "time by a quick estimate of this machine's speed, half to twice the truth; gld doctor --measure measures and "
      "keeps it";
  return known;
}

KnownSpeed renew_machine_speed() {
  MeasuredSpeed measured = measure_machine_speed();
  if (!contradictions(measured).empty()) measured = measure_machine_speed();  // something else may have ended
  KnownSpeed known;
  known.speed = measured.speed;
  known.doubts = contradictions(measured);
  if (!known.doubts.empty()) {
    known.origin =
        "rates measured now and not kept, because they contradict themselves: measure again when nothing else runs";
    return known;
  }
  const auto file = machine_rates_file();
  if (file.empty()) {
    known.origin = "rates measured now and not kept: neither XDG_CACHE_HOME nor HOME names a folder";
    return known;
  }
  try {
    keep_machine_speed(file, present_rate_key(), measured);
    known.origin = fmt::format("rates measured now, repeats within {:.0f} %, and kept in {}",
                               100 * measured.spread, file.string());
    known.kept = true;
  } catch (const Error& error) {
    known.origin = std::string("rates measured now and not kept: ") + error.what();
  }
  return known;
}

void learn_from_run(const std::filesystem::path& file, const RateKey& key,
                    const std::vector<TimedStage>& stages) {
  constexpr double kShortest = 0.5;  // seconds; below, starting operations and the clock count for more
  auto kept = kept_machine_speed(file, key);
  if (!kept) return;
  bool learned = false;
  for (const auto& [precision, factor] : kStages) {
    double forecast = 0, took = 0;
    for (const TimedStage& stage : stages) {
      if (stage.precision != precision) continue;
      forecast += stage.forecast / (kept->speed.*factor);
      took += stage.took;
    }
    if (!(forecast >= kShortest) || !(took > 0)) continue;
    auto& runs = kept->runs[precision];
    runs.push_back(took / forecast);
    if (runs.size() > kRemembered) runs.erase(runs.begin());
    learned = true;
  }
  if (learned) keep_machine_speed(file, key, *kept);
}

}  // namespace gld
