#pragma once

#include "gld/splatting/gaussian_set.h"

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

namespace gld {

// The Gaussians of a run folder are in this file.
constexpr const char* kSplatFile = "splats.ply";

// Writes Gaussians in the PLY file that 3DGS writes and public viewers open: per vertex x y z, nx ny nz (0),
// f_dc_0 .. 2, f_rest_* (all of red, then of green, then of blue), opacity (logit), scale_0 .. 2 (logarithms), rot_0 ..
// 3 (w x y z), floats. Coordinates are the world's where floats hold them to 1e-5 of the scene's size, and else
// relative to the origin that the comment "gld:origin X Y Z" says. notes are comments "NAME TEXT". Writing is atomic.
// Errors are as of check_gaussians.
void write_splat_ply(const std::filesystem::path& file, const GaussianSet& set,
                     const std::vector<std::pair<std::string, std::string>>& notes);

// Reads such a file, with properties in any order, quaternions of any length. Throws Error that names the file: what
// parse_ply_vertices refuses, a property that is missing, a number of f_rest that is of no degree, and numbers that
// check_gaussians refuses.
GaussianSet read_splat_ply(const std::filesystem::path& file);

}  // namespace gld
