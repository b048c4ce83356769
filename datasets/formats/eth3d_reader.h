#pragma once

#include "datasets/formats/scene_reader.h"

namespace gld {

// Reads ETH3D's high-resolution scenes: dslr_calibration_jpg/ (COLMAP text, thin-prism fisheye cameras) with
// images/dslr_images/, or dslr_calibration_undistorted/ with images/dslr_images_undistorted/; the first whose images
// are there is used. ground_truth_depth/dslr_images/ holds raw float32 metres (planar, infinity where unknown) in the
// geometry of the distorted images; with undistorted images it is carried over through dslr_calibration_jpg.
class Eth3dReader : public SceneReader {
 public:
  std::string name() const override { return "eth3d"; }
  std::string marker() const override { return "dslr_calibration_jpg/ or dslr_calibration_undistorted/"; }
  bool recognises(const std::filesystem::path& path) const override;
  Scene read(const std::filesystem::path& path, const SceneReading& reading) const override;
};

}  // namespace gld
