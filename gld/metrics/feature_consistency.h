#pragma once

#include "gld/cameras/camera.h"

#include <torch/types.h>

namespace gld {

struct FeatureView {
  torch::Tensor features;  // (channels, rows, columns), covering the picture evenly
  torch::Tensor depth;     // (height, width), planar, in the unit of the cameras; of the camera's size
  Camera camera;
};

struct FeatureConsistency {
  double distance = 0;  // mean of 1 - cosine over the pixels that both cover: 0 to 2; NaN where none
  double coverage = 0;  // of the first view's pixels with known depth, how many the other one covers
};

// MEt3R's formula (Asim et al. 2025) with whatever features, depth and cameras are given; it is MEt3R only with
// MASt3R's points and FeatUp's DINO features. The other view's pixels are lifted and drawn into the first one, the
// nearest point of a pixel counts, and its features, bilinear at full resolution, are compared with the first view's:
// sum of mask * (1 - cosine) over sum of mask + 1e-5. Nothing tells hidden points, as in MEt3R. A wrong geometry that
// covers little may look consistent: `coverage` stands beside.
FeatureConsistency feature_consistency(const FeatureView& first, const FeatureView& other);

}  // namespace gld
