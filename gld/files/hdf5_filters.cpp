#include "gld/files/hdf5_filters.h"

#include <algorithm>
#include <cstddef>
#include <cstring>

#include <zlib.h>

namespace gld {
namespace {

constexpr uint64_t kLargestDeflate = 1032;  // deflate cannot shrink data more
constexpr size_t kChecksumSize = 4;

// A checksum may follow the data inside (fletcher32 before deflate).
bool inflate_into(ByteView packed, uint64_t expected, std::vector<uint8_t>& bytes) {
  const uint64_t most = expected + kChecksumSize;
  if (most / kLargestDeflate > packed.size) return false;
  bytes.resize(static_cast<size_t>(most));
  auto size = static_cast<uLongf>(most);
  if (uncompress(bytes.data(), &size, packed.data, static_cast<uLong>(packed.size)) != Z_OK) return false;
  bytes.resize(size);
  return true;
}

void unshuffle_into(ByteView shuffled, size_t element_size, std::vector<uint8_t>& bytes) {
  const size_t count = shuffled.size / element_size;
  bytes.assign(shuffled.data, shuffled.data + shuffled.size);  // what is left over stays in place
  for (size_t byte = 0; byte < element_size; ++byte) {
    for (size_t i = 0; i < count; ++i) bytes[i * element_size + byte] = shuffled.data[byte * count + i];
  }
}

uint32_t fletcher32(const uint8_t* data, size_t size) {
  uint32_t sum = 0, sum_of_sums = 0;
  const auto fold = [](uint32_t value) { return (value & 0xffff) + (value >> 16); };
  constexpr size_t kBlock = 360;  // words that cannot overflow 32 bits
  for (size_t words = size / 2; words > 0;) {
    for (size_t i = std::min(words, kBlock), end = words - i; words > end; --words, data += 2) {
      sum += static_cast<uint32_t>(data[0] << 8 | data[1]);
      sum_of_sums += sum;
    }
    sum = fold(sum);
    sum_of_sums = fold(sum_of_sums);
  }
  if (size % 2 != 0) {
    sum += static_cast<uint32_t>(data[0]) << 8;
    sum_of_sums += sum;
    sum = fold(sum);
    sum_of_sums = fold(sum_of_sums);
  }
  return fold(sum_of_sums) << 16 | fold(sum);
}

// Returns whether the checksum behind the data is theirs, and takes it off them.
bool take_off_checksum(ByteView& bytes) {
  if (bytes.size < kChecksumSize) return false;
  uint32_t stored = 0;
  std::memcpy(&stored, bytes.data + bytes.size - kChecksumSize, kChecksumSize);
  bytes.size -= kChecksumSize;
  return fletcher32(bytes.data, bytes.size) == stored;
}

}  // namespace

bool is_known_hdf5_filter(uint16_t number) {
  switch (static_cast<Hdf5Filter>(number)) {
    case Hdf5Filter::kDeflate:
    case Hdf5Filter::kShuffle:
    case Hdf5Filter::kFletcher32:
      return true;
  }
  return false;
}

uint64_t largest_expansion(const std::vector<Hdf5Filter>& filters) {
  const bool deflated = std::find(filters.begin(), filters.end(), Hdf5Filter::kDeflate) != filters.end();
  return deflated ? kLargestDeflate : 1;
}

bool undo_hdf5_filters(ByteView stored, uint32_t left_out, const std::vector<Hdf5Filter>& filters,
                       uint64_t element_size, uint64_t expected, std::vector<uint8_t>& bytes) {
  bytes.clear();
  ByteView current = stored;
  std::vector<uint8_t> next;
  const auto take_next = [&] {
    bytes.swap(next);
    current = {bytes.data(), bytes.size()};
  };
  for (size_t i = filters.size(); i-- > 0;) {
    if ((left_out >> i & 1) != 0) continue;
    switch (filters[i]) {
      case Hdf5Filter::kDeflate:
        if (!inflate_into(current, expected, next)) return false;
        take_next();
        break;
      case Hdf5Filter::kShuffle:
        unshuffle_into(current, static_cast<size_t>(element_size), next);
        take_next();
        break;
      case Hdf5Filter::kFletcher32:
        if (!take_off_checksum(current)) return false;
        break;
    }
  }
  if (current.size != expected) return false;
  if (current.data == bytes.data()) {
    bytes.resize(current.size);  // a checksum may have stood behind the data
  } else {
    bytes.assign(current.data, current.data + current.size);
  }
  return true;
}

}  // namespace gld
