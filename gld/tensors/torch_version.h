#pragma once

#include <cstdint>
#include <string>

#include <c10/core/Allocator.h>
#include <torch/types.h>

// The only place that knows LibTorch versions (1.13 to 2.x).
namespace gld {

// "1.13.0", as the library itself reports it.
std::string torch_version();

// Which BLAS serves matrix products, as far as the library and the dynamic linker tell ("openblas", "mkl",
// "reference", ...).
std::string blas_name();
// For reports, the same with the kernel that OpenBLAS chose, and what in the environment may hold it to a slower one:
// "openblas, kernel Haswell, OPENBLAS_CORETYPE=Haswell in the environment".
std::string blas_text();

// One setting for LibTorch's own loops, OpenMP and BLAS (Debian's LibTorch starts with one thread).
void set_thread_count(int threads);
int thread_count();

// Lets CPU tensors take their memory from block_memory.h, which keeps up to that many freed bytes. Tensors of before
// stay valid.
void keep_freed_tensor_memory(int64_t most_kept_bytes);

// LibTorch's own CPU allocator for new tensors, for as long as it lives: what a plain LibTorch program has.
class LibraryTensorMemory {
 public:
  LibraryTensorMemory();
  ~LibraryTensorMemory();
  LibraryTensorMemory(const LibraryTensorMemory&) = delete;
  LibraryTensorMemory& operator=(const LibraryTensorMemory&) = delete;

 private:
  c10::Allocator* before_;
};

// Whether LibTorch brings a fused attention for that kind of device which beats composing it (2.0 and newer, CUDA).
bool has_library_attention(torch::Device device);
// softmax(query key^T / sqrt(head_dim)) value; (batch, heads, tokens, head_dim) each. Throws Error where
// has_library_attention is false.
torch::Tensor scaled_dot_product_attention(const torch::Tensor& query, const torch::Tensor& key,
                                           const torch::Tensor& value);

// Whether LibTorch has RMS normalisation in one pass for that kind of device (2.9 and newer, CUDA).
bool has_library_rms_norm(torch::Device device);
// x / sqrt(mean(x^2) + epsilon) * weight over the last axis; weight may be undefined. Throws Error where
// has_library_rms_norm is false.
torch::Tensor library_rms_norm(const torch::Tensor& x, const torch::Tensor& weight, double epsilon);

// The product of two bfloat16 matrices in float32: not rounded at all on a GPU from LibTorch 2.9 on, elsewhere to
// bfloat16 once.
torch::Tensor bfloat16_product(const torch::Tensor& a, const torch::Tensor& b);

// Sums of products and convolutions on a GPU are float32 from now on, and float32 operands keep their digits: LibTorch
// would let cuDNN round those of convolutions to 10 bits, and cuBLAS add parts of a bfloat16 product in bfloat16.
void sum_gpu_products_in_float32();

// Bytes of tensors on a GPU at their most since the last reset, as LibTorch's own allocator counts them; 0 on a CPU,
// whose tensors block_memory.h counts, and before LibTorch 2.9, which has no such question that needs no header of
// CUDA.
int64_t most_used_device_bytes(const torch::Device& device);
void reset_most_used_device_bytes(const torch::Device& device);

// True where bfloat16 matrix products are faster than float32 ones and autocast may be used (CUDA).
bool has_bfloat16_autocast(torch::Device device);

// Whether a BFloat16Autocast for that kind of device is alive.
bool bfloat16_autocast_active(torch::DeviceType device);

// Autocast to bfloat16 on a kind of device, for as long as it lives. Nesting is allowed.
class BFloat16Autocast {
 public:
  explicit BFloat16Autocast(torch::DeviceType device);
  ~BFloat16Autocast();
  BFloat16Autocast(const BFloat16Autocast&) = delete;
  BFloat16Autocast& operator=(const BFloat16Autocast&) = delete;

 private:
  torch::DeviceType device_;
  bool enabled_before_;
};

}  // namespace gld
