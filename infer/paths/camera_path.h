#pragma once

#include "gld/base/options.h"
#include "gld/cameras/camera.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

struct CameraPathOptions : OptionsGroup {
  std::string path = "orbit";
  int64_t frames = 0;
  double orbit_degrees = 60;
  double orbit_distance = 0;

  void visit(FieldVisitor& visitor) override;
};

// The target cameras of --path: "orbit", "spline", or a cameras.json file whose cameras are taken as they are (all of
// them, or `frames` evenly spread over them). sources are the source views' cameras; typical_depth is a depth of the
// scene in the unit of the poses, 0 where none is known. Throws Error for no sources, a file that is not there, and
// more frames than a file has cameras.
std::vector<Camera> make_camera_path(const CameraPathOptions& options, const std::vector<Camera>& sources,
                                     double typical_depth);

}  // namespace gld
