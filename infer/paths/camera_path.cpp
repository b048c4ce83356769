#include "infer/paths/camera_path.h"

#include "datasets/formats/cameras_json.h"
#include "gld/base/error.h"
#include "infer/paths/orbit_path.h"
#include "infer/paths/spline_path.h"

#include <filesystem>

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

}  // namespace

void CameraPathOptions::visit(FieldVisitor& visitor) {
  visitor.text({"path", "orbit, spline, or a cameras.json file with the target cameras"}, path);
  visitor.integer({"frames", "target views along the path (0: 6, or all cameras of the file)"}, frames,
                  {0, 4096});
  visitor.real({"orbit_degrees", "angle that an orbit sweeps; 360 closes it"}, orbit_degrees, {-360, 360});
  visitor.real(
      {"orbit_distance",
       "distance of the point an orbit looks at, used where the sources look in parallel (0: estimated)"},
      orbit_distance, {0, 1e9});
}

std::vector<Camera> make_camera_path(const CameraPathOptions& options, const std::vector<Camera>& sources,
                                     double typical_depth) {
  if (sources.empty()) fail({"camera path", "at least one source camera", "none", "name the sources"});
  const int64_t frames = options.frames == 0 ? kDefaultFrames : options.frames;
  if (options.path == "orbit") {
    OrbitShape shape;
    shape.frames = frames;
    shape.degrees = options.orbit_degrees;
    shape.fallback_distance = options.orbit_distance > 0 ? options.orbit_distance : typical_depth;
    return orbit_cameras(sources, shape);
  }
  if (options.path == "spline") return spline_cameras(sources, frames);
  return path_from_file(options.path, options.frames);
}

}  // namespace gld
