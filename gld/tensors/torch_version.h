#pragma once

#include <cstdint>
#include <string>

#include <c10/core/Allocator.h>
#include <torch/types.h>

// The only place that knows LibTorch versions (1.13 to 2.x).
namespace gld {

// Returns "1.13.0", for example, as the library itself reports it.
std::string torch_version();

// Returns which BLAS serves matrix products, as far as the library and the dynamic linker tell ("openblas", "mkl",
// "reference", ...).
std::string blas_name();
// Returns, for reports, the same with the kernel that OpenBLAS chose, and what in the environment may hold it to a
// slower one: "openblas, kernel Haswell, OPENBLAS_CORETYPE=Haswell in the environment".
std::string blas_text();

// One setting for LibTorch's own loops, OpenMP and BLAS (Debian's LibTorch starts with one thread).
void set_thread_count(int threads);
int thread_count();

// Lets CPU tensors take their memory from block_memory.h, which keeps up to that many freed bytes. Tensors of before
// stay valid.
void keep_freed_tensor_memory(int64_t most_kept_bytes);

// This takes LibTorch's own CPU allocator for new tensors, for as long as it lives: that is what a plain LibTorch
// program has.
class LibraryTensorMemory {
 public:
  LibraryTensorMemory();
  ~LibraryTensorMemory();
  LibraryTensorMemory(const LibraryTensorMemory&) = delete;
  LibraryTensorMemory& operator=(const LibraryTensorMemory&) = delete;

 private:
  c10::Allocator* before_;
};

// Returns whether LibTorch brings a fused attention for that kind of device which beats composing it (2.0 and newer,
// CUDA).
bool has_library_attention(torch::Device device);
// Returns softmax(query key^T / sqrt(head_dim)) value; each is (batch, heads, tokens, head_dim). Throws Error where
// has_library_attention is false.
torch::Tensor scaled_dot_product_attention(const torch::Tensor& query, const torch::Tensor& key,
                                           const torch::Tensor& value);

// Returns whether LibTorch has RMS normalisation in one pass for that kind of device (2.9 and newer, CUDA).
bool has_library_rms_norm(torch::Device device);
// Returns x / sqrt(mean(x^2) + epsilon) * weight over the last axis; weight may be undefined. Throws Error where
// has_library_rms_norm is false.
torch::Tensor library_rms_norm(const torch::Tensor& x, const torch::Tensor& weight, double epsilon);

// Returns the product of two bfloat16 matrices in float32: it is not rounded at all on a GPU from LibTorch 2.9 on,
// elsewhere to bfloat16 once.
torch::Tensor bfloat16_product(const torch::Tensor& a, const torch::Tensor& b);

// Sums of products and convolutions on a GPU are float32 from now on, and float32 operands keep their digits: LibTorch
// would let cuDNN round those of convolutions to 10 bits, and cuBLAS add parts of a bfloat16 product in bfloat16.
void sum_gpu_products_in_float32();

// Returns the bytes of tensors on a GPU at their most since the last reset, as LibTorch's own allocator counts them; it
// is 0 on a CPU, whose tensors block_memory.h counts, and before LibTorch 2.9, which has no such question that needs no
// header of CUDA.
int64_t most_used_device_bytes(const torch::Device& device);
void reset_most_used_device_bytes(const torch::Device& device);

// Returns true where bfloat16 matrix products are faster than float32 ones and autocast may be used (CUDA).
bool has_bfloat16_autocast(torch::Device device);

// Returns whether a BFloat16Autocast for that kind of device is alive.
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
