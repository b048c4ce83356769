#include "gld/base/sha256.h"

#include "gld/base/error.h"

#include <algorithm>
#include <cstring>
#include <fstream>
#include <vector>

namespace gld {
namespace {

constexpr size_t kBlock = kSha256BlockBytes;

uint32_t rotated(uint32_t value, int bits) { return (value >> bits) | (value << (32 - bits)); }

uint32_t big_endian(const uint8_t* at) {
  return static_cast<uint32_t>(at[0]) << 24 | static_cast<uint32_t>(at[1]) << 16 |
         static_cast<uint32_t>(at[2]) << 8 | static_cast<uint32_t>(at[3]);
}

void add_block(Sha256State& state, const uint8_t* block) {
  uint32_t w[64];
  for (int i = 0; i < 16; ++i) w[i] = big_endian(block + 4 * i);
  for (int i = 16; i < 64; ++i) {
    const uint32_t s0 = rotated(w[i - 15], 7) ^ rotated(w[i - 15], 18) ^ (w[i - 15] >> 3);
    const uint32_t s1 = rotated(w[i - 2], 17) ^ rotated(w[i - 2], 19) ^ (w[i - 2] >> 10);
    w[i] = w[i - 16] + s0 + w[i - 7] + s1;
  }
  auto [a, b, c, d, e, f, g, h] = state;
  for (int i = 0; i < 64; ++i) {
    const uint32_t s1 = rotated(e, 6) ^ rotated(e, 11) ^ rotated(e, 25);
    const uint32_t t1 = h + s1 + ((e & f) ^ (~e & g)) + kSha256Round[i] + w[i];
    const uint32_t s0 = rotated(a, 2) ^ rotated(a, 13) ^ rotated(a, 22);
    const uint32_t t2 = s0 + ((a & b) ^ (a & c) ^ (b & c));
    h = g;
    g = f;
    f = e;
    e = d + t1;
    d = c;
    c = b;
    b = a;
    a = t1 + t2;
  }
  const uint32_t sums[8] = {a, b, c, d, e, f, g, h};
  for (size_t i = 0; i < 8; ++i) state[i] += sums[i];
}

}  // namespace

void sha256_blocks_portable(Sha256State& state, const uint8_t* data, size_t blocks) {
  for (size_t block = 0; block < blocks; ++block) add_block(state, data + block * kSha256BlockBytes);
}

void Sha256::add_blocks(const uint8_t* data, size_t blocks) {
  static const Sha256Blocks fast = sha256_blocks_with_instructions();
  (fast != nullptr ? fast : sha256_blocks_portable)(state_, data, blocks);
}

void Sha256::update(ByteView bytes) {
  size_t pending = length_ % kBlock;
  length_ += bytes.size;
  while (bytes.size != 0) {
    if (pending == 0 && bytes.size >= kBlock) {
      const size_t blocks = bytes.size / kBlock;
      add_blocks(bytes.data, blocks);
      bytes = {bytes.data + blocks * kBlock, bytes.size - blocks * kBlock};
      continue;
    }
    const size_t taken = std::min(kBlock - pending, bytes.size);
    std::memcpy(pending_.data() + pending, bytes.data, taken);
    bytes = {bytes.data + taken, bytes.size - taken};
    pending = (pending + taken) % kBlock;
    if (pending == 0) add_blocks(pending_.data(), 1);
  }
}

void Sha256::update(const std::string& bytes) {
  update(ByteView{reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()});
}

std::string Sha256::hex_digest() {
  const uint64_t bits = 8 * length_;
  std::string padding(1, '\x80');
  padding.append((2 * kBlock - 9 - length_ % kBlock) % kBlock, '\0');
  for (int shift = 56; shift >= 0; shift -= 8) padding += static_cast<char>(bits >> shift & 255);
  update(padding);
  static const char digits[] = "0123456789abcdef";
  std::string text;
  for (const uint32_t word : state_) {
    for (int shift = 28; shift >= 0; shift -= 4) text += digits[word >> shift & 15];
  }
  return text;
}

std::string sha256_of_file(const std::filesystem::path& file) {
  // Read, not mapped: the pages of a mapped file would count as this process's memory.
  constexpr size_t kChunk = size_t{1} << 20;
  MappedFile::open(file);  // says what is wrong with a file that cannot be read
  std::ifstream stream(file, std::ios::binary);
  std::vector<char> chunk(kChunk);
  Sha256 hash;
  while (stream.read(chunk.data(), kChunk), stream.gcount() > 0) {
    hash.update(
        ByteView{reinterpret_cast<const uint8_t*>(chunk.data()), static_cast<size_t>(stream.gcount())});
  }
  if (stream.bad()) fail({file.string(), "a readable file", "a reading error", "check the disk"});
  return hash.hex_digest();
}

}  // namespace gld
