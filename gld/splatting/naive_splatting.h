#pragma once

#include "gld/splatting/projection.h"

#include <cstdint>
#include <vector>

namespace gld {

// Splatting as its formulas stand, in double, every pixel against every Gaussian: what the fast one is compared with.
struct NaiveSplat {
  double depth = 0;
  double mean[2] = {0, 0};
  double covariance[3] = {0, 0, 0};  // xx, xy, yy
  double determinant = 0;
  double opacity = 0;
};
NaiveSplat naive_splat(const ProjectedGaussian& projected);

struct NaiveScene {
  std::vector<NaiveSplat> splats;  // in any order; drawn by depth, equal ones in this order
  int64_t channels = 0;
  std::vector<double> features;    // (splats, channels)
  std::vector<double> background;  // (channels)
  int64_t width = 0, height = 0;
  ProjectionOptions options;  // of which the bounds count
  HeldAlphaGradient held_alpha_gradient = HeldAlphaGradient::kNone;
};

struct NaiveImage {
  std::vector<double> values;         // (channels, height, width)
  std::vector<double> transmittance;  // (height, width)
  // (height, width): how near a pixel is to a place where the formulas jump (alpha at least_alpha or .99,
  // transmittance at least_transmittance), as the least relative distance.
  std::vector<double> to_jump;
};
NaiveImage render_naively(const NaiveScene& scene);

struct NaiveGradients {
  std::vector<NaiveSplat>
      splats;  // depth is 0; covariance as in ProjectedGradient; opacity is d loss / d log opacity
  std::vector<double> features;
};
NaiveGradients render_naively_backward(const NaiveScene& scene, const std::vector<double>& of_image);

}  // namespace gld
