#include "gld/tensors/weight_tensors.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/files/safetensors.h"

#include <algorithm>
#include <cstring>
#include <fstream>
#include <memory>

#include <torch/types.h>

namespace gld {
namespace {

const std::vector<std::pair<DType, torch::Dtype>>& dtype_pairs() {
  static const std::vector<std::pair<DType, torch::Dtype>> pairs = {
      {DType::kFloat64, torch::kFloat64}, {DType::kFloat32, torch::kFloat32},
      {DType::kFloat16, torch::kFloat16}, {DType::kBFloat16, torch::kBFloat16},
      {DType::kInt64, torch::kInt64},     {DType::kInt32, torch::kInt32},
      {DType::kInt16, torch::kInt16},     {DType::kInt8, torch::kInt8},
      {DType::kUInt8, torch::kUInt8},     {DType::kBool, torch::kBool}};
  return pairs;
}

bool aligned(const TensorEntry& entry) {
  return reinterpret_cast<uintptr_t>(entry.data) % static_cast<uintptr_t>(byte_size(entry.dtype)) == 0;
}

// Returns a view of the file's memory; `keep_alive` lives as long as the tensor.
torch::Tensor view_of(const TensorEntry& entry, const std::vector<int64_t>& strides, torch::Dtype dtype,
                      const std::shared_ptr<const WeightFile>& keep_alive) {
  // The mapping is private and copy on write (MappedFile), so handing out a mutable pointer is safe.
  auto* data = const_cast<uint8_t*>(entry.data);
  return torch::from_blob(
      data, entry.shape, strides, [keep_alive](void*) {}, torch::TensorOptions().dtype(dtype));
}

// Copies element by element by strides, for data that is not aligned or not contiguous.
torch::Tensor copy_of(const TensorEntry& entry, torch::Dtype dtype) {
  auto copy = torch::empty(entry.shape, torch::TensorOptions().dtype(dtype));
  const int64_t count = entry.element_count(), size = byte_size(entry.dtype);
  auto* target = static_cast<uint8_t*>(copy.data_ptr());
  if (entry.contiguous()) {
    if (count != 0) std::memcpy(target, entry.data, static_cast<size_t>(count * size));
    return copy;
  }
  std::vector<int64_t> index(entry.shape.size(), 0);
  int64_t offset = 0;
  for (int64_t element = 0; element < count; ++element) {
    std::memcpy(target + element * size, entry.data + offset * size, static_cast<size_t>(size));
    for (size_t axis = entry.shape.size(); axis-- > 0;) {
      offset += entry.strides[axis];
      if (++index[axis] < entry.shape[axis]) break;
      offset -= entry.strides[axis] * entry.shape[axis];
      index[axis] = 0;
    }
  }
  return copy;
}

}  // namespace

torch::Dtype torch_dtype(DType dtype, const std::string& where) {
  for (const auto& [on_file, in_memory] : dtype_pairs()) {
    if (on_file == dtype) return in_memory;
  }
  fail({where, "a dtype that LibTorch computes with", dtype_name(dtype), "convert the tensor to int64"});
}

DType file_dtype(torch::Dtype dtype, const std::string& where) {
  for (const auto& [on_file, in_memory] : dtype_pairs()) {
    if (in_memory == dtype) return on_file;
  }
  fail({where, "a floating-point, integer or boolean tensor", c10::str(dtype), "convert the tensor first"});
}

torch::Tensor read_tensor(const WeightFile& file, const TensorEntry& entry) {
  const auto dtype =
      torch_dtype(entry.dtype, file.path().string() + ": tensor " + printable_name(entry.name));
  if (entry.element_count() == 0) return torch::empty(entry.shape, torch::TensorOptions().dtype(dtype));
  if (entry.dtype == DType::kBool) {
    // A bool byte other than 0 and 1 is undefined behaviour in every kernel.
    TensorEntry as_bytes = entry;
    as_bytes.dtype = DType::kUInt8;
    return copy_of(as_bytes, torch::kUInt8).ne(0);
  }
  if (entry.contiguous() && aligned(entry)) {
    return view_of(entry, row_major_strides(entry.shape), dtype, file.shared_from_this());
  }
  return copy_of(entry, dtype);
}

torch::Tensor read_tensor(const WeightFile& file, const std::string& name) {
  return read_tensor(file, file.entry(name));
}

std::map<std::string, torch::Tensor> read_all(const WeightFile& file, const std::string& prefix) {
  std::map<std::string, torch::Tensor> tensors;
  for (const auto& entry : file.entries()) {
    if (entry.name.compare(0, prefix.size(), prefix) != 0) continue;
    tensors.emplace(entry.name.substr(prefix.size()), read_tensor(file, entry));
  }
  if (tensors.empty()) {
    fail({file.path().string(), prefix.empty() ? "tensors" : "tensors whose names start with " + prefix,
          "none", "list the file with gld inspect"});
  }
  return tensors;
}

std::map<std::string, torch::Tensor> read_all(const std::filesystem::path& file, const std::string& prefix) {
  return read_all(*WeightFile::open(file), prefix);
}

void save_safetensors(const std::filesystem::path& file, const std::map<std::string, torch::Tensor>& tensors,
                      const std::map<std::string, std::string>& metadata) {
  std::vector<TensorEntry> entries;
  entries.reserve(tensors.size());
  for (const auto& [name, tensor] : tensors) {
    const std::string where = file.string() + ": tensor " + printable_name(name);
    if (!tensor.defined()) fail({where, "a tensor", "none", "leave the name out"});
    TensorEntry entry;
    entry.name = name;
    entry.dtype = file_dtype(tensor.scalar_type(), where);
    entry.shape = tensor.sizes().vec();
    entries.push_back(std::move(entry));
  }
  save_safetensors(
      file, std::move(entries), [&](const TensorEntry& entry) { return tensors.at(entry.name); }, metadata);
}

void save_safetensors(const std::filesystem::path& file, std::vector<TensorEntry> entries,
                      const std::function<torch::Tensor(const TensorEntry&)>& make,
                      const std::map<std::string, std::string>& metadata) {
  std::sort(entries.begin(), entries.end(), [](const auto& a, const auto& b) { return a.name < b.name; });
  // Wide elements come first: every tensor is then aligned to its element size without holes, which the format forbids.
  std::stable_sort(entries.begin(), entries.end(),
                   [](const auto& a, const auto& b) { return byte_size(a.dtype) > byte_size(b.dtype); });
  AtomicFile target(file);
  std::ofstream stream(target.temporary(), std::ios::binary);
  const std::string header = safetensors_header(entries, metadata);
  stream.write(header.data(), static_cast<std::streamsize>(header.size()));
  for (const auto& entry : entries) {
    const auto tensor = make(entry).detach().to(torch::kCPU).contiguous();
    const std::string where = file.string() + ": tensor " + printable_name(entry.name);
    if (tensor.sizes() != torch::IntArrayRef(entry.shape) ||
        file_dtype(tensor.scalar_type(), where) != entry.dtype) {
      fail({where, dtype_name(entry.dtype) + " of shape " + shape_text(entry.shape),
            dtype_name(file_dtype(tensor.scalar_type(), where)) + " of shape " +
                shape_text(tensor.sizes().vec()),
            "make the tensor that was announced"});
    }
    if (entry.byte_count() == 0) continue;
    stream.write(static_cast<const char*>(tensor.data_ptr()),
                 static_cast<std::streamsize>(entry.byte_count()));
  }
  stream.close();
  if (!stream)
    fail({file.string(), "room for the file", "a write error", "check the free space of the disk"});
  target.commit();
}

}  // namespace gld
