#pragma once

#include "datasets/images/image.h"
#include "datasets/scenes/lens_distortion.h"
#include "gld/cameras/camera.h"

#include <functional>
#include <memory>
#include <mutex>
#include <vector>

#include <Eigen/Core>

namespace gld {

// Turns pictures of a real lens into pictures of an ideal pinhole camera. The table of source positions is made at the
// first use and shared by all frames of the camera; it is safe to use from several threads.
class Undistorter {
 public:
  // Maps a position in the ideal picture to one in the source picture (pixels, (0.5, 0.5) is the first centre), or to
  // a position outside it.
  using PixelMapping = std::function<Eigen::Vector2d(const Eigen::Vector2d& ideal_pixel)>;
  struct Size {
    int64_t width = 0;
    int64_t height = 0;
  };
  Undistorter(const Size& ideal, const Size& source, PixelMapping mapping);

  Image image(const Image& source) const;                   // bilinear; black where the source has no pixel
  DepthMap depth(const DepthMap& source) const;             // nearest; outside the source 0
  ValidityMask validity() const;                            // 1 where the source picture has a pixel
  ValidityMask validity(const ValidityMask& source) const;  // and where that pixel is valid

 private:
  struct Table {
    std::vector<float> x;  // pixel centres at whole numbers, as cv::remap wants them
    std::vector<float> y;
  };
  const Table& table() const;

  Size ideal_;
  Size source_;
  PixelMapping mapping_;
  mutable std::once_flag made_;
  mutable Table table_;
};

// The usual case: a camera with distortion, and the ideal camera with its own intrinsics (often the same).
struct LensCamera {
  int64_t width = 0;
  int64_t height = 0;
  Eigen::Matrix3d intrinsics = Eigen::Matrix3d::Identity();
  LensDistortion lens;
};
std::shared_ptr<const Undistorter> make_undistorter(const Camera& ideal, const LensCamera& source);

// Returns the part of the ideal camera's picture, a rectangle as large as possible, that the source has pixels for
// everywhere: the same camera with a smaller picture, its principal point moved with the corner. It is found from
// samples along lines, to a pixel or two. Throws Error where not even 2x2 pixels are left.
Camera cropped_to_source(const Camera& ideal, const LensCamera& source);

}  // namespace gld
