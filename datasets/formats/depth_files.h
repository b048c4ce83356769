#pragma once

#include "datasets/images/image.h"

#include <filesystem>
#include <vector>

#include <Eigen/Core>

namespace gld {

// These functions read and write depth as the layouts store it. Values that are not positive and finite become 0
// (unknown).

// The array is (height, width) or (height, width, 1) of any floating type.
DepthMap read_depth_npy(const std::filesystem::path& file);
void write_depth_npy(const std::filesystem::path& file, const DepthMap& depth);  // float32

// ETH3D has raw little-endian float32 without a header; throws Error when the file's size is not width * height * 4.
DepthMap read_depth_raw(const std::filesystem::path& file, int64_t width, int64_t height);
void write_depth_raw(const std::filesystem::path& file, const DepthMap& depth);

// Sparse points beside cameras: (points, 3) of any floating type, all finite.
std::vector<Eigen::Vector3d> read_points_npy(const std::filesystem::path& file);
void write_points_npy(const std::filesystem::path& file, const std::vector<Eigen::Vector3d>& points);

// Replaces what is no depth by 0.
void clear_unknown(DepthMap& depth);

}  // namespace gld
