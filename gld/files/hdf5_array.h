#pragma once

#include "gld/base/mapped_file.h"

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

// Reads a dataset in the root group of a whole HDF5 file that lies in memory. It reads what h5py and libhdf5 write by
// default, which HyperSim's files are: superblock 0 and 1, object headers 1, contiguous, compact or chunked data, the
// filters deflate, shuffle and fletcher32, integers and IEEE floats of either byte order. Everything else is refused by
// name, links, data in other files and unwritten chunks included.
//
// The product only reads HDF5, and links no library for it; tests write what they read with libhdf5. The reader is our
// own because libhdf5 1.10.8 writes and reads outside its memory on damaged files, which no check around a
// call can prevent. A child process for each read would contain the crash, but not what a crafted file makes it run,
// would have to fork a process with LibTorch's threads (a child may then call next to nothing that takes a lock), and
// cost milliseconds per gigabyte of the parent for each of a training's files. This reader keeps no state: any number
// of threads read at the same time. Every position is checked against the file, and memory against most_elements and
// against what the stored bytes can give. Throws Error naming `where`.
// The source is HDF5 File Format Specification, version 2.0 (The HDF Group).
Hdf5Array parse_hdf5_array(ByteView file, const std::string& dataset, int64_t most_elements,
                           const std::string& where);

// Reads the same from a file of at most 2 GiB.
Hdf5Array read_hdf5_array(const std::filesystem::path& file, const std::string& dataset,
                          int64_t most_elements);

}  // namespace gld
