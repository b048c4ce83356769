#pragma once

#include "models/cost/cost_model.h"
#include "models/layers/layer_precision.h"

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>

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
  // How many times as fast as in float32 linear layers and attention are in other precisions, with the best unit.
  double bfloat16_linear = 1;
  double bfloat16x3_linear = 1;
  double int8_linear = 1;
  double bfloat16_attention = 1;

  double linear_in(ComputePrecision precision) const;     // operations a second
  double attention_in(ComputePrecision precision) const;  // of float32 and bfloat16
};

// Runs each kind of work for a while, with the present thread setting: some seconds. It waits until the scheduler has
// spread the threads, so it belongs to gld doctor and never before other work.
MachineSpeed measure_machine_speed();
// One short run of each kind, at most about 0.1 s on an idle processor and never repeated: may be half of the truth on
// a busy machine, where threads start on one core.
MachineSpeed estimate_machine_speed();

// What these operations take at these speeds, element-wise work left out.
double computing_seconds(const Cost& cost, const MachineSpeed& speed, const LayerPrecision& precision = {});
// The same with it: cost is that of `passes` equal passes through a model. The factor lies between small_model and
// large_model, linear in the logarithm of a pass's operations. What it adds is the same in every precision.
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

// machine_rates.json in the user's cache folder; empty where there is none (gld/base/user_cache.h).
std::filesystem::path machine_rates_file();

// The rates kept under that key; none where the file is missing, damaged or holds other keys only.
std::optional<MachineSpeed> kept_machine_speed(const std::filesystem::path& file, const RateKey& key);
// Adds them to the file in the place of earlier ones of that key. A damaged file is replaced. Throws Error where it
// cannot be written.
void keep_machine_speed(const std::filesystem::path& file, const RateKey& key, const MachineSpeed& speed);

// The speeds that a forecast is made with, and a sentence about where they come from.
struct KnownSpeed {
  MachineSpeed speed;
  std::string origin;
};
// The kept rates, or a quick estimate. Never measures at length and writes nothing.
KnownSpeed known_machine_speed();
// Measures anew and keeps the rates; where they cannot be kept, origin says so.
KnownSpeed renew_machine_speed();

}  // namespace gld
