#include "train/objectives/geometry_targets.h"

#include "gld/base/error.h"
#include "gld/cameras/pose_encoding.h"

#include <algorithm>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace gld {
namespace {

// Returns (rows, columns, 3): R K^-1 (u, v, 1) at the cells' middles, with R into the first view's camera.
torch::Tensor ray_directions(const Camera& camera, const Eigen::Matrix3d& first_from_camera, int64_t rows,
                             int64_t columns) {
  const Eigen::Matrix3d back = first_from_camera * camera.intrinsics.inverse();
  const double column_step = static_cast<double>(camera.width) / static_cast<double>(columns);
  const double row_step = static_cast<double>(camera.height) / static_cast<double>(rows);
  torch::Tensor directions = torch::empty({rows, columns, 3}, torch::kFloat32);
  auto* out = directions.data_ptr<float>();
  for (int64_t row = 0; row < rows; ++row) {
    for (int64_t column = 0; column < columns; ++column) {
      const Eigen::Vector3d direction =
          back * Eigen::Vector3d((static_cast<double>(column) + 0.5) * column_step,
                                 (static_cast<double>(row) + 0.5) * row_step, 1.0);
      for (int axis = 0; axis < 3; ++axis) *out++ = static_cast<float>(direction[axis]);
    }
  }
  return directions;
}

// Returns (views, 9): the cameras in the first one's, centres over that scale.
torch::Tensor encoded_cameras(const std::vector<Camera>& cameras, double scale) {
  const Eigen::Isometry3d first_from_world = cameras.front().camera_from_world();
  const auto values = static_cast<int64_t>(PoseEncoding().size());
  torch::Tensor encodings = torch::empty({static_cast<int64_t>(cameras.size()), values}, torch::kFloat32);
  auto* out = encodings.data_ptr<float>();
  for (Camera camera : cameras) {
    camera.world_from_camera = first_from_world * camera.world_from_camera;
    camera.world_from_camera.translation() /= scale;
    for (const double number : pose_encoding(camera)) *out++ = static_cast<float>(number);
  }
  return encodings;
}

}  // namespace

torch::Tensor pixel_under_cell(int64_t cells, int64_t pixels) {
  torch::Tensor index = torch::empty({cells}, torch::kInt64);
  for (int64_t i = 0; i < cells; ++i) {
    index.data_ptr<int64_t>()[i] = std::min((2 * i + 1) * pixels / (2 * cells), pixels - 1);
  }
  return index;
}

std::optional<GeometryTargets> geometry_targets(const TrainingScene& scene, const RayGrid& grid) {
  if (!scene.depth.defined()) {
    fail({"scene " + scene.name, "depth to train the backbone with", "none",
          "use scenes with depth, such as those of gld synth"});
  }
  const auto depth = scene.depth.to(torch::kCPU).to(torch::kFloat32);
  const Eigen::Isometry3d first_from_world = scene.views.cameras.front().camera_from_world();
  const auto columns = pixel_under_cell(grid.columns, scene.width());
  const auto rows = pixel_under_cell(grid.rows, scene.height());

  GeometryTargets targets;
  std::vector<torch::Tensor> rays;
  for (int64_t view = 0; view < scene.views.size(); ++view) {
    const Camera& camera = scene.views.cameras[static_cast<size_t>(view)];
    const Eigen::Isometry3d first_from_camera = first_from_world * camera.world_from_camera;
    const auto directions = ray_directions(camera, first_from_camera.linear(), grid.rows, grid.columns);
    const Eigen::Vector3d centre = first_from_camera.translation();
    const auto origin = torch::tensor({centre.x(), centre.y(), centre.z()}, torch::kFloat32)
                            .expand({grid.rows, grid.columns, 3});
    rays.push_back(torch::cat({directions, origin}, 2));
  }
  targets.rays = torch::stack(rays);
  targets.valid = depth > 0.0;
  targets.ray_depth = depth.index_select(1, rows).index_select(2, columns);
  targets.ray_valid = targets.ray_depth > 0.0;

  const auto points =
      targets.rays.narrow(3, 0, 3) * targets.ray_depth.unsqueeze(3) + targets.rays.narrow(3, 3, 3);
  const auto norms = points.norm(2, -1).masked_select(targets.ray_valid);
  if (norms.numel() == 0) return std::nullopt;
  targets.scale = std::max(norms.to(torch::kFloat64).mean().item<double>(), 1e-12);
  targets.depth = depth / targets.scale;
  targets.ray_depth = targets.ray_depth / targets.scale;
  targets.rays = torch::cat({targets.rays.narrow(3, 0, 3), targets.rays.narrow(3, 3, 3) / targets.scale}, 3);
  targets.cameras = encoded_cameras(scene.views.cameras, targets.scale);
  const auto device = scene.images.device();
  for (torch::Tensor* tensor : {&targets.depth, &targets.valid, &targets.rays, &targets.ray_depth,
                                &targets.ray_valid, &targets.cameras}) {
    *tensor = tensor->to(device);
  }
  return targets;
}

}  // namespace gld
