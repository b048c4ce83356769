#pragma once

#include "datasets/formats/scene_reader.h"

#include <filesystem>

namespace gld {

// Reads a scan of ScanNet as its tools export it: color/N.jpg, depth/N.png (16-bit millimetres, planar), pose/N.txt
// (world_from_camera, 4x4, OpenCV, metres) and intrinsic/intrinsic_color.txt (4x4). Where that file is not there, as in
// the 1,500 pairs that matchers are tested on (1.), the intrinsics are the scan's in ../intrinsics.npz, for pictures of
// 640x480. Pictures may be smaller copies of the camera's. Depth is brought to the picture's size by nearest pixels,
// and not from the depth camera's lens to the picture's, as everyone does: their focal lengths differ by half a
// percent. Frames whose pose is not finite, where tracking was lost, are left out and counted in a warning.
class ScannetReader : public SceneReader {
 public:
  std::string name() const override { return "scannet"; }
  std::string marker() const override { return "color and pose, with numbered files"; }
  bool recognises(const std::filesystem::path& path) const override;
  Scene read(const std::filesystem::path& path, const SceneReading& reading) const override;
};

// Reads a folder of such scans with a list of pairs of their frames, each pair a scene of two frames: the test of
// correspondence of GLD's Table 5 (Probe3D's). The list is test.npz, whose array `name` has a row (room, scan, frame,
// frame) a pair (1.), or scannet_test_pairs_with_gt.txt, whose lines begin with the names of two pictures,
// scene0707_00_frame-000015.jpg (2.). A pair is a part, "scene0707_00_15_585".
// 1. LoFTR's (Sun et al. 2021) scannet_test_1500. 2. SuperGlue's (Sarlin et al. 2020).
class ScannetPairsReader : public SceneReader {
 public:
  std::string name() const override { return "scannet-pairs"; }
  std::string marker() const override {
    return "scans of ScanNet with test.npz or scannet_test_pairs_with_gt.txt";
  }
  bool recognises(const std::filesystem::path& path) const override;
  std::vector<std::string> parts(const std::filesystem::path& path) const override;
  Scene read(const std::filesystem::path& path, const SceneReading& reading) const override;
};

}  // namespace gld
