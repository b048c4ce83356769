#include "gld/camera_encoding/camera_conditioning.h"

#include "gld/base/error.h"

#include <string>

#include <torch/types.h>

namespace gld {
namespace {

constexpr int64_t kChannels = 7;

void check_sizes(const Views& views) {
  for (const Camera& camera : views.cameras) {
    const Camera& first = views.cameras.front();
    if (camera.width == first.width && camera.height == first.height) continue;
    fail({"camera conditioning",
          "views of one size, " + std::to_string(first.width) + " x " + std::to_string(first.height),
          std::to_string(camera.width) + " x " + std::to_string(camera.height),
          "resize and crop all views to one size"});
  }
}

torch::Tensor empty_conditioning(const Views& views) {
  check_sizes(views);
  if (views.cameras.empty()) {
    fail({"camera conditioning", "at least one view", "none", "pass the cameras of the scene"});
  }
  const Camera& first = views.cameras.front();
  auto conditioning = torch::zeros({views.size(), kChannels, first.height, first.width},
                                   torch::TensorOptions(torch::kFloat64));
  conditioning.narrow(0, views.num_sources, views.num_targets()).select(1, 0).fill_(1.0);
  return conditioning;
}

}  // namespace

torch::Tensor camera_conditioning(const RelativeCameras& cameras, const PixelOffset& offset,
                                  torch::Dtype dtype) {
  auto conditioning = empty_conditioning(cameras.views);
  for (int64_t view = 0; view < cameras.views.size(); ++view) {
    const Camera& camera = cameras.views.cameras[static_cast<size_t>(view)];
    const Eigen::Matrix3d rotation = camera.world_from_camera.linear();
    const Eigen::Vector3d origin = camera.world_from_camera.translation();
    const double fx = camera.intrinsics(0, 0), fy = camera.intrinsics(1, 1);
    const double cx = camera.intrinsics(0, 2), cy = camera.intrinsics(1, 2);
    const int64_t pixels = camera.width * camera.height;
    double* rays = conditioning.data_ptr<double>() + (view * kChannels + 1) * pixels;
    for (int64_t row = 0; row < camera.height; ++row) {
      for (int64_t column = 0; column < camera.width; ++column, ++rays) {
        const Eigen::Vector3d in_camera((static_cast<double>(column) + offset.x - cx) / fx,
                                        (static_cast<double>(row) + offset.y - cy) / fy, 1.0);
        const Eigen::Vector3d direction = (rotation * in_camera).normalized();
        const Eigen::Vector3d moment = origin.cross(direction);
        for (int axis = 0; axis < 3; ++axis) {
          rays[axis * pixels] = direction[axis];
          rays[(axis + 3) * pixels] = moment[axis];
        }
      }
    }
  }
  return conditioning.to(dtype);
}

torch::Tensor camera_conditioning_without_rays(const Views& views, torch::Dtype dtype) {
  return empty_conditioning(views).to(dtype);
}

torch::Tensor scaled_camera_from_world(const RelativeCameras& cameras) {
  auto matrices = torch::empty({cameras.views.size(), 4, 4}, torch::kFloat64);
  double* out = matrices.data_ptr<double>();
  for (const Camera& camera : cameras.world_views.cameras) {
    const Eigen::Matrix4d matrix = camera.world_from_camera.inverse().matrix();
    for (int row = 0; row < 4; ++row) {
      for (int column = 0; column < 4; ++column) *out++ = matrix(row, column);
    }
  }
  return matrices;
}

}  // namespace gld
