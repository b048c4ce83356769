#pragma once

namespace gld {

constexpr double kDegreesPerRadian = 180 / 3.14159265358979323846;

}  // namespace gld
