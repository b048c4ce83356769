#pragma once

#include "gld/cameras/camera.h"

#include <cstdint>
#include <vector>

namespace gld {

// Returns a camera of a smooth path through cameras: centres go by a Catmull-Rom spline (Catmull and Rom 1974),
// rotations by spherical quadrangle interpolation (Shoemake 1987), focal lengths geometrically and principal points
// linearly. position runs from 0 (the first camera) to cameras.size() - 1 (the last one); whole numbers give those
// cameras exactly, up to rounding. The size is the first camera's; other cameras' intrinsics are scaled to it.
Camera spline_camera(const std::vector<Camera>& cameras, double position);

// Returns where `frames` cameras stand on that path: evenly apart between its ends, and as far from the given cameras
// as so many can be, so that few new views copy a photograph. Positions are increasing, within [0, cameras - 1].
std::vector<double> positions_between(int64_t cameras, int64_t frames);

// Returns the cameras there. Throws Error for fewer than two cameras.
std::vector<Camera> spline_cameras(const std::vector<Camera>& cameras, int64_t frames);

}  // namespace gld
