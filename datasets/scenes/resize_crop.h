#pragma once

#include "datasets/images/image.h"
#include "datasets/scenes/scene.h"
#include "gld/cameras/camera.h"
#include "gld/cameras/image_size.h"

#include <cstdint>
#include <vector>

namespace gld {

// Returns the one whose aspect is nearest (ratio of ratios); throws Error when the list is empty.
ImageSize nearest_trained_size(int64_t width, int64_t height, const std::vector<ImageSize>& sizes);

// What stays in the middle of a crop. About the principal point, as the release trains: the largest window with the
// principal point (rounded to whole pixels) at its centre is cut out first, and the lens looks along the middle of
// every picture; what lies outside is lost.
enum class CropCentre { kImage, kPrincipalPoint };

// A window cut out of the source, a uniform resize that covers the target (up to rounding the other side to whole
// pixels), then a centred crop.
struct ResizeCrop {
  int64_t source_width = 0;
  int64_t source_height = 0;
  int64_t window_left = 0;
  int64_t window_top = 0;
  int64_t window_width = 0;
  int64_t window_height = 0;
  int64_t resized_width = 0;
  int64_t resized_height = 0;
  int64_t left = 0;
  int64_t top = 0;
  ImageSize target;
};
// This takes the whole source as the window.
ResizeCrop plan_resize_crop(int64_t width, int64_t height, const ImageSize& target);
// Throws Error where the principal point is within a fifth of a side's length of that side's end (as the release
// refuses), for kPrincipalPoint.
ResizeCrop plan_resize_crop(const Camera& camera, const ImageSize& target, CropCentre centre);

// Returns the same crop of the same window at `times` the size, so that its camera is resized_camera() of the small
// one's: a plan made for the larger size would round to other pixels.
ResizeCrop magnified(ResizeCrop plan, int64_t times);

// The intrinsics follow exactly: the scale is that of the whole-pixel sizes, not the ideal one.
Camera resize_crop(const Camera& camera, const ResizeCrop& plan);
// It uses area averaging when shrinking, bicubic interpolation when growing.
Image resize_crop(const Image& image, const ResizeCrop& plan);
// It takes the nearest pixel centre: depth is never averaged over an edge.
DepthMap resize_crop(const DepthMap& depth, const ResizeCrop& plan);
ValidityMask resize_crop(const ValidityMask& mask, const ResizeCrop& plan);

// A frame loaded at a trained size. depth and validity are empty when not asked for or not there.
struct SizedFrame {
  Camera camera;
  Image image;
  DepthMap depth;
  ValidityMask validity;
};
enum class FrameParts { kImage, kImageAndDepth };
SizedFrame load_sized(const Frame& frame, const ImageSize& target, FrameParts parts,
                      CropCentre centre = CropCentre::kImage);
// Returns the image and camera of what load_sized() gives, `times` as large.
SizedFrame load_magnified(const Frame& frame, const ImageSize& target, int64_t times);

}  // namespace gld
