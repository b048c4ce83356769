#pragma once

#include <cstdint>
#include <vector>

namespace gld {

// Puts sums over windows of radius to each side in the place of the values, (height, width), with zeros outside.
void window_sums(int64_t width, int64_t height, int64_t radius, std::vector<double>& values);

}  // namespace gld
