#include "datasets/splats/matched_start.h"

#include "gld/cameras/resized_camera.h"
#include "gld/photogrammetry/photograph_composition.h"
#include "gld/photogrammetry/plane_sweep_stereo.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace gld {
namespace {

PicturedView pictured_view(const SplatPicture& picture) {
  PicturedView view;
  view.camera = picture.camera;
  view.width = picture.image.width;
  view.height = picture.image.height;
  view.rgb.reserve(static_cast<size_t>(3 * view.width * view.height));
  for (int64_t y = 0; y < view.height; ++y) {
    for (int64_t x = 0; x < view.width; ++x) {
      // What is masked has no colour to be matched.
      const bool valid = picture.valid.empty() || picture.valid[static_cast<size_t>(y * view.width + x)] != 0;
      for (int64_t c = 0; c < 3; ++c) {
        view.rgb.push_back(valid ? static_cast<float>(picture.image.pixel(x, y)[c]) / 255
                                 : std::numeric_limits<float>::quiet_NaN());
      }
    }
  }
  return view;
}

// photograph is of the depth's size.
SplatPicture matched_picture(const PicturedView& photograph, const StereoDepth& matched) {
  SplatPicture picture;
  picture.camera = resized_camera(photograph.camera, photograph.width, photograph.height);
  picture.image = Image(photograph.width, photograph.height);
  picture.depth = DepthMap(photograph.width, photograph.height);
  for (int64_t y = 0; y < photograph.height; ++y) {
    for (int64_t x = 0; x < photograph.width; ++x) {
      const auto pixel = static_cast<size_t>(y * photograph.width + x);
      for (size_t c = 0; c < 3; ++c) {
        const float value = photograph.rgb[3 * pixel + c];
        picture.image.pixel(x, y)[c] =
            std::isfinite(value) ? static_cast<uint8_t>(std::lround(255 * std::clamp(value, 0.0F, 1.0F))) : 0;
      }
      const bool seen = std::isfinite(photograph.rgb[3 * pixel]);
      if (seen && matched.confidence.values[pixel] >= kConfidentStereo)
        picture.depth.at(x, y) = matched.depth.values[pixel];
    }
  }
  return picture;
}

}  // namespace

std::vector<SplatPicture> with_matched_depth(const std::vector<SplatPicture>& pictures,
                                             const std::vector<Eigen::Vector3d>& points_in_world,
                                             const KernelSettings& settings) {
  std::vector<PicturedView> views;
  views.reserve(pictures.size());
  for (const SplatPicture& picture : pictures) views.push_back(pictured_view(picture));
  const StereoScene stereo = stereo_depth(views, points_in_world, {}, settings);
  std::vector<SplatPicture> matched;
  for (size_t i = 0; i < views.size(); ++i) {
    const StereoDepth& depth = stereo.views[i];
    matched.push_back(
        matched_picture(reduced_view(views[i], std::max(depth.depth.width, depth.depth.height)), depth));
  }
  return matched;
}

}  // namespace gld
