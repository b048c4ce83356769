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
  // Positions of pixel centres, at whole numbers, as cv::remap wants them: of the ideal picture's rows, or of every few
  // pixels of it.
  struct Positions {
    std::vector<float> x;
    std::vector<float> y;
    void resize(int64_t count);
  };
  const Positions& nodes() const;
  // Returns where the source has these rows of the ideal picture, row by row.
  Positions positions(int64_t first_row, int64_t rows) const;
  Eigen::Vector2f position(int64_t x, int64_t y) const;
  // Calls done(row, positions of that row) for each of them.
  void for_rows(const std::function<void(int64_t row, const Positions& row_positions)>& done) const;

  Size ideal_;
  Size source_;
  PixelMapping mapping_;
  mutable std::once_flag made_;
  mutable Positions nodes_;  // kept as long as the frames are: of a sixteenth of the pixels
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
