#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace gld {

// One dataset of an HDF5 file as floats, row by row.
struct Hdf5Array {
  std::vector<int64_t> shape;
  std::vector<float> values;
};

// Any numeric type is converted to float32 (HyperSim stores float16). Throws Error when the file is missing, damaged or
// truncated, has no such dataset, or the dataset is larger than 2^30 elements. Calls are serialised: the usual build of
// the HDF5 library is not safe to use from several threads.
Hdf5Array read_hdf5(const std::filesystem::path& file, const std::string& dataset);

// Writes one float32 dataset; the file appears whole or not at all.
void write_hdf5(const std::filesystem::path& file, const std::string& dataset, const Hdf5Array& array);

}  // namespace gld
