#pragma once

#include "datasets/images/image.h"
#include "datasets/scenes/seeded_random.h"

#include <cstdint>

#include <Eigen/Core>

namespace gld {

// What a camera makes of the light that it gets: of a whole scene its lens and its processing, of each frame exposure
// and noise.
struct PhotographicLook {
  double contrast = 1;                                // exponent about middle grey, of screen values
  Eigen::Vector3d balance = Eigen::Vector3d::Ones();  // factor of each channel
  double vignetting = 0;                              // loss of light in the corners, from 0 to 1
  double blur = 0;             // standard deviation of the lens's and the sensor's, pixels
  double exposure_spread = 0;  // standard deviation of the logarithm of a frame's exposure
  double noise = 0;            // standard deviation, of screen values from 0 to 1
  uint64_t seed = 0;           // of exposures and noise
};

PhotographicLook draw_photographic_look(SeededRandom& random);

// Returns the picture as that camera takes frame number `frame`.
Image photographed(const Image& picture, const PhotographicLook& look, int64_t frame);

}  // namespace gld
