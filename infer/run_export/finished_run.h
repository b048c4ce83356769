#pragma once

#include "datasets/images/image.h"
#include "gld/cameras/camera.h"
#include "gld/photogrammetry/planar_depth.h"
#include "gld/report/provenance.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace gld {

// A view of a run of gld sample, as its folder has it.
struct RunView {
  std::string name;  // "view_03"
  bool target = false;
  Camera camera;                // of the picture
  std::filesystem::path image;  // a PNG file; empty where the run has none
  Camera depth_camera;          // of the depth map: the same camera in the depth map's size
  std::filesystem::path depth;  // a 16-bit PNG file; empty where the run has none
  double depth_unit = 0;        // length of a step of it

  bool has_depth() const { return !depth.empty(); }
  // Read from the files each time. Error where a file is damaged or has another size than its camera.
  Image picture() const;
  // In the unit of the cameras; 0 where it is not known, also where the file only says "at least that far".
  DepthMap depth_map() const;
};

// Returns the depth as photogrammetry takes it.
PlanarDepth planar_depth(const DepthMap& depth);

struct FinishedRun {
  std::filesystem::path folder;
  bool metric = false;          // poses and depth are in metres
  std::vector<RunView> views;   // sources first
  std::filesystem::path cloud;  // points.ply; empty where there is none in the world of the cameras
  std::string cloud_missing;    // why there is none, for people: "the run has no points.ply"
  // Of the run, for what is made of it.
  std::string model_hash;
  int64_t seed = 0;
  std::string precision;
  std::string options;  // JSON on one line
};

// Reads what a finished run of gld sample left in its folder, and nothing else; pictures are looked for and not opened.
// Throws an Error of one sentence for a folder that is missing, no run, a run of another command or one that is not
// finished, and for files that cameras.json names and that are not there.
FinishedRun open_finished_run(const std::filesystem::path& folder);

}  // namespace gld
