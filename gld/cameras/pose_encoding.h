#pragma once

#include "gld/cameras/camera.h"
#include "gld/cameras/image_size.h"

#include <array>

namespace gld {

// A camera as the nine numbers that networks are told and tell: its centre in the world (3), the quaternion x, y, z, w
// of world_from_camera, and the vertical and the horizontal field of view in radians. They do not depend on the size of
// the image in pixels, and take the principal point to be in the image's middle: where it is elsewhere, the fields of
// view are those of a centred image with the same focal lengths.
using PoseEncoding = std::array<double, 9>;

// The quaternion has length 1 and w >= 0.
PoseEncoding pose_encoding(const Camera& camera);

// The quaternion may have any length but 0. Fields of view at or beyond 0 and pi have no focal length: the tangent of
// half of them is kept at 1e-6 or above. Throws Error where a number is not finite or the quaternion is 0.
Camera camera_of_pose_encoding(const PoseEncoding& encoding, const ImageSize& size);

}  // namespace gld
