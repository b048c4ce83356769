#pragma once

#include "gld/files/hdf5_array.h"

#include <cstdint>
#include <filesystem>
#include <string>

namespace gld {

// Reads a file with parse_hdf5_array (gld/files/hdf5_array.h), from any number of threads. Throws Error when it is
// missing, damaged or truncated, has no such dataset, or the dataset has more elements than what it is for can have.
Hdf5Array read_hdf5(const std::filesystem::path& file, const std::string& dataset, int64_t most_elements);

// Writes one float32 dataset with libhdf5, one call at a time; the file appears whole or not at all.
void write_hdf5(const std::filesystem::path& file, const std::string& dataset, const Hdf5Array& array);

}  // namespace gld
