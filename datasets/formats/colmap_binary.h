#pragma once

#include "datasets/formats/colmap_model.h"

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <Eigen/Core>

namespace gld {

// Reads cameras.bin, images.bin and points3D.bin (the last may be missing); they are little-endian.
ColmapModel read_colmap_binary(const std::filesystem::path& folder);
void write_colmap_binary(const std::filesystem::path& folder, const ColmapModel& model);

// Where the images of a model show its points: much more than the model itself, so read apart.
struct ColmapSightings {
  std::map<uint64_t, Eigen::Vector3d> points_in_world;        // by id
  std::map<std::string, std::vector<ColmapSighting>> images;  // by name; only places that belong to a point
};
ColmapSightings read_colmap_sightings(const std::filesystem::path& folder);

}  // namespace gld
