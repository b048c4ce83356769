#pragma once

#include "gld/files/weight_file.h"

#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

torch::Dtype torch_dtype(DType dtype,
                         const std::string& where);  // Error for unsigned types wider than 8 bits
DType file_dtype(torch::Dtype dtype, const std::string& where);

// Returns the tensor of that entry, contiguous, on the CPU. It shares the file's memory (and keeps the mapping alive)
// where the data is contiguous and aligned to its element size; writing to it never changes the file. Bools are copied.
torch::Tensor read_tensor(const WeightFile& file, const TensorEntry& entry);
// Throws Error when the file has no tensor of that name.
torch::Tensor read_tensor(const WeightFile& file, const std::string& name);

// Returns every tensor whose name starts with prefix; the prefix is removed from the keys. An empty result is an Error.
std::map<std::string, torch::Tensor> read_all(const WeightFile& file, const std::string& prefix = "");
std::map<std::string, torch::Tensor> read_all(const std::filesystem::path& file,
                                              const std::string& prefix = "");

// Writes a safetensors file under a temporary name and renames it. Tensors are of any device and strides; each starts
// at a multiple of its element size. The same tensors give the same bytes.
void save_safetensors(const std::filesystem::path& file, const std::map<std::string, torch::Tensor>& tensors,
                      const std::map<std::string, std::string>& metadata = {});

// Does the same for tensors that are made one after the other, so that only one is in memory. Of `entries` only names,
// dtypes and shapes are used; `make` is called once for each, in the order of the file, and must return that dtype and
// shape.
void save_safetensors(const std::filesystem::path& file, std::vector<TensorEntry> entries,
                      const std::function<torch::Tensor(const TensorEntry&)>& make,
                      const std::map<std::string, std::string>& metadata = {});

}  // namespace gld
