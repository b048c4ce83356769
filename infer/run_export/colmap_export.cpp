#include "infer/run_export/colmap_export.h"

#include "datasets/formats/colmap_model.h"
#include "gld/base/atomic_folder.h"
#include "gld/photogrammetry/depth_between.h"
#include "infer/export/image_export.h"

#include <cmath>
#include <optional>
#include <vector>

#include <Eigen/Geometry>
#include <fmt/format.h>

namespace gld {
namespace {

constexpr double kSameSurface = 0.05;

// A view as points are looked for in it.
struct SeeingView {
  const Camera& camera;
  Eigen::Isometry3d camera_from_world;
  PlanarDepth depth;  // empty where the run has none

  Eigen::Vector2d seen_at(const Eigen::Vector3d& in_camera) const {
    const Eigen::Matrix3d& k = camera.intrinsics;
    return {k(0, 0) * in_camera.x() / in_camera.z() + k(0, 2),
            k(1, 1) * in_camera.y() / in_camera.z() + k(1, 2)};
  }
  Eigen::Vector3d lifted(const Eigen::Vector2d& position, double z) const {
    const Eigen::Matrix3d& k = camera.intrinsics;
    return camera.world_from_camera *
           Eigen::Vector3d((position.x() - k(0, 2)) / k(0, 0) * z, (position.y() - k(1, 2)) / k(1, 1) * z, z);
  }
};

// Where a view sees a point, and the depth that it has there.
struct Sight {
  size_t view = 0;
  Eigen::Vector2d position = Eigen::Vector2d::Zero();
  double depth = 0;
};

std::optional<Sight> sight_of(const SeeingView& view, size_t number, const Eigen::Vector3d& point) {
  const Eigen::Vector3d in_camera = view.camera_from_world * point;
  if (!(in_camera.z() > 0) || view.depth.values.empty()) return std::nullopt;
  Sight sight;
  sight.view = number;
  sight.position = view.seen_at(in_camera);
  const auto width = static_cast<double>(view.camera.width);
  const auto height = static_cast<double>(view.camera.height);
  const bool inside = sight.position.x() >= 0 && sight.position.x() < width && sight.position.y() >= 0 &&
                      sight.position.y() < height;
  if (!inside) return std::nullopt;
  sight.depth =
      depth_between(view.depth, sight.position.x() * static_cast<double>(view.depth.width) / width - 0.5,
                    sight.position.y() * static_cast<double>(view.depth.height) / height - 0.5);
  if (!(sight.depth > 0) || std::abs(in_camera.z() / sight.depth - 1) > kSameSurface) return std::nullopt;
  return sight;
}

double disagreement(const std::vector<SeeingView>& views, const std::vector<Sight>& sights) {
  double sum = 0;
  int64_t count = 0;
  for (const Sight& from : sights) {
    const Eigen::Vector3d carried = views[from.view].lifted(from.position, from.depth);
    for (const Sight& to : sights) {
      if (from.view == to.view) continue;
      const Eigen::Vector3d in_camera = views[to.view].camera_from_world * carried;
      if (!(in_camera.z() > 0)) continue;
      sum += (views[to.view].seen_at(in_camera) - to.position).norm();
      ++count;
    }
  }
  return count == 0 ? -1 : sum / static_cast<double>(count);
}

ColmapImage image_of(const Camera& camera, int64_t camera_id, const std::string& name) {
  const Eigen::Isometry3d pose = camera.camera_from_world();
  ColmapImage image;
  image.rotation = Eigen::Quaterniond(pose.linear()).normalized();
  if (image.rotation.w() < 0) image.rotation.coeffs() *= -1;
  image.translation = pose.translation();
  image.camera_id = camera_id;
  image.name = name;
  return image;
}

}  // namespace

ColmapCounts export_colmap(const std::filesystem::path& folder, const FinishedRun& run,
                           const PointCloud& cloud, const TextItems& provenance) {
  const auto images = folder / "images", binary = folder / "sparse" / "0", text = folder / "sparse_txt";
  for (const auto& path : {images, binary, text}) std::filesystem::create_directories(path);
  ColmapModel model;
  std::vector<SeeingView> views;
  const auto count = static_cast<int64_t>(run.views.size());
  for (const RunView& view : run.views) {
    const auto number = static_cast<int64_t>(views.size());
    const std::string name = view_name(number, count) + ".png";
    const Eigen::Matrix3d& k = view.camera.intrinsics;
    model.cameras[number + 1] = {
        "PINHOLE", view.camera.width, view.camera.height, {k(0, 0), k(1, 1), k(0, 2), k(1, 2)}};
    model.images.push_back(image_of(view.camera, number + 1, name));
    views.push_back({view.camera, view.camera.camera_from_world(),
                     view.has_depth() ? planar_depth(view.depth_map()) : PlanarDepth()});
    copy_file_atomically(view.image, images / name);
  }
  ColmapCounts counts;
  counts.points = cloud.size();
  model.points_in_world = cloud.x_in_world;
  for (size_t point = 0; point < cloud.x_in_world.size(); ++point) {
    std::vector<Sight> sights;
    for (size_t view = 0; view < views.size(); ++view) {
      const auto sight = sight_of(views[view], view, cloud.x_in_world[point]);
      if (!sight) continue;
      sights.push_back(*sight);
      model.images[view].sightings.push_back({point + 1, sight->position});
    }
    counts.sightings += static_cast<int64_t>(sights.size());
    counts.seen_once += sights.size() == 1 ? 1 : 0;
    counts.seen_nowhere += sights.empty() ? 1 : 0;
    model.point_looks.push_back({cloud.colours[point], disagreement(views, sights)});
  }
  for (const auto& [name, value] : provenance) model.comments.push_back(fmt::format("{} {}", name, value));
  write_colmap_model(binary, model, ColmapForm::kBinary);
  write_colmap_model(text, model, ColmapForm::kText);
  return counts;
}

}  // namespace gld
