#pragma once

#include "gld/base/mapped_file.h"
#include "gld/files/weight_file.h"

#include <string>

namespace gld {

// PyTorch's .pt and .pth files are read without running anything in them (gld/files/pickle.h), in the zip layout (since
// PyTorch 1.6) and the older one of consecutive pickles followed by the storages. Storages of any device are taken.
// Dictionaries and lists are flattened: keys and indices joined by '.'; None is left out; a lone tensor is called
// "tensor". Entries point into `file` or, for compressed storages, into `owners`. Throws Error naming `where`.
ParsedWeights parse_torch_zip(ByteView file, const std::string& where);
ParsedWeights parse_torch_legacy(ByteView file, const std::string& where);

}  // namespace gld
