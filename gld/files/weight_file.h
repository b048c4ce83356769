#pragma once

#include "gld/base/mapped_file.h"
#include "gld/files/dtype.h"

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <variant>
#include <vector>

namespace gld {

// One tensor of a weight file, seen in the file's memory.
struct TensorEntry {
  std::string name;
  DType dtype = DType::kFloat32;
  std::vector<int64_t> shape;
  std::vector<int64_t> strides;   // in elements; row-major except for views in PyTorch files
  const uint8_t* data = nullptr;  // first element; valid as long as its WeightFile

  int64_t element_count() const;
  int64_t byte_count() const;  // of a contiguous copy
  bool contiguous() const;
};

using ScalarEntry = std::variant<bool, int64_t, double, std::string>;

// A file of named tensors: safetensors, or PyTorch's .pt/.pth in the zip or the older layout. Nested
// dictionaries and lists of a PyTorch file are flattened with '.', so {"ema": {"w": ...}} holds "ema.w". The
// file is memory-mapped; no tensor is copied here. Everything is checked against the file's size when it is
// opened.
class WeightFile : public std::enable_shared_from_this<WeightFile> {
 public:
  // Recognises the format by content. Throws Error with the file and the offending tensor or key.
  static std::shared_ptr<const WeightFile> open(const std::filesystem::path& file);

  const std::filesystem::path& path() const { return path_; }
  const std::string& format() const { return format_; }  // "safetensors", "PyTorch zip" or "PyTorch legacy"
  const std::vector<TensorEntry>& entries() const { return entries_; }  // sorted by name
  const TensorEntry* find(const std::string& name) const;               // null when absent
  // Throws Error naming the tensor and, where there is one, a similar name.
  const TensorEntry& entry(const std::string& name) const;
  // Gives the memory of that tensor's pages back to the system, after it was copied, so that a file is not held twice.
  // They are read again when they are touched; what was written to a tensor that shares them is lost.
  void drop_pages(const TensorEntry& entry) const;
  // Returns the numbers and strings beside the tensors (PyTorch files), and the "__metadata__" of safetensors files.
  const std::map<std::string, ScalarEntry>& scalars() const { return scalars_; }
  const std::map<std::string, std::string>& metadata() const { return metadata_; }

 private:
  WeightFile() = default;
  std::filesystem::path path_;
  std::string format_;
  std::vector<TensorEntry> entries_;
  std::map<std::string, ScalarEntry> scalars_;
  std::map<std::string, std::string> metadata_;
  std::shared_ptr<const MappedFile> mapping_;
  std::vector<std::shared_ptr<const void>> owners_;  // storages that had to be decompressed
};

// Returns the product of the sizes times the element size, and -1 when it does not fit 63 bits or a size is negative.
int64_t checked_byte_count(const std::vector<int64_t>& shape, DType dtype);
std::vector<int64_t> row_major_strides(const std::vector<int64_t>& shape);
std::string shape_text(const std::vector<int64_t>& shape);  // "(2, 3)"
// Returns a name from a file as it may appear in a message: control characters replaced, cut after 120 bytes.
std::string printable_name(const std::string& name);

// What a format's parser returns; used by WeightFile and the fuzzers.
struct ParsedWeights {
  std::vector<TensorEntry> entries;
  std::map<std::string, ScalarEntry> scalars;
  std::map<std::string, std::string> metadata;
  std::vector<std::shared_ptr<const void>> owners;
};

}  // namespace gld
