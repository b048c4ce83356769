#include "gld/machine/matrix_unit.h"

#if defined(__linux__) && defined(__x86_64__)
#include <cpuid.h>
#include <sys/syscall.h>
#include <unistd.h>
#endif

namespace gld {
namespace {

#ifdef GLD_X86_KERNELS
// Returns whether there is what the compiled kernels use beside the dot products themselves.
bool has_avx512() {
  return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
         __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl");
}

#if defined(__linux__) && defined(__x86_64__)
struct AmxFeatures {
  bool bfloat16 = false;
  bool int8 = false;
};

// Linux hands the tile registers out to a process that asks for them (arch_prctl, from 5.16 on): threads started later
// inherit the leave, and a process that has it may ask again.
AmxFeatures amx_features() {
  constexpr int kRequestPermission = 0x1023;  // ARCH_REQ_XCOMP_PERM
  constexpr int kTileData = 18;               // XFEATURE_XTILEDATA
  AmxFeatures features;
  unsigned int a = 0, b = 0, c = 0, d = 0;
  if (!has_avx512() || __get_cpuid_count(7, 0, &a, &b, &c, &d) == 0) return features;
  const bool bfloat16 = (d >> 22 & 1U) != 0, tiles = (d >> 24 & 1U) != 0, int8 = (d >> 25 & 1U) != 0;
  if (!tiles || ::syscall(SYS_arch_prctl, kRequestPermission, kTileData) != 0) return features;
  features.bfloat16 = bfloat16 && __builtin_cpu_supports("avx512bf16");
  features.int8 = int8;
  return features;
}
#endif
#endif

}  // namespace

const std::vector<std::string>& compute_precision_names() {
  static const std::vector<std::string> names = {"float32", "bfloat16", "int8"};
  return names;
}

const std::string& compute_precision_name(ComputePrecision precision) {
  return compute_precision_names().at(static_cast<std::size_t>(precision));
}

std::vector<MatrixUnit> available_matrix_units(ComputePrecision precision) {
  std::vector<MatrixUnit> units = {MatrixUnit::kPlain};
  if (precision == ComputePrecision::kFloat32) return units;
#ifdef GLD_X86_KERNELS
  const bool int8 = precision == ComputePrecision::kInt8;
  if (has_avx512() && (int8 ? __builtin_cpu_supports("avx512vnni") : __builtin_cpu_supports("avx512bf16"))) {
    units.push_back(MatrixUnit::kAvx512);
  }
#if defined(__linux__) && defined(__x86_64__)
  static const AmxFeatures amx = amx_features();
  if (int8 ? amx.int8 : amx.bfloat16) units.push_back(MatrixUnit::kAmx);
#endif
#endif
  return units;
}

MatrixUnit best_matrix_unit(ComputePrecision precision) { return available_matrix_units(precision).back(); }

bool has_matrix_unit(ComputePrecision precision) {
  return precision == ComputePrecision::kFloat32 || best_matrix_unit(precision) != MatrixUnit::kPlain;
}

std::string matrix_unit_name(MatrixUnit unit) {
  switch (unit) {
    case MatrixUnit::kAmx:
      return "AMX";
    case MatrixUnit::kAvx512:
      return "AVX512";
    default:
      return "plain";
  }
}

std::string matrix_unit_name(MatrixUnit unit, ComputePrecision precision) {
  if (unit == MatrixUnit::kPlain) return "plain";
  const bool int8 = precision == ComputePrecision::kInt8;
  if (unit == MatrixUnit::kAmx) return int8 ? "AMX-INT8" : "AMX-BF16";
  return int8 ? "AVX512-VNNI" : "AVX512-BF16";
}

}  // namespace gld
