#pragma once

#include "gld/base/options.h"
#include "gld/cameras/camera.h"
#include "infer/paths/orbit_path.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

struct CameraPathOptions : OptionsGroup {
  std::string path = "orbit";
  int64_t frames = 0;
  double orbit_degrees = 0;  // 0: what is usual
  double orbit_distance = 0;
  std::vector<double> orbit_center;
  double orbit_radius = 0;

  void visit(FieldVisitor& visitor) override;
  void check() const override;  // orbit_center is a point or nothing, and not beside a distance to find it by
};

// An orbit sweeps this where nothing else is asked for. About a single photograph it is 10 degrees to either side: at
// 30 what a model guesses of its depth bends a facade into waves.
constexpr double kUsualOrbitDegrees = 60;
constexpr double kOrbitDegreesOfOnePhotograph = 20;

// The target cameras of --path: "orbit", "spline", or a cameras.json file whose cameras are taken as they are (all of
// them, or `frames` evenly spread over them). sources are the source views' cameras. Throws Error for no sources, a
// file that is not there, and more frames than a file has cameras.
struct CameraPath {
  std::vector<Camera> cameras;
  // A line that says what an orbit turns about and how that was found; empty for other paths.
  std::string note;
  std::vector<std::string>
      warnings;  // of cameras so far from all sources that nothing known can be seen from them
};
CameraPath make_camera_path(const CameraPathOptions& options, const std::vector<Camera>& sources,
                            const PathSurroundings& surroundings);

}  // namespace gld
