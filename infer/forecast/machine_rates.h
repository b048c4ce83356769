#pragma once

#include "models/cost/cost_model.h"
#include "models/layers/layer_precision.h"

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace gld {

// How fast this machine is: floating-point operations a second, but for loading and the two factors.
struct MachineSpeed {
  double multiply_add_peak = 0;  // independent multiply-adds in registers: what fractions of peak refer to
  double matrix_product = 0;     // large products by BLAS; LibTorch's convolutions are about as fast
  double linear = 0;             // linear layers as sampling computes them (gld/tensors/transposed_product.h)
  double attention = 0;          // softmax attention of the models' head sizes
  double loading = 0;            // bytes a second of float32 weights made from float16 ones in fresh memory
  // Seconds of a model over those of its products and attention alone, 1 or more: what element-wise passes and starting
  // operations add, for a small model (160 and 288 wide, 256 tokens) and for blocks of the published sizes.
  double small_model = 1;
  double large_model = 1;
  // Linear layers and attention are so many times as fast in other precisions as in float32, with the best unit.
  double bfloat16_linear = 1;
  double int8_linear = 1;
  double bfloat16_attention = 1;
  // Seconds of whole stages over what the figures above say of them, as runs in each precision found it.
  double float32_stages = 1;
  double bfloat16_stages = 1;
  double int8_stages = 1;

  double stages_in(ComputePrecision precision) const;
  double linear_in(ComputePrecision precision) const;     // operations a second
  double attention_in(ComputePrecision precision) const;  // of float32 and bfloat16
};

// Speeds with what is known of how sure they are.
struct MeasuredSpeed {
  MachineSpeed speed;
  // How far repeats lay apart: the second largest less the second smallest of five, over their median; of the kind of
  // work where that is most, and its name.
  double spread = 0;
  std::string widest;
  int64_t measured_at = 0;  // seconds since 1970
  // Of the last runs in each precision what their stages took over the forecast without stages_in(), oldest first.
  std::map<ComputePrecision, std::vector<double>> runs;
};

// Measures the median of five repeats of each kind of work, the kinds in turn, so that what else runs on the machine
// meets all alike; of the peak it takes the best. With the present thread setting it takes some ten seconds. It waits
// until the scheduler has spread the threads, so it belongs to gld doctor and never before other work.
MeasuredSpeed measure_machine_speed();
// Returns what contradicts itself in a measurement, a sentence each: work faster than the peak, int8 below half of
// bfloat16, repeats more than 30 % apart. Such rates are of a busy machine.
std::vector<std::string> contradictions(const MeasuredSpeed& measured);
// Makes one short run of each kind, which takes at most about 0.1 s on an idle processor and is never repeated: the
// result may be half of the truth on a busy machine, where threads start on one core.
MachineSpeed estimate_machine_speed();

// Returns what these operations take at these speeds, element-wise work left out.
double computing_seconds(const Cost& cost, const MachineSpeed& speed, const LayerPrecision& precision = {});
// Returns the same with element-wise work: cost is that of `passes` equal passes through a model. The factor lies
// between small_model and large_model, linear in the logarithm of a pass's operations. What it adds is the same in
// every precision.
double model_seconds(const Cost& cost, double passes, const MachineSpeed& speed,
                     const LayerPrecision& precision = {});

// What a measurement holds for.
struct RateKey {
  std::string host;
  std::string processor;
  int64_t threads = 0;
  std::string program;  // "gld 0.1.0"
};
RateKey present_rate_key();  // this machine, build and thread setting

// Returns machine_rates.json in the user's cache folder; empty where there is none (gld/base/user_cache.h).
std::filesystem::path machine_rates_file();

// Returns the rates kept under that key; none where the file is missing, damaged or holds other keys only, or where
// what it holds contradicts itself.
std::optional<MeasuredSpeed> kept_machine_speed(const std::filesystem::path& file, const RateKey& key);
// Adds them to the file in the place of earlier ones of that key. A damaged file is replaced. Throws Error where it
// cannot be written.
void keep_machine_speed(const std::filesystem::path& file, const RateKey& key, const MeasuredSpeed& measured);

// The speeds that a forecast is made with, and a sentence about where they come from, when they were measured and how
// sure they are.
struct KnownSpeed {
  MachineSpeed speed;
  std::string origin;
  std::vector<std::string> doubts;  // contradictions()
  bool kept = false;                // learn_from_run() may mend them
};
// Returns the kept rates, or a quick estimate. It never measures at length and writes nothing.
KnownSpeed known_machine_speed();
// Measures anew and keeps the rates, unless they contradict themselves when measured again; where they are not kept,
// origin says so.
KnownSpeed renew_machine_speed();

// A stage that a run has been through, in seconds.
struct TimedStage {
  ComputePrecision precision = ComputePrecision::kFloat32;
  double forecast = 0;  // by known_machine_speed()
  double took = 0;
};
// Compares a run with its forecast and mends the kept rates: stages_in() of a precision is the median of the forecast
// as it was measured, which is 1, and of the last runs that had half a second or more of it, so that one run on a busy
// machine does not count for all. Keeps nothing where there are no rates.
void learn_from_run(const std::filesystem::path& file, const RateKey& key,
                    const std::vector<TimedStage>& stages);

}  // namespace gld
