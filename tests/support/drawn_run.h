#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

namespace gld::test {

// A run folder as gld sample writes one, of a drawn room with its true depth: what stands for generated views are its
// pictures a little brighter.
struct DrawnRun {
  int64_t scene = 0;  // of the seed
  int64_t width = 112, height = 112;
  int64_t sources = 3, targets = 3;
  // The picture's left fifth and lower eighth are cut off, and two of its rows become one: the principal point is off
  // the middle, and pixels are twice as high as wide.
  bool odd_pixels = false;
  bool depth = true;
  bool points = true;   // points.ply, where there is depth to lift it by
  bool splats = false;  // Gaussians fitted to it
  std::string scene_name = "room";
  std::string first_name;  // of the first frame; empty: as the room has it
};

// Writes into an empty folder, without a page.
void write_drawn_run(const std::filesystem::path& folder, const DrawnRun& drawn);

}  // namespace gld::test
