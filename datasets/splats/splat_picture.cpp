#include "datasets/splats/splat_picture.h"

#include <algorithm>
#include <cmath>

namespace gld {

CompositedView splat_picture(const GaussianSet& set, const Camera& camera,
                             const ProjectionOptions& projection, const KernelSettings& settings) {
  return render_colours(set, view_of_splats(set, splat_camera(camera, set.origin, projection), settings),
                        settings);
}

Image image_of(const SplatImage& picture) {
  Image image(picture.width, picture.height);
  for (int64_t y = 0; y < picture.height; ++y) {
    for (int64_t x = 0; x < picture.width; ++x) {
      for (int64_t c = 0; c < 3; ++c)
        image.pixel(x, y)[c] =
            static_cast<uint8_t>(std::lround(255 * std::clamp(picture.row(c, y)[x], 0.0F, 1.0F)));
    }
  }
  return image;
}

SplatImage splat_image_of(const Image& image) {
  SplatImage picture(3, image.width, image.height);
  for (int64_t y = 0; y < image.height; ++y) {
    for (int64_t x = 0; x < image.width; ++x) {
      for (int64_t c = 0; c < 3; ++c) picture.row(c, y)[x] = static_cast<float>(image.pixel(x, y)[c]) / 255;
    }
  }
  return picture;
}

}  // namespace gld
