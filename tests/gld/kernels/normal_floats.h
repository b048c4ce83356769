#pragma once

#include <cstdint>
#include <random>
#include <vector>

namespace gld::test {

inline std::vector<float> normals(int64_t count, unsigned seed) {
  std::mt19937 engine(seed);
  std::normal_distribution<float> normal;
  std::vector<float> values(static_cast<std::size_t>(count));
  for (float& value : values) value = normal(engine);
  return values;
}

}  // namespace gld::test
