#pragma once

#include "datasets/images/image.h"

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

namespace gld {

// Places of a picture that other pictures of them show alike: SIFT (Lowe 2004), strongest first.
struct PictureFeatures {
  // From the picture's middle, over its longer side: so positions of one lens are comparable whatever the sizes.
  std::vector<Eigen::Vector2d> points;
  std::vector<float> descriptors;  // (points, 128), of unit length: RootSIFT (Arandjelovic & Zisserman 2012)
  double searched_side = 0;        // longer side of the picture as it was searched, pixels

  int64_t size() const { return static_cast<int64_t>(points.size()); }
};

// picture is upright. Larger ones are searched at longest_side, which is no less exact than many photographs are sharp.
PictureFeatures picture_features(const Image& picture, int64_t longest_side, int64_t most_features);

struct FeatureMatch {
  int32_t first = 0;
  int32_t second = 0;
};

// Returns mutual nearest neighbours whose distance is below 0.8 of that to the second nearest, in the order of the
// first picture's features. threads are those of the products.
std::vector<FeatureMatch> match_features(const PictureFeatures& first, const PictureFeatures& second,
                                         int threads);

}  // namespace gld
