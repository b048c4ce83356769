#pragma once

#include "datasets/images/image.h"
#include "gld/cameras/camera.h"

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include <Eigen/Core>

namespace gld {

// One photograph with its camera. Pixels are loaded when asked for, each time anew; the functions may be called
// from several threads. Images, depth and mask all have the camera's size.
struct Frame {
  std::string name;                  // unique in its scene, "frame_00003"
  Camera camera;                     // OpenCV, whatever the files used
  std::filesystem::path image_file;  // empty for generated frames and camera-only records

  std::function<Image()> load_image;            // distortion undone
  std::function<DepthMap()> load_depth;         // empty when the scene has no depth
  std::function<ValidityMask()> load_validity;  // empty when every pixel is valid

  bool has_image() const { return static_cast<bool>(load_image); }
  bool has_depth() const { return static_cast<bool>(load_depth); }

  // These return what the functions above give, checked: they throw Error when the size is not the camera's or there is
  // none.
  Image image() const;
  DepthMap depth() const;
  ValidityMask validity() const;
};

struct Scene {
  std::string name;
  std::string format;            // the reader's name
  std::filesystem::path folder;  // where it was found; empty for generated scenes
  std::vector<Frame> frames;     // in the order of the video or of the file names
  bool metric = false;           // poses and depth are in metres

  int64_t missing_files = 0;          // frames that are listed but have no file
  int64_t broken_frames = 0;          // frames skipped for another reason
  std::vector<std::string> warnings;  // one sentence each; includes the reason of each skipped frame
  std::vector<Eigen::Vector3d> points_in_world;  // sparse points where the format has them
};

}  // namespace gld
