#pragma once

#include "datasets/formats/scene_reader.h"
#include "datasets/images/image_file.h"

#include <filesystem>
#include <functional>
#include <optional>
#include <string>

namespace gld {

// Collects the frames of a scene under the rules all readers share: cameras are checked, broken frames are refused
// or counted, listed but missing files are counted.
class SceneBuilder {
 public:
  SceneBuilder(std::string format, const std::filesystem::path& folder, const SceneReading& reading);

  // make returns the frame, or nothing when it was left out; an Error thrown in it makes the frame a broken one. The
  // camera is checked here.
  void add(const std::string& where, const std::function<std::optional<Frame>()>& make);
  void add_missing(const std::filesystem::path& file);
  void warn(const std::string& sentence);  // nothing for an empty one
  Scene& scene() { return scene_; }

  // Throws Error when no frame is left, with the first reason. Frame names are made unique.
  Scene finish();

 private:
  Scene scene_;
  BrokenFrames broken_frames_;
  std::string first_missing_;
  size_t first_gap_ = 0;  // number that the first frame left out would have had
  void note_gap();
};

// The size and orientation of the picture a camera belongs to.
struct FittedImage {
  int64_t width = 0;
  int64_t height = 0;
  ImageOrientation orientation = ImageOrientation::kAsStored;
  double scale_x = 1;  // pixels of the file per pixel of the camera
  double scale_y = 1;
};

// Returns whether a picture that is so many times as wide and high as another one is a scaled copy of it, to 2 %.
bool same_aspect(double scale_x, double scale_y);

// Finds how an image file fits a camera of camera_width x camera_height (0 x 0: not known): the same size, or a smaller
// or larger copy (within 2 % of the same aspect), stored upright or turned by EXIF. When the camera's size is not known
// or both fit, the picture is taken as stored. Throws Error when neither fits.
FittedImage fit_image(const std::filesystem::path& file, int64_t camera_width, int64_t camera_height);

// Returns the intrinsics of the camera in pixels of the fitted image.
Eigen::Matrix3d scaled_intrinsics(const Eigen::Matrix3d& intrinsics, const FittedImage& fitted);

}  // namespace gld
