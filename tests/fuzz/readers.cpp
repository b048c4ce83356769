#include "tests/fuzz/readers.h"

#include "gld/base/error.h"
#include "gld/files/npy.h"
#include "gld/files/safetensors.h"
#include "gld/files/torch_archive.h"
#include "gld/files/zip_archive.h"

#include <string>
#include <vector>

namespace gld::test {
namespace {

const std::string kWhere = "fuzzed file";

// Reads each element through the strides, as a copy would.
uint64_t touch(const TensorEntry& entry) {
  uint64_t sum = 0;
  std::vector<int64_t> index(entry.shape.size(), 0);
  for (int64_t left = entry.element_count(); left > 0; --left) {
    int64_t offset = 0;
    for (size_t axis = 0; axis < index.size(); ++axis) offset += index[axis] * entry.strides[axis];
    const int64_t size = byte_size(entry.dtype);
    for (int64_t byte = 0; byte < size; ++byte) sum += entry.data[offset * size + byte];
    for (size_t axis = index.size(); axis-- > 0;) {
      if (++index[axis] < entry.shape[axis]) break;
      index[axis] = 0;
    }
  }
  return sum;
}

void touch(const ParsedWeights& parsed) {
  volatile uint64_t sum = 0;
  for (const auto& entry : parsed.entries) sum = sum + touch(entry);
}

}  // namespace

void read_as_safetensors(const uint8_t* data, size_t size) {
  try {
    touch(parse_safetensors({data, size}, kWhere));
  } catch (const Error&) {
    return;
  }
}

void read_as_torch_archive(const uint8_t* data, size_t size) {
  try {
    const bool zip = size > 0 && data[0] == 'P';
    touch(zip ? parse_torch_zip({data, size}, kWhere) : parse_torch_legacy({data, size}, kWhere));
  } catch (const Error&) {
    return;
  }
}

void read_as_npy(const uint8_t* data, size_t size) {
  try {
    if (size > 0 && data[0] == 'P') {
      const auto archive = ZipArchive::parse({data, size}, kWhere);
      for (const auto& entry : archive->entries()) {
        const auto bytes = archive->read(entry);
        parse_npy({bytes.data(), bytes.size()}, kWhere).to_doubles();
      }
      return;
    }
    const auto array = parse_npy({data, size}, kWhere);
    array.to_floats();
    array.to_integers(kWhere);
    npy_text(array);
  } catch (const Error&) {
    return;
  }
}

}  // namespace gld::test
