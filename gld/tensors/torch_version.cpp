#include "gld/tensors/torch_version.h"

#include "gld/base/error.h"
#include "gld/machine/block_memory.h"

#include <cstdlib>
#include <filesystem>
#include <optional>
#include <system_error>

#include <ATen/Context.h>
#include <ATen/Parallel.h>
#include <ATen/Version.h>
#include <ATen/autocast_mode.h>
#include <c10/core/CPUAllocator.h>
#include <torch/version.h>
#if TORCH_VERSION_MAJOR > 2 || (TORCH_VERSION_MAJOR == 2 && TORCH_VERSION_MINOR >= 9)
#define GLD_LIBTORCH_2_9
#include <ATen/ops/mm.h>
#include <ATen/ops/rms_norm.h>
#include <c10/core/CachingDeviceAllocator.h>
#endif

#include <dlfcn.h>

namespace gld {
namespace {

// Since 2.4 autocast takes the kind of device; before, each kind had functions of its own.
#if TORCH_VERSION_MAJOR > 2 || (TORCH_VERSION_MAJOR == 2 && TORCH_VERSION_MINOR >= 4)
bool autocast_enabled(torch::DeviceType device) { return at::autocast::is_autocast_enabled(device); }
void enable_autocast(torch::DeviceType device, bool enabled) {
  at::autocast::set_autocast_enabled(device, enabled);
  at::autocast::set_autocast_dtype(device, torch::kBFloat16);
}
#else
bool autocast_enabled(torch::DeviceType device) {
  return device == torch::kCPU ? at::autocast::is_cpu_enabled() : at::autocast::is_enabled();
}
void enable_autocast(torch::DeviceType device, bool enabled) {
  if (device == torch::kCPU) {
    at::autocast::set_cpu_enabled(enabled);
    at::autocast::set_autocast_cpu_dtype(torch::kBFloat16);
  } else {
    at::autocast::set_enabled(enabled);
    at::autocast::set_autocast_gpu_dtype(torch::kBFloat16);
  }
}
#endif

// 2.3 lets an allocator change and asks it to copy.
#if TORCH_VERSION_MAJOR > 2 || (TORCH_VERSION_MAJOR == 2 && TORCH_VERSION_MINOR >= 3)
#define GLD_ALLOCATE_CONST
#else
#define GLD_ALLOCATE_CONST const
#endif

// Above that of LibTorch's own.
constexpr uint8_t kAllocatorPriority = 1;

class BlockAllocator final : public c10::Allocator {
 public:
  c10::DataPtr allocate(size_t bytes) GLD_ALLOCATE_CONST override {
    void* data = bytes == 0 ? nullptr : take_block(bytes);
    return {data, data, &give_block, c10::Device(c10::DeviceType::CPU)};
  }
  c10::DeleterFnPtr raw_deleter() const override { return &give_block; }
#if TORCH_VERSION_MAJOR > 2 || (TORCH_VERSION_MAJOR == 2 && TORCH_VERSION_MINOR >= 3)
  void copy_data(void* destination, const void* source, size_t bytes) const override {
    default_copy_data(destination, source, bytes);
  }
#endif
};

}  // namespace

std::string torch_version() {
  return std::to_string(TORCH_VERSION_MAJOR) + "." + std::to_string(TORCH_VERSION_MINOR) + "." +
         std::to_string(TORCH_VERSION_PATCH);
}

std::string blas_name() {
  // PyTorch's packages hold MKL inside LibTorch, and another BLAS may be in the process for other libraries.
  if (at::show_config().find("BLAS_INFO=mkl") != std::string::npos) return "mkl";
  // What LibTorch calls is the first library of the process that has such a function, whichever others are there.
  Dl_info found = {};
  void* product = dlsym(RTLD_DEFAULT, "sgemm_");
  if (product == nullptr || dladdr(product, &found) == 0 || found.dli_fname == nullptr) return "unknown";
  // libblas.so.3 is whatever Debian's alternatives point at.
  std::error_code unresolved;
  const std::string path = std::filesystem::canonical(found.dli_fname, unresolved).string();
  if (unresolved) return "unknown";
  for (const char* name : {"openblas", "blis", "mkl", "atlas", "f77blas"}) {
    if (path.find(name) != std::string::npos) return std::string(name) == "f77blas" ? "atlas" : name;
  }
  return path.find("/blas/") != std::string::npos ? "reference" : "unknown";
}

std::string blas_text() {
  std::string text = blas_name();
  using CoreName = const char* (*)();
  const auto core_name = reinterpret_cast<CoreName>(dlsym(RTLD_DEFAULT, "openblas_get_corename"));
  if (text != "openblas" || core_name == nullptr) return text;
  text += std::string(", kernel ") + core_name();
  // OpenBLAS reads them, not this program.
  for (const char* name : {"OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE"}) {
    if (const char* value = std::getenv(name)) {
      text += std::string(", ") + name + "=" + value + " in the environment";
    }
  }
  return text;
}

void set_thread_count(int threads) {
  at::set_num_threads(threads);
  // at::set_num_threads sets OpenMP and MKL; a BLAS with a pool of its own (OpenBLAS with pthreads) has to be told.
  using SetThreads = void (*)(int);
  for (const char* symbol : {"openblas_set_num_threads", "bli_thread_set_num_threads"}) {
    if (auto set = reinterpret_cast<SetThreads>(dlsym(RTLD_DEFAULT, symbol))) set(threads);
  }
}

int thread_count() { return at::get_num_threads(); }

#if TORCH_VERSION_MAJOR >= 2

void sum_gpu_products_in_float32() {
  at::globalContext().setAllowTF32CuDNN(false);
  at::globalContext().setAllowBF16ReductionCuBLAS(false);
}

bool has_library_attention(torch::Device device) { return device.is_cuda(); }

torch::Tensor scaled_dot_product_attention(const torch::Tensor& query, const torch::Tensor& key,
                                           const torch::Tensor& value) {
  return at::scaled_dot_product_attention(query, key, value);
}

#else

void sum_gpu_products_in_float32() { at::globalContext().setAllowTF32CuDNN(false); }

bool has_library_attention(torch::Device /*device*/) { return false; }

torch::Tensor scaled_dot_product_attention(const torch::Tensor& /*query*/, const torch::Tensor& /*key*/,
                                           const torch::Tensor& /*value*/) {
  fail(
      {"scaled_dot_product_attention", "LibTorch 2.0 or newer", torch_version(), "call attention() instead"});
}

#endif

#ifdef GLD_LIBTORCH_2_9

bool has_library_rms_norm(torch::Device device) { return device.is_cuda(); }

torch::Tensor library_rms_norm(const torch::Tensor& x, const torch::Tensor& weight, double epsilon) {
  return at::rms_norm(x, {x.size(-1)}, weight.defined() ? std::optional<at::Tensor>(weight) : std::nullopt,
                      epsilon);
}

torch::Tensor bfloat16_product(const torch::Tensor& a, const torch::Tensor& b) {
  return a.is_cuda() ? at::mm(a, b, torch::kFloat32) : at::mm(a, b).to(torch::kFloat32);
}

int64_t most_used_device_bytes(const torch::Device& device) {
  if (!device.is_cuda()) return 0;
  const auto stats = c10::getDeviceAllocator(device.type())->getDeviceStats(device.index());
  return stats.allocated_bytes[static_cast<size_t>(c10::CachingAllocator::StatType::AGGREGATE)].peak;
}

void reset_most_used_device_bytes(const torch::Device& device) {
  if (device.is_cuda()) c10::getDeviceAllocator(device.type())->resetPeakStats(device.index());
}

#else

bool has_library_rms_norm(torch::Device /*device*/) { return false; }

torch::Tensor library_rms_norm(const torch::Tensor& /*x*/, const torch::Tensor& /*weight*/,
                               double /*epsilon*/) {
  fail({"library_rms_norm", "LibTorch 2.9 or newer", torch_version(), "call rms_norm() instead"});
}

torch::Tensor bfloat16_product(const torch::Tensor& a, const torch::Tensor& b) {
  return at::mm(a, b).to(torch::kFloat32);
}

int64_t most_used_device_bytes(const torch::Device& /*device*/) { return 0; }
void reset_most_used_device_bytes(const torch::Device& /*device*/) {}

#endif

bool has_bfloat16_autocast(torch::Device device) { return device.is_cuda(); }

// LibTorch 2.4 and newer refuse the question for devices without autocast, meta among them.
bool bfloat16_autocast_active(torch::DeviceType device) {
  return (device == torch::kCPU || device == torch::kCUDA) && autocast_enabled(device);
}

BFloat16Autocast::BFloat16Autocast(torch::DeviceType device)
    : device_(device), enabled_before_(autocast_enabled(device)) {
  enable_autocast(device_, true);
  at::autocast::increment_nesting();
}

BFloat16Autocast::~BFloat16Autocast() {
  // The outermost scope drops the cached casts of the parameters, which the optimiser is about to change.
  if (at::autocast::decrement_nesting() == 0) at::autocast::clear_cache();
  enable_autocast(device_, enabled_before_);
}

void keep_freed_tensor_memory(int64_t most_kept_bytes) {
  set_most_kept_bytes(most_kept_bytes);
  static auto* allocator = new BlockAllocator;  // never destroyed: tensors outlive main
  c10::SetCPUAllocator(allocator, kAllocatorPriority);
}

LibraryTensorMemory::LibraryTensorMemory() : before_(c10::GetCPUAllocator()) {
  c10::SetCPUAllocator(c10::GetDefaultCPUAllocator(), kAllocatorPriority);
}

LibraryTensorMemory::~LibraryTensorMemory() { c10::SetCPUAllocator(before_, kAllocatorPriority); }

}  // namespace gld
