#pragma once

#include "gld/base/mapped_file.h"
#include "gld/base/sha256_blocks.h"

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>

namespace gld {

// SHA-256 (FIPS 180-4), fed piece by piece.
class Sha256 {
 public:
  void update(ByteView bytes);
  void update(const std::string& bytes);
  // 64 hexadecimal digits; the object must not be used afterwards.
  std::string hex_digest();

 private:
  void add_blocks(const uint8_t* data, size_t blocks);

  Sha256State state_ = {0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a,
                        0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
  std::array<uint8_t, 64> pending_ = {};
  uint64_t length_ = 0;  // bytes so far
};

std::string sha256_of_file(const std::filesystem::path& file);

}  // namespace gld
