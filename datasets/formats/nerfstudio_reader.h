#pragma once

#include "datasets/formats/scene_reader.h"

namespace gld {

// Reads transforms.json of nerfstudio, instant-ngp, Blender and DL3DV: OpenGL cameras, intrinsics per frame or shared,
// focal lengths in pixels or as camera_angle_x, lens distortion (undone on loading), applied_transform and
// applied_scale (undone, so that poses are in the world they came from), depth_file_path (16-bit PNG in
// depth_unit_scale_factor metres, 0.001 unless given, or .npy, in metres unless it is given), mask_path. Where the
// listed folder of images is not there but images_N is (DL3DV), that one is used and the intrinsics follow. Files that
// are listed but missing are counted.
class NerfstudioReader : public SceneReader {
 public:
  std::string name() const override { return "nerfstudio"; }
  std::string marker() const override { return "transforms.json with frames"; }
  bool recognises(const std::filesystem::path& path) const override;
  Scene read(const std::filesystem::path& path, const SceneReading& reading) const override;
};

}  // namespace gld
