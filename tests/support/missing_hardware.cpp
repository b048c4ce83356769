// This prints the labels of tests that this machine cannot run, one a line (scripts/hardware_labels.sh).
#include "gld/machine/instruction_set.h"
#include "gld/machine/matrix_unit.h"

#include <algorithm>
#include <iostream>

#ifdef GLD_WITH_LIBTORCH
#include "gld/tensors/torch_version.h"

#include <torch/cuda.h>
#endif

namespace {

template <class Values, class Value>
bool holds(const Values& values, Value value) {
  return std::find(values.begin(), values.end(), value) != values.end();
}

void say(const char* label, bool available) {
  if (!available) std::cout << label << '\n';
}

}  // namespace

int main() {
  using gld::ComputePrecision, gld::InstructionSet, gld::MatrixUnit;
  const auto sets = gld::available_instruction_sets();
  const auto bfloat16 = gld::available_matrix_units(ComputePrecision::kBFloat16);
  const auto int8 = gld::available_matrix_units(ComputePrecision::kInt8);
  say("avx2", holds(sets, InstructionSet::kAvx2));
  say("avx512", holds(sets, InstructionSet::kAvx512));
  say("avx512_bf16", holds(bfloat16, MatrixUnit::kAvx512));
  say("avx512_vnni", holds(int8, MatrixUnit::kAvx512));
  say("amx_bf16", holds(bfloat16, MatrixUnit::kAmx));
  say("amx_int8", holds(int8, MatrixUnit::kAmx));
#ifdef GLD_WITH_LIBTORCH
  say("gpu", torch::cuda::is_available());
  say("libtorch_1", gld::torch_version()[0] == '1');
  say("libtorch_2", gld::torch_version()[0] != '1');
#endif
}
