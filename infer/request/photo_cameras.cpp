#include "infer/request/photo_cameras.h"

#include "gld/base/error.h"
#include "gld/cameras/angles.h"
#include "gld/photogrammetry/photo_consistency.h"
#include "infer/request/scale_evidence.h"
#include "models/scene_geometry/geometry_placement.h"
#include "models/scene_geometry/predicted_cameras.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {
namespace {

constexpr double kLargestDirectionError = 5;  // degrees, as the median over a photograph's rays
constexpr double kLargestOriginError = 0.3;   // of the spread of the centres
constexpr double kLargestFocalSpread = 1.5;   // between photographs of one lens, or EXIF and model
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

// focal_length is in pixels, of both directions, where it is known.
RecoveredCamera recovered_camera(const GeometryOutput& geometry, size_t photograph, const ImageSize& size,
                                 const std::optional<double>& focal_length) {
  const auto row = static_cast<int64_t>(photograph);
  KnownIntrinsics known;
  known.principal_point = {static_cast<double>(size.width) / 2, static_cast<double>(size.height) / 2};
  if (focal_length) known.focal_lengths = Eigen::Vector2d::Constant(*focal_length);
  try {
    return camera_from_rays(to_ray_map(geometry.rays[row]), to_confidence_map(geometry.ray_confidence[row]),
                            size, known);
  } catch (const Error& error) {
    fail({fmt::format("photograph {}", photograph), "rays that a camera fits", error.parts().found,
          "use another model, or let COLMAP find the cameras"});
  }
}

double focal_length_of(const RecoveredCamera& recovered) {
  const Eigen::Matrix3d& intrinsics = recovered.camera.intrinsics;
  return std::sqrt(intrinsics(0, 0) * intrinsics(1, 1));
}

// The lens is that of photographs whose cameras were found each for itself.
SharedLens shared_lens(const std::vector<RecoveredCamera>& recovered,
                       const std::vector<PhotographLens>& lenses, const std::vector<size_t>& photographs) {
  std::vector<double> logs;
  logs.reserve(photographs.size());
  for (const size_t i : photographs) {
    logs.push_back(std::log(focal_length_of(recovered[i]) / lenses[i].longer_side));
  }
  std::sort(logs.begin(), logs.end());
  SharedLens shared;
  shared.photographs = photographs;
  shared.exif_focal_length = lenses[photographs.front()].exif_focal_length;
  shared.seen_focal_length = std::exp(0.5 * (logs[(logs.size() - 1) / 2] + logs[logs.size() / 2]));
  shared.lowest = std::exp(logs.front());
  shared.highest = std::exp(logs.back());
  return shared;
}

// Returns the doubt about all photographs in which EXIF is far from what the model sees, or rays that fit a camera do
// not fit that of EXIF; it is empty where there are none.
std::string exif_doubt(const std::vector<PhotographFocalLength>& focal_lengths,
                       const std::vector<RecoveredCamera>& recovered) {
  std::vector<size_t> photographs;
  double lowest = std::numeric_limits<double>::infinity(), highest = 0;
  for (size_t i = 0; i < focal_lengths.size(); ++i) {
    if (focal_lengths[i].by_exif <= 0) continue;
    const double factor = focal_lengths[i].by_exif / focal_lengths[i].seen;
    const bool fits = recovered[i].direction_error <= kLargestDirectionError ||
                      focal_lengths[i].direction_error > kLargestDirectionError;
    if (fits && std::max(factor, 1 / factor) <= kLargestFocalSpread) continue;
    photographs.push_back(i);
    lowest = std::min(lowest, factor);
    highest = std::max(highest, factor);
  }
  if (photographs.empty()) return "";
  std::string factors = fmt::format("{:.2f}", lowest);
  if (const auto largest = fmt::format("{:.2f}", highest); largest != factors) factors += " to " + largest;
  return fmt::format(
      "by EXIF the focal length of {} is {} times what the model sees{} (without EXIF the model's is taken)",
      photographs.size() == 1 ? fmt::format("photograph {}", photographs.front())
                              : fmt::format("{} photographs", photographs.size()),
      factors, highest < 1 ? ", as in pictures that were cropped" : "");
}

// Both are said: which of them is right, who took the photograph knows.
std::string focal_length_text(const PhotographFocalLength& focal_length) {
  if (focal_length.by_exif <= 0) {
    return fmt::format("the model sees a focal length of {:.0f} px; EXIF names none", focal_length.seen);
  }
  return fmt::format("focal length {:.0f} px by EXIF; the model sees {:.0f} px", focal_length.by_exif,
                     focal_length.seen);
}

std::string shared_lens_text(const SharedLens& lens) {
  std::string seen = fmt::format("{:.3f} to {:.3f} by each alone", lens.lowest, lens.highest);
  if (lens.exif_focal_length > 0) {
    seen = fmt::format("by EXIF; the model sees {:.3f}, {}", lens.seen_focal_length, seen);
  }
  return fmt::format("one lens took {} of them: its focal length is {:.3f} of the longer side ({})",
                     lens.photographs.size(), lens.focal_length(), seen);
}

}  // namespace

std::vector<std::string> PhotoCameras::doubts() const {
  std::vector<std::string> phrases;
  for (size_t i = 0; i < recovered.size(); ++i) {
    // EXIF may contradict rays that are those of a camera: that is another doubt.
    const double error =
        focal_lengths[i].by_exif > 0 ? focal_lengths[i].direction_error : recovered[i].direction_error;
    if (error <= kLargestDirectionError) continue;
    phrases.push_back(
        fmt::format("the rays of photograph {} fit no camera to better than {:.1f} degrees", i, error));
  }
  if (std::string doubt = exif_doubt(focal_lengths, recovered); !doubt.empty())
    phrases.push_back(std::move(doubt));
  for (const SharedLens& lens : lenses) {
    if (lens.exif_focal_length > 0 || lens.highest <= kLargestFocalSpread * lens.lowest) continue;
    phrases.push_back(fmt::format(
        "the {} photographs of one lens ask for focal lengths from {:.2f} to {:.2f} of their longer "
        "side (--photo-lens own gives each its own)",
        lens.photographs.size(), lens.lowest, lens.highest));
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

PhotoCameras photo_cameras(const GeometryOutput& geometry, const torch::Tensor& photographs,
                           const std::vector<PhotographLens>& lenses) {
  if (!lenses.empty() && static_cast<int64_t>(lenses.size()) != photographs.size(0)) {
    fail({"photographs", fmt::format("a lens for each of {}", photographs.size(0)),
          std::to_string(lenses.size()), "check what took them"});
  }
  PhotoCameras found;
  const ImageSize size{photographs.size(3), photographs.size(2)};
  for (size_t i = 0; i < static_cast<size_t>(photographs.size(0)); ++i) {
    found.recovered.push_back(recovered_camera(geometry, i, size, {}));
    const PhotographLens lens = lenses.empty() ? PhotographLens() : lenses[i];
    found.focal_lengths.push_back({lens.exif_focal_length * lens.longer_side * lens.taken_pixels,
                                   focal_length_of(found.recovered.back()) * lens.taken_pixels,
                                   found.recovered.back().direction_error});
  }
  std::map<int64_t, std::vector<size_t>> photographs_of;
  for (size_t i = 0; i < lenses.size(); ++i) photographs_of[lenses[i].number].push_back(i);
  for (const auto& [number, taken] : photographs_of) {
    const SharedLens shared = shared_lens(found.recovered, lenses, taken);
    if (taken.size() < 2 && shared.exif_focal_length <= 0) continue;
    for (const size_t i : taken) {
      found.recovered[i] = recovered_camera(geometry, i, size, shared.focal_length() * lenses[i].longer_side);
    }
    if (taken.size() > 1) found.lenses.push_back(shared);
  }
  std::vector<double> origin_errors;
  for (const RecoveredCamera& recovered : found.recovered) origin_errors.push_back(recovered.origin_error);
  const Eigen::Isometry3d first_from_rays = found.recovered.front().camera.camera_from_world();
  for (const RecoveredCamera& recovered : found.recovered) {
    Camera camera = recovered.camera;
    camera.world_from_camera = first_from_rays * camera.world_from_camera;
    found.cameras.push_back(camera);
  }
  // This makes it exact, so that whoever reads the file sees what the world is.
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
    nlohmann::ordered_json camera{{"name", names[i]}, {"degrees_wide", degrees_wide(found.cameras[i])}};
    const PhotographFocalLength& focal_length = found.focal_lengths[i];
    if (focal_length.by_exif > 0) camera["exif_focal_length_pixels"] = focal_length.by_exif;
    camera["seen_focal_length_pixels"] = focal_length.seen;
    camera["direction_error_degrees"] = recovered.direction_error;
    camera["origin_error"] = recovered.origin_error;
    camera["inliers"] = recovered.inliers;
    cameras.push_back(camera);
  }
  auto lenses = nlohmann::ordered_json::array();
  for (const SharedLens& lens : found.lenses) {
    nlohmann::ordered_json entry{{"photographs", lens.photographs}, {"focal_length", lens.focal_length()}};
    if (lens.exif_focal_length > 0) entry["exif_focal_length"] = lens.exif_focal_length;
    entry["seen_focal_length"] = lens.seen_focal_length;
    entry["alone"] = {lens.lowest, lens.highest};
    lenses.push_back(entry);
  }
  nlohmann::ordered_json json{{"cameras", cameras},
                              {"shared_lenses", lenses},
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
        "  {}: at ({:.3f}, {:.3f}, {:.3f}), {:.0f} degrees wide ({}); its rays fit to {:.2f} degrees, "
        "{:.0f} % of them\n",
        names[i], centre.x(), centre.y(), centre.z(), degrees_wide(found.cameras[i]),
        focal_length_text(found.focal_lengths[i]), recovered.direction_error, 100 * recovered.inliers);
  }
  for (const SharedLens& lens : found.lenses) text += "  " + shared_lens_text(lens) + "\n";
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
