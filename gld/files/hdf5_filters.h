#pragma once

#include "gld/base/mapped_file.h"

#include <cstdint>
#include <vector>

namespace gld {

// What the chunks of an HDF5 dataset went through before they were written, by the numbers of the format.
enum class Hdf5Filter : uint16_t { kDeflate = 1, kShuffle = 2, kFletcher32 = 3 };

bool is_known_hdf5_filter(uint16_t number);

// Returns how many times larger than what is stored the data can be at most.
uint64_t largest_expansion(const std::vector<Hdf5Filter>& filters);

// Undoes the filters, the last one first, except those whose bit is set in `left_out`. Fills `bytes` with the chunk and
// says whether that was possible: no damage was found, and there are exactly `expected` bytes. No more memory than a
// few times `expected` and what is stored is taken. element_size is the bytes of a number, which shuffling takes apart.
bool undo_hdf5_filters(ByteView stored, uint32_t left_out, const std::vector<Hdf5Filter>& filters,
                       uint64_t element_size, uint64_t expected, std::vector<uint8_t>& bytes);

}  // namespace gld
