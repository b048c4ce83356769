#pragma once

#include "datasets/scenes/scene.h"

#include <cstddef>
#include <cstdint>
#include <filesystem>

namespace gld::test {

// What the readers must find in the real scenes, cut down (tests/data/scenes) or whole (the shared data's scenes):
// each fails the test that calls it where they find something else.

// scenes is the folder that holds the clip both as RealEstate10K text and as npz cameras.
void expect_re10k_text_equals_npz(const std::filesystem::path& scenes);

// Depth maps of neighbouring views warp onto each other, and do not where the cameras' axes are turned.
void expect_tartanair_depth_agrees(const std::filesystem::path& scene, size_t frames);

struct ColmapCounts {
  size_t images = 0;
  size_t points = 0;
};

// scenes is the folder that holds colmap_lund_door and colmap_lund_door_binary.
void expect_colmap_text_equals_binary(const std::filesystem::path& scenes, const ColmapCounts& counts);

// Every image has at least fewest_inside of the points in front of it and inside its borders.
Scene expect_colmap_points_inside(const std::filesystem::path& scene, const ColmapCounts& counts,
                                  int64_t fewest_inside);

// gld check-data finds no mistake in the three scenes that have pictures, and sees that their poses are right.
void expect_no_mistakes(const std::filesystem::path& scenes);

}  // namespace gld::test
