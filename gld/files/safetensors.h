#pragma once

#include "gld/base/mapped_file.h"
#include "gld/files/weight_file.h"

#include <string>

namespace gld {

// Longest header that is read (the format's own limit).
constexpr size_t kMaximumSafetensorsHeader = 100'000'000;

// Parses a whole safetensors file: 8 bytes of header length, a JSON header, the data. The tensors must tile
// the data exactly: no overlap, no hole, nothing out of range. Throws Error naming `where` and the tensor.
// Entries point into `file`.
ParsedWeights parse_safetensors(ByteView file, const std::string& where);

// Returns the header of a file whose tensors follow each other in the order given: 8 length bytes and the JSON text,
// padded so that the data starts at a multiple of 64 bytes. Only names, dtypes and shapes of the entries are used.
// Tensors should be ordered by falling element size, so that every one is aligned to its own element size.
std::string safetensors_header(const std::vector<TensorEntry>& entries,
                               const std::map<std::string, std::string>& metadata);

}  // namespace gld
