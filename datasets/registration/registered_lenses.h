#pragma once

#include "datasets/registration/registration.h"

#include <cstdint>
#include <vector>

namespace gld {

// Returns the median of what EXIF says of the photographs of a lens, over their longer side; 0 where it says nothing.
double exif_focal_length(const std::vector<UnregisteredPhotograph>& photographs, int64_t lens);

// Returns the camera of an upright photograph, whose focal length is given over its longer side.
LensCamera lens_camera(const UnregisteredPhotograph& photograph, double focal_length, double k1);

// Adds the lenses of the photographs that registered, from their cameras.
void add_lenses(Registration& registration, const std::vector<UnregisteredPhotograph>& photographs);

}  // namespace gld
