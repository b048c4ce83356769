#include "infer/paths/camera_path.h"

#include "datasets/formats/cameras_json.h"
#include "gld/base/error.h"
#include "infer/paths/spline_path.h"

#include <algorithm>
#include <filesystem>
#include <limits>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr int64_t kDefaultFrames = 6;

std::vector<Camera> path_from_file(const std::string& path, int64_t frames) {
  if (!std::filesystem::is_regular_file(path)) {
    fail({"--path", "orbit, spline or a cameras.json file", "\"" + path + "\", which is no file",
          "check the name"});
  }
  const CameraList list = read_cameras_json(path);
  const auto available = static_cast<int64_t>(list.records.size());
  if (frames > available) {
    fail({"--frames", "at most the " + std::to_string(available) + " cameras of " + path,
          std::to_string(frames), "ask for fewer frames"});
  }
  const int64_t count = frames == 0 ? available : frames;
  std::vector<Camera> cameras;
  for (int64_t i = 0; i < count; ++i) {
    const int64_t record = count == 1 ? 0 : i * (available - 1) / (count - 1);
    cameras.push_back(list.records[static_cast<size_t>(record)].camera);
  }
  return cameras;
}

// The path's cameras may lie anywhere; one that stands beyond anything that the sources can have seen is a slip of the
// hand or of units.
void warn_of_distance(const CameraPathOptions& options, const std::vector<Camera>& sources,
                      const PathSurroundings& surroundings, CameraPath& path) {
  constexpr double kFarAway = 100;
  const double reach = known_reach(sources, surroundings);
  if (reach == 0) return;  // without a baseline or a depth the poses' unit says nothing
  size_t farthest = 0;
  double largest = 0;
  for (size_t i = 0; i < path.cameras.size(); ++i) {
    double nearest = std::numeric_limits<double>::infinity();
    for (const Camera& source : sources) {
      nearest = std::min(
          nearest,
          (path.cameras[i].world_from_camera.translation() - source.world_from_camera.translation()).norm());
    }
    if (nearest <= largest) continue;
    largest = nearest;
    farthest = i;
  }
  if (!(largest > kFarAway * reach)) return;
  path.warnings.push_back(fmt::format(
      "Camera {} of the path is {:.3g} away from the nearest source, where the scene is known to reach {:.3g}: the "
      "sources show nothing of what it sees; look at {}.",
      farthest, largest, reach,
      options.path == "orbit" ? "--orbit-radius, --orbit-center and --orbit-distance"
                              : "the unit of " + options.path));
}

}  // namespace

void CameraPathOptions::visit(FieldVisitor& visitor) {
  visitor.text({"path", "orbit, spline, or a cameras.json file with the target cameras"}, path);
  visitor.integer({"frames", "target views along the path (0: 6, or all cameras of the file)"}, frames,
                  {0, 4096});
  visitor.real(
      {"orbit_degrees", "angle that an orbit sweeps (0: 60, about a single photograph 20); 360 closes it"},
      orbit_degrees, {-360, 360});
  visitor.real({"orbit_distance",
                "about how far away what an orbit turns about is, where that is known (0: estimated)"},
               orbit_distance, {0, 1e9});
  visitor.reals({"orbit_center", "point that an orbit turns about, x,y,z in the scene; empty: found"},
                orbit_center, {-1e12, 1e12});
  visitor.real({"orbit_radius", "of an orbit's circle, in the scene's unit (0: the sources' mean distance)"},
               orbit_radius, {0, 1e12});
}

void CameraPathOptions::check() const {
  if (orbit_center.empty()) return;
  if (orbit_center.size() != 3) {
    fail({"--orbit-center", "three numbers, x,y,z in the scene", std::to_string(orbit_center.size()),
          "write for example --orbit-center 0,0,2.5"});
  }
  if (orbit_distance > 0) {
    fail({"--orbit-center, --orbit-distance", "one of the two", "both",
          "leave out the distance, which is only for finding the centre"});
  }
}

CameraPath make_camera_path(const CameraPathOptions& options, const std::vector<Camera>& sources,
                            const PathSurroundings& surroundings) {
  if (sources.empty()) fail({"camera path", "at least one source camera", "none", "name the sources"});
  const int64_t frames = options.frames == 0 ? kDefaultFrames : options.frames;
  if (options.path == "orbit") {
    PathSurroundings known = surroundings;
    if (options.orbit_distance > 0) known.typical_depth = options.orbit_distance;
    OrbitCentre centre = orbit_centre(sources, known);
    if (!options.orbit_center.empty()) {
      centre = {Eigen::Map<const Eigen::Vector3d>(options.orbit_center.data()), "as asked for"};
    }
    OrbitShape shape;
    shape.frames = frames;
    shape.degrees = options.orbit_degrees == 0 ? kUsualOrbitDegrees : options.orbit_degrees;
    shape.centre = centre.x_in_world;
    shape.radius = options.orbit_radius;
    CameraPath path;
    path.cameras = orbit_cameras(sources, shape);
    const double away = (path.cameras.front().world_from_camera.translation() - centre.x_in_world).norm();
    path.note = fmt::format(
        "orbit about ({:.4g}, {:.4g}, {:.4g}), {:.4g} away: {} (--orbit-center, --orbit-radius)",
        centre.x_in_world.x(), centre.x_in_world.y(), centre.x_in_world.z(), away, centre.found_by);
    warn_of_distance(options, sources, known, path);
    return path;
  }
  if (options.path == "spline") return {spline_cameras(sources, frames), "", {}};
  CameraPath path{path_from_file(options.path, options.frames), "", {}};
  warn_of_distance(options, sources, surroundings, path);
  return path;
}

}  // namespace gld
