#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <nlohmann/json.hpp>

namespace gld {

// These functions write numbers of many things as planes of bytes, one number after another, as the page's script
// planes.js takes them apart.

// Neighbours in a list are neighbours in space: differences are of 16 bits, small ones of both signs are small numbers,
// and the low bytes of all of them come first, then the high ones.
void append_differences(std::string& bytes, const std::vector<uint16_t>& values);
// Differences are of 8 bits.
void append_differences(std::string& bytes, const std::vector<uint8_t>& values);

// A point is low + step * (three numbers of 16 bits).
struct PackedBox {
  Eigen::Vector3d low, step;
  double diagonal = 0;  // of the box around the points
};
// Appends three planes, of at least one point. None moves by more than the 131070th part of the box.
PackedBox append_positions(std::string& bytes, const std::vector<Eigen::Vector3d>& points);

nlohmann::ordered_json vector_json(const Eigen::Vector3d& x);

}  // namespace gld
