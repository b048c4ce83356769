#pragma once

#include "gld/splatting/compositing.h"

#include <cstdint>

#include <torch/types.h>

namespace gld {

// What a view shows of a set, front to back, as float32 tensors: a rival's input.
struct DenseSplats {
  torch::Tensor places;     // (splats, 2) pixels
  torch::Tensor conics;     // (splats, 3): Q_xx, Q_xy, Q_yy
  torch::Tensor opacities;  // (splats)
  torch::Tensor features;   // (splats, channels)
  int64_t width = 0, height = 0;
  double least_alpha = 0, least_transmittance = 0;  // ProjectionOptions
};
DenseSplats dense_splats(const GaussianSet& set, const SplatView& view, const SplatFeatures& features);

struct DenseRendering {
  torch::Tensor picture;  // (channels, height, width)
  // d sum of of_picture times picture / d the inputs; undefined where none was asked for.
  torch::Tensor of_places, of_conics, of_opacities, of_features;
  double forward_seconds = 0;
  double backward_seconds = 0;  // 0 without gradients
};
// This composites by LibTorch's operations, every pixel against every Gaussian, with the bounds of compositing.h: it
// takes blocks of pixels of which a tensor has some millions of numbers, and the backward pass is by autograd.
// of_picture is (channels, height, width), or undefined for the picture alone.
DenseRendering render_densely(const DenseSplats& splats, const torch::Tensor& of_picture);

}  // namespace gld
