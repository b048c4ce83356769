#pragma once

#include "gld/cameras/camera.h"
#include "gld/photogrammetry/depth_scale.h"
#include "gld/photogrammetry/planar_depth.h"

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace gld {

// A view as the search for the scale sees it.
struct PicturedView {
  Camera camera;      // in the world
  PlanarDepth depth;  // in the geometry model's unit, the same for all views; covers the picture evenly
  int64_t width = 0;  // of the picture, pixels; it covers the camera's picture evenly
  int64_t height = 0;
  std::vector<float>
      rgb;  // the photograph, (height, width, 3) in [0, 1]; empty where the view was not photographed
};

// Returns the scale at which depth carries photographs to where other photographs show the same (triangulation by
// matching). For every candidate scale two photographs are warped into a view by its depth and the cameras (a
// photographed view takes its own as it is), and windows of 7x7 pixels are compared by their normalised correlation;
// what a window says of its own depth is one observation of a ScaleConsensus. So depth of views that were not
// photographed is asked as well. The candidates reach from where parallax is about as large as the picture to where it
// is one pixel. Pictures are reduced to at most 128 pixels a side. Returns nothing where the photographs were taken at
// one place, or too little texture is seen twice.
std::optional<DepthScale> scale_from_photo_consistency(const std::vector<PicturedView>& views,
                                                       const std::string& estimator);

// A view, and the two photographs that are compared in it.
struct ComparedPhotographs {
  size_t view = 0;
  size_t first = 0;  // the view itself where it was photographed
  size_t second = 0;
};

// Returns at most 24 comparisons: each view's nearest photographs, each with the one next to it that stands apart from
// it by more than a hundredth of the largest distance between photographs.
std::vector<ComparedPhotographs> comparisons_of(const std::vector<Camera>& cameras,
                                                const std::vector<bool>& photographed);

}  // namespace gld
