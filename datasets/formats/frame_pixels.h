#pragma once

#include "datasets/formats/scene_builder.h"
#include "datasets/scenes/scene.h"
#include "datasets/scenes/undistortion.h"

#include <filesystem>
#include <map>
#include <memory>
#include <string>

namespace gld {

// What a reader knows about a frame before it is put together.
struct FrameRecord {
  std::string name;
  std::filesystem::path image_file;
  int64_t camera_width = 0;  // the size the intrinsics belong to; 0: that of the image file
  int64_t camera_height = 0;
  Eigen::Matrix3d intrinsics = Eigen::Matrix3d::Identity();
  LensDistortion lens;
  Eigen::Isometry3d world_from_camera = Eigen::Isometry3d::Identity();
  std::function<DepthMap()> load_depth;         // in the picture as stored, distortion included; may be empty
  std::function<ValidityMask()> load_validity;  // likewise
};

// Builds frames from records: fits intrinsics to the image file, undoes distortion on loading, and shares the
// undistortion table between frames of one camera.
class FrameMaker {
 public:
  // Depth and masks are brought to the image's size (nearest) where a format stores them in another one. A picture
  // whose distortion is undone is cropped to what the lens saw: it has no borders without pixels.
  Frame make(const FrameRecord& record);

  // Returns what was cropped, a sentence for the scene's warnings; empty where nothing was.
  std::string crop_note() const;

 private:
  struct Undistortion {
    Camera ideal;  // at the origin
    std::shared_ptr<const Undistorter> undistorter;
  };
  std::map<std::string, Undistortion> undistortions_;
  int64_t cropped_frames_ = 0;
  std::string first_crop_;
};

}  // namespace gld
