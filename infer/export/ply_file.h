#pragma once

#include "gld/report/provenance.h"
#include "infer/export/point_cloud.h"

#include <filesystem>

namespace gld {

// Writes a binary little-endian PLY file: x y z, red green blue (uchar), confidence (float), with the provenance as
// comments "NAME TEXT". Coordinates are floats, and doubles where a float's rounding would be more than 1e-5 of the
// cloud's size, as for a scene far from the origin. An empty cloud is a file of 0 vertices. Writing is atomic. A point
// that is not finite is an Error.
void export_ply(const std::filesystem::path& file, const PointCloud& cloud, const Provenance& provenance);

struct PlyFile {
  PointCloud cloud;
  TextItems comments;
  bool doubles = false;
};

// Reads what export_ply writes. Throws Error for any other file.
PlyFile read_ply(const std::filesystem::path& file);

}  // namespace gld
