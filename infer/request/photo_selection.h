#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// Which photographs are taken to have one lens, and so one focal length.
enum class PhotoLens {
  kBySize,  // those of equal size, upright or turned
  kShared,  // all, whatever their sizes: some may be smaller copies
  kOwn,     // none
};

// What finds the cameras of photographs.
enum class PhotoCameraWay {
  kAutomatic,  // features, COLMAP where they leave some out or are in doubt, rays where neither finds any
  kColmap,     // the program COLMAP, where it is installed
  kFeatures,   // features that the photographs share, and bundle adjustment
  kRays,       // what the geometry model sees
};

// Photographs without cameras: files and folders; and videos, of each of which so many frames are photographs
// (datasets/video/video_frames.h).
struct PhotoSelection {
  std::vector<std::string> files;
  int64_t frames = 8;
  PhotoLens lens = PhotoLens::kBySize;
  PhotoCameraWay cameras = PhotoCameraWay::kAutomatic;
};

}  // namespace gld
