#include "gld/cameras/cameras_in_a_row.h"

namespace gld {

Views cameras_in_a_row(const CameraRow& row) {
  Views views;
  views.num_sources = row.sources;
  const auto width = static_cast<double>(row.image.width), height = static_cast<double>(row.image.height);
  for (int64_t i = 0; i < row.views; ++i) {
    Camera camera;
    camera.width = row.image.width;
    camera.height = row.image.height;
    camera.intrinsics << width, 0, 0.5 * width, 0, width, 0.5 * height, 0, 0, 1;
    camera.world_from_camera.translation().x() = 0.2 * static_cast<double>(i);
    views.cameras.push_back(camera);
  }
  return views;
}

}  // namespace gld
