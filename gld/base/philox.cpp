#include "gld/base/philox.h"

#include "gld/base/mixed_bits.h"

#include <algorithm>
#include <cmath>

namespace gld {
namespace {

constexpr uint32_t kMultiplier0 = 0xD2511F53U;
constexpr uint32_t kMultiplier1 = 0xCD9E8D57U;
constexpr uint32_t kWeyl0 = 0x9E3779B9U;  // golden ratio
constexpr uint32_t kWeyl1 = 0xBB67AE85U;  // sqrt(3) - 1
constexpr int kRounds = 10;

// The number lies strictly between 0 and 1, so that its logarithm is finite.
double open_uniform(uint32_t bits) { return (static_cast<double>(bits) + 0.5) * 0x1.0p-32; }

}  // namespace

std::array<uint32_t, 4> philox4x32(PhiloxCounter counter, PhiloxKey key) {
  for (int round = 0; round < kRounds; ++round) {
    const uint64_t product0 = static_cast<uint64_t>(kMultiplier0) * counter[0];
    const uint64_t product1 = static_cast<uint64_t>(kMultiplier1) * counter[2];
    counter = {static_cast<uint32_t>(product1 >> 32) ^ counter[1] ^ key[0], static_cast<uint32_t>(product1),
               static_cast<uint32_t>(product0 >> 32) ^ counter[3] ^ key[1], static_cast<uint32_t>(product0)};
    key[0] += kWeyl0;
    key[1] += kWeyl1;
  }
  return counter;
}

uint64_t fnv1a(const std::string& text) {
  uint64_t hash = 0xCBF29CE484222325ULL;
  for (const char letter : text) hash = (hash ^ static_cast<unsigned char>(letter)) * 0x100000001B3ULL;
  return hash;
}

PhiloxKey philox_key(uint64_t seed, const std::string& stream) {
  const uint64_t key = mixed_bits(mixed_bits(seed) ^ fnv1a(stream));
  return {static_cast<uint32_t>(key), static_cast<uint32_t>(key >> 32)};
}

void fill_normal(const NormalRun& run, float* out, int64_t count) {
  const double two_pi = 2.0 * std::acos(-1.0);
  for (int64_t done = 0; done < count; done += 4) {
    const auto block = static_cast<uint64_t>((run.first + done) / 4);
    const auto bits = philox4x32({static_cast<uint32_t>(block), static_cast<uint32_t>(block >> 32),
                                  static_cast<uint32_t>(run.index), static_cast<uint32_t>(run.index >> 32)},
                                 run.key);
    float normal[4];
    for (int pair = 0; pair < 2; ++pair) {
      const double radius = std::sqrt(-2.0 * std::log(open_uniform(bits[2 * pair])));
      const double angle = two_pi * open_uniform(bits[2 * pair + 1]);
      normal[2 * pair] = static_cast<float>(radius * std::cos(angle));
      normal[2 * pair + 1] = static_cast<float>(radius * std::sin(angle));
    }
    std::copy_n(normal, std::min<int64_t>(4, count - done), out + done);
  }
}

}  // namespace gld
