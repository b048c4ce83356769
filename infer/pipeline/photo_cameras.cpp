#include "infer/pipeline/photo_cameras.h"

#include "gld/base/error.h"
#include "gld/cameras/angles.h"
#include "gld/cameras/photo_consistency.h"
#include "infer/pipeline/geometry_placement.h"
#include "infer/pipeline/predicted_cameras.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {
namespace {

constexpr double kLargestDirectionError = 5;  // degrees, as the median over a photograph's rays
constexpr double kLargestOriginError = 0.3;   // of the spread of the centres
constexpr double kLargestCheck = 1.25;  // factor between depth as predicted and as the photographs match

double median_of(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

double degrees_wide(const Camera& camera) {
  return 2 * std::atan(static_cast<double>(camera.width) / (2 * camera.intrinsics(0, 0))) * kDegreesPerRadian;
}

double spread_of(const std::vector<Camera>& cameras) {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  const auto count = static_cast<double>(cameras.size());
  for (const Camera& camera : cameras) middle += camera.world_from_camera.translation() / count;
  double square = 0;
  for (const Camera& camera : cameras) {
    square += (camera.world_from_camera.translation() - middle).squaredNorm() / count;
  }
  return std::sqrt(square);
}

}  // namespace

std::vector<std::string> PhotoCameras::doubts() const {
  std::vector<std::string> phrases;
  for (size_t i = 0; i < recovered.size(); ++i) {
    if (recovered[i].direction_error <= kLargestDirectionError) continue;
    phrases.push_back(fmt::format("the rays of photograph {} fit no camera to better than {:.1f} degrees", i,
                                  recovered[i].direction_error));
  }
  if (cameras.size() < 2) return phrases;
  if (!(origin_error <= kLargestOriginError * spread)) {
    phrases.push_back(fmt::format(
        "the origins of one photograph's rays scatter by {:.2g} where the cameras stand {:.2g} apart",
        origin_error, spread));
  }
  if (!depth_check) {
    phrases.emplace_back("the photographs cannot be compared under these cameras");
  } else if (const std::string doubt = doubt_about(*depth_check); !doubt.empty()) {
    phrases.push_back("the photographs do not match under these cameras: " + doubt);
  } else if (std::abs(std::log(depth_check->scale)) > std::log(kLargestCheck)) {
    phrases.push_back(
        fmt::format("the photographs match at {:.2f} times the predicted depth", depth_check->scale));
  }
  return phrases;
}

GeometryOutput geometry_of_photographs(const PipelineModels& models, const torch::Tensor& photographs,
                                       const torch::Device& device) {
  const torch::NoGradGuard no_gradients;
  GeometryInputs inputs;
  LatentGrid grid;
  {
    const auto backbone = models.backbone();
    const auto& architecture = backbone->architecture();
    grid = architecture.grid_of(photographs.size(0), photographs.size(2), photographs.size(3));
    const auto levels = backbone->encode(photographs.to(device), architecture.levels() - 1);
    for (const auto& level : levels) inputs.levels.push_back(backbone->decodable(level).patches);
    inputs.leading = levels.back().narrow(1, 0, architecture.leading_tokens()).contiguous();
  }
  GeometryOutput geometry = models.dpt_head()->forward(inputs, grid, GeometryMaps::kDepthAndRays);
  for (torch::Tensor* map :
       {&geometry.depth, &geometry.depth_confidence, &geometry.rays, &geometry.ray_confidence}) {
    *map = map->to(torch::kCPU);
  }
  return geometry;
}

PhotoCameras photo_cameras(const GeometryOutput& geometry, const torch::Tensor& photographs) {
  PhotoCameras found;
  const ImageSize size{photographs.size(3), photographs.size(2)};
  const Eigen::Vector2d middle(static_cast<double>(size.width) / 2, static_cast<double>(size.height) / 2);
  std::vector<double> origin_errors;
  for (int64_t i = 0; i < photographs.size(0); ++i) {
    try {
      found.recovered.push_back(camera_from_rays(
          to_ray_map(geometry.rays[i]), to_confidence_map(geometry.ray_confidence[i]), size, middle));
    } catch (const Error& error) {
      fail({fmt::format("photograph {}", i), "rays that a camera fits", error.parts().found,
            "use another model, or let COLMAP find the cameras"});
    }
    origin_errors.push_back(found.recovered.back().origin_error);
  }
  const Eigen::Isometry3d first_from_rays = found.recovered.front().camera.camera_from_world();
  for (const RecoveredCamera& recovered : found.recovered) {
    Camera camera = recovered.camera;
    camera.world_from_camera = first_from_rays * camera.world_from_camera;
    found.cameras.push_back(camera);
  }
  // Exactly, so that whoever reads the file sees what the world is.
  found.cameras.front().world_from_camera = Eigen::Isometry3d::Identity();
  found.spread = spread_of(found.cameras);
  found.origin_error = median_of(origin_errors);
  found.median_depth = geometry.depth.median().item<double>();
  ScaleEvidence evidence;
  evidence.camera_poses = false;
  evidence.photographs = photographs;
  const auto placement = place_geometry(geometry, found.cameras, evidence);
  if (!placement.estimates.empty()) found.depth_check = placement.estimates.front();
  return found;
}

nlohmann::ordered_json photo_cameras_json(const PhotoCameras& found, const std::vector<std::string>& names) {
  auto cameras = nlohmann::ordered_json::array();
  for (size_t i = 0; i < names.size(); ++i) {
    const RecoveredCamera& recovered = found.recovered[i];
    cameras.push_back({{"name", names[i]},
                       {"degrees_wide", degrees_wide(found.cameras[i])},
                       {"direction_error_degrees", recovered.direction_error},
                       {"origin_error", recovered.origin_error},
                       {"inliers", recovered.inliers}});
  }
  nlohmann::ordered_json json{{"cameras", cameras},
                              {"spread", found.spread},
                              {"origin_error", found.origin_error},
                              {"median_depth", found.median_depth}};
  if (found.depth_check) json["depth_check"] = depth_scale_json(*found.depth_check);
  json["doubts"] = found.doubts();
  return json;
}

std::string photo_cameras_text(const PhotoCameras& found, const std::vector<std::string>& names) {
  std::string text = "cameras estimated from the photographs:\n";
  for (size_t i = 0; i < names.size(); ++i) {
    const RecoveredCamera& recovered = found.recovered[i];
    const Eigen::Vector3d centre = found.cameras[i].world_from_camera.translation();
    text += fmt::format(
        "  {}: at ({:.3f}, {:.3f}, {:.3f}), {:.0f} degrees wide; its rays fit to {:.2f} degrees, {:.0f} % of them\n",
        names[i], centre.x(), centre.y(), centre.z(), degrees_wide(found.cameras[i]),
        recovered.direction_error, 100 * recovered.inliers);
  }
  text += fmt::format("  median depth {:.3f}; the centres are {:.3f} apart, known to {:.3f}\n",
                      found.median_depth, found.spread, found.origin_error);
  if (found.depth_check) {
    text += fmt::format("  the photographs match at {:.2f} times the predicted depth ({:.2f} to {:.2f})\n",
                        found.depth_check->scale, found.depth_check->low, found.depth_check->high);
  }
  const auto doubts = found.doubts();
  return text + (doubts.empty() ? "  these cameras are sure\n"
                                : fmt::format("  these cameras are NOT sure: {}\n", fmt::join(doubts, "; ")));
}

}  // namespace gld
