#include "infer/pipeline/depth_scale.h"

#include "gld/base/error.h"
#include "infer/pipeline/predicted_cameras.h"

namespace gld {

DepthScale depth_scale_of(const GeometryOutput& geometry, const std::vector<Camera>& cameras,
                          const ImageSize& picture) {
  DepthScale found;
  try {
    found.predicted_cameras = predicted_cameras(geometry, picture);
    found.alignment = align_poses(found.predicted_cameras, cameras);
  } catch (const Error& error) {
    found.unknown_because = "no camera fits the predicted rays";
    found.detail = error.what();
    return found;
  }
  if (found.alignment->scale_known) {
    found.scale = found.alignment->b_from_a.scale;
  } else {
    found.unknown_because = "the cameras do not tell the scale of the predicted depth";
  }
  return found;
}

}  // namespace gld
