#pragma once

#include <cstddef>
#include <cstdint>

namespace gld::test {

// Each reads the bytes as a file of that kind and then touches every element. gld::Error is the only way to refuse.
void read_as_safetensors(const uint8_t* data, size_t size);
void read_as_torch_archive(const uint8_t* data, size_t size);  // zip or legacy, by the first byte
void read_as_npy(const uint8_t* data, size_t size);            // npy or npz, by the first byte

}  // namespace gld::test
