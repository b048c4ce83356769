#pragma once

#include "gld/base/mapped_file.h"
#include "gld/files/dtype.h"

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

namespace gld {

// One NumPy array in memory: row-major, little-endian, whatever order and byte order the file had.
struct NpyArray {
  DType dtype = DType::kFloat32;
  std::vector<int64_t> shape;  // empty for a scalar
  std::vector<uint8_t> bytes;

  int64_t element_count() const;
  // Returns all elements, converted; 64-bit integers beyond 2^53 are rounded by to_doubles and refused by nobody.
  std::vector<double> to_doubles() const;
  std::vector<float> to_floats() const;
};

NpyArray npy_from_floats(const std::vector<int64_t>& shape, const float* values);
NpyArray npy_from_doubles(const std::vector<int64_t>& shape, const double* values);

// Reads .npy, versions 1 to 3, in both orders, with the dtypes of DType except bfloat16. Objects, strings, records and
// complex numbers are refused. Throws Error naming `where` or the file.
NpyArray parse_npy(ByteView file, const std::string& where);
// most_bytes is what the caller's array can take at most: a larger one is refused before memory is taken for it.
NpyArray read_npy(const std::filesystem::path& file, uint64_t most_bytes = uint64_t{1} << 36);
std::string npy_text(const NpyArray& array);                               // the bytes of a version 1 file
void write_npy(const std::filesystem::path& file, const NpyArray& array);  // atomic

class ZipArchive;

// An .npz file; arrays are read when asked for.
class NpzFile {
 public:
  static NpzFile open(const std::filesystem::path& file);
  const std::vector<std::string>& names() const { return names_; }  // without ".npy", sorted
  bool has(const std::string& name) const;
  // Throws Error naming the file, the array and the arrays that exist. most_bytes is as for read_npy: a few kilobytes
  // of a file can hold gigabytes of zeros.
  NpyArray read(const std::string& name, uint64_t most_bytes = uint64_t{1} << 36) const;

 private:
  NpzFile() = default;
  std::filesystem::path path_;
  std::shared_ptr<const ZipArchive> archive_;
  std::vector<std::string> names_;
};

// The arrays are stored, not compressed; the file is written atomically.
void write_npz(const std::filesystem::path& file, const std::map<std::string, NpyArray>& arrays);

}  // namespace gld
