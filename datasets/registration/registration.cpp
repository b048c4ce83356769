#include "datasets/registration/registration.h"

#include "gld/base/error.h"
#include "gld/base/printable_text.h"
#include "gld/cameras/angles.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {
namespace {

double degrees_wide(const LensCamera& camera) {
  return 2 * std::atan(static_cast<double>(camera.width) / (2 * camera.intrinsics(0, 0))) * kDegreesPerRadian;
}

std::string lens_origin(const RegisteredLens& lens) {
  if (lens.exif_focal_length == 0) return "from what the photographs share; EXIF names none";
  return fmt::format("EXIF says {:.3f}, refined by what the photographs share", lens.exif_focal_length);
}

}  // namespace

int64_t Registration::registered() const {
  return std::count_if(photographs.begin(), photographs.end(),
                       [](const RegisteredPhotograph& photograph) { return photograph.registered; });
}

void normalise(Registration& registration, std::vector<double> depths) {
  auto& photographs = registration.photographs;
  const auto first =
      std::find_if(photographs.begin(), photographs.end(),
                   [](const RegisteredPhotograph& photograph) { return photograph.registered; });
  if (first == photographs.end() || depths.empty()) return;
  const auto middle = depths.begin() + static_cast<std::ptrdiff_t>(depths.size() / 2);
  std::nth_element(depths.begin(), middle, depths.end());
  const double unit = *middle;
  const Eigen::Isometry3d first_from_world = first->world_from_camera.inverse();
  for (RegisteredPhotograph& photograph : photographs) {
    if (!photograph.registered) continue;
    photograph.world_from_camera = first_from_world * photograph.world_from_camera;
    photograph.world_from_camera.translation() /= unit;
  }
  // Exactly, so that whoever reads the file sees what the world is.
  first->world_from_camera = Eigen::Isometry3d::Identity();
  for (Eigen::Vector3d& point : registration.points_in_world) point = first_from_world * point / unit;
}

void add_doubts(Registration& registration) {
  // Over the longer side: 150 degrees wide, and the longest lens that people photograph places with.
  constexpr double kShortestUsual = 0.13, kLongestUsual = 6;
  constexpr size_t kFewPoints = 30;
  for (const RegisteredLens& lens : registration.lenses) {
    if (lens.focal_length >= kShortestUsual && lens.focal_length <= kLongestUsual) continue;
    registration.doubts.push_back(fmt::format(
        "a focal length of {:.3g} of the longer side is that of no usual lens", lens.focal_length));
  }
  if (registration.points_in_world.size() < kFewPoints) {
    registration.doubts.push_back(
        fmt::format("they hang on {} points that photographs share", registration.points_in_world.size()));
  }
}

void require_several(const std::vector<UnregisteredPhotograph>& photographs, const std::string& where) {
  if (photographs.size() >= 2) return;
  fail({where, "two photographs or more, which show something in common",
        photographs.empty() ? "none" : "one", "add photographs of the same place from other places in it"});
}

void require_registered(const Registration& registration,
                        const std::vector<UnregisteredPhotograph>& photographs, const std::string& where) {
  if (registration.registered() >= 2) return;
  constexpr size_t kNamed = 3;
  std::vector<std::string> reasons;
  for (size_t i = 0; i < photographs.size() && reasons.size() < kNamed; ++i) {
    if (registration.photographs[i].reason.empty()) continue;
    reasons.push_back(printable_text(photographs[i].name) + ": " + registration.photographs[i].reason);
  }
  fail({where, "at least two photographs that show one place from several places in it",
        fmt::format("none of {} that fit together ({}{})", photographs.size(), fmt::join(reasons, "; "),
                    photographs.size() > kNamed ? "; ..." : ""),
        "add photographs between them, with steps to the side"});
}

IdealPhotograph ideal_photograph(const RegisteredPhotograph& photograph, const Image& upright) {
  IdealPhotograph ideal;
  ideal.camera.width = upright.width;
  ideal.camera.height = upright.height;
  ideal.camera.intrinsics = photograph.camera.intrinsics;
  ideal.camera.world_from_camera = photograph.world_from_camera;
  if (photograph.camera.lens.ideal()) {
    ideal.image = upright;
    return ideal;
  }
  ideal.camera = cropped_to_source(ideal.camera, photograph.camera);
  ideal.image = make_undistorter(ideal.camera, photograph.camera)->image(upright);
  return ideal;
}

nlohmann::ordered_json registration_json(const Registration& registration,
                                         const std::vector<UnregisteredPhotograph>& photographs) {
  auto cameras = nlohmann::ordered_json::array();
  for (size_t i = 0; i < photographs.size(); ++i) {
    const RegisteredPhotograph& found = registration.photographs[i];
    nlohmann::ordered_json camera{{"name", photographs[i].name}, {"registered", found.registered}};
    if (found.registered) {
      camera["lens"] = photographs[i].lens;
      camera["degrees_wide"] = degrees_wide(found.camera);
      camera["points"] = found.points;
      camera["reprojection_error_pixels"] = found.reprojection_error;
    } else {
      camera["reason"] = found.reason;
    }
    cameras.push_back(camera);
  }
  auto lenses = nlohmann::ordered_json::array();
  for (const RegisteredLens& lens : registration.lenses) {
    nlohmann::ordered_json entry{
        {"number", lens.number}, {"photographs", lens.photographs}, {"focal_length", lens.focal_length}};
    if (lens.exif_focal_length > 0) entry["exif_focal_length"] = lens.exif_focal_length;
    entry["k1"] = lens.distortion.k1;
    lenses.push_back(entry);
  }
  return {{"from", registration.way},
          {"cameras", cameras},
          {"lenses", lenses},
          {"points", registration.points_in_world.size()},
          {"reprojection_error_pixels", registration.reprojection_error},
          {"doubts", registration.doubts}};
}

std::string registration_text(const Registration& registration,
                              const std::vector<UnregisteredPhotograph>& photographs) {
  std::string text =
      fmt::format("cameras of {} of {} photographs by {}: {} points, which fit to {:.2f} pixels\n",
                  registration.registered(), photographs.size(),
                  registration.way == "colmap" ? "COLMAP" : "features that they share",
                  registration.points_in_world.size(), registration.reprojection_error);
  for (size_t i = 0; i < photographs.size(); ++i) {
    const RegisteredPhotograph& found = registration.photographs[i];
    const std::string name = printable_text(photographs[i].name);
    if (!found.registered) {
      text += fmt::format("  {}: left out, {}\n", name, found.reason);
      continue;
    }
    const Eigen::Vector3d centre = found.world_from_camera.translation();
    text += fmt::format(
        "  {}: at ({:.3f}, {:.3f}, {:.3f}), {:.0f} degrees wide; {} points fit to {:.2f} pixels\n", name,
        centre.x(), centre.y(), centre.z(), degrees_wide(found.camera), found.points,
        found.reprojection_error);
  }
  for (const RegisteredLens& lens : registration.lenses) {
    text += fmt::format("  the lens of {} of them: its focal length is {:.3f} of the longer side ({})\n",
                        lens.photographs, lens.focal_length, lens_origin(lens));
  }
  for (const std::string& doubt : registration.doubts)
    text += "  these cameras are NOT sure: " + doubt + "\n";
  return text;
}

std::vector<std::string> registration_warnings(const Registration& registration,
                                               const std::vector<UnregisteredPhotograph>& photographs) {
  std::vector<std::string> warnings;
  for (size_t i = 0; i < photographs.size(); ++i) {
    if (registration.photographs[i].registered) continue;
    warnings.push_back(fmt::format("photograph '{}' is left out: {}", printable_text(photographs[i].name),
                                   registration.photographs[i].reason));
  }
  for (const std::string& doubt : registration.doubts) {
    warnings.push_back("the cameras of the photographs are not sure: " + doubt);
  }
  return warnings;
}

}  // namespace gld
