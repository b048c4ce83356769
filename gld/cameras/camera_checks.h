#pragma once

#include "gld/cameras/camera.h"

#include <string>
#include <vector>

namespace gld {

// Refuses cameras that make no sense: sizes below one pixel, numbers that are not finite, focal lengths that are
// not positive or outside 0.001 to 10,000 image widths, intrinsics that are not those of a pinhole without skew,
// rotations that are mirrored or not orthonormal (to 1e-3). where names the camera in the Error ("scene 'door', camera
// 3").
void check_camera(const Camera& camera, const std::string& where);

// Does the same for every camera of a scene (numbered from 0 after where), and for the number of source views. Returns
// what is unusual but possible, one sentence each: a focal length outside 0.1 to 10 image widths, a principal point
// outside the image, pixels far from square, coincident camera centres.
std::vector<std::string> check_cameras(const Views& views, const std::string& where);

}  // namespace gld
