#pragma once

#include "gld/splatting/naive_splatting.h"

#include <cstdint>
#include <vector>

namespace gld {

// All Gaussians of a set that project, in double.
struct NaiveView {
  NaiveScene scene;
  std::vector<int64_t> index;
  std::vector<ProjectedGaussian> projected;
};
inline NaiveView naive_view(const std::vector<GaussianShape>& shapes, const SplatCamera& camera) {
  NaiveView view;
  view.scene.width = camera.width;
  view.scene.height = camera.height;
  for (size_t i = 0; i < shapes.size(); ++i) {
    ProjectedGaussian projected;
    if (!project_gaussian(shapes[i], camera, projected)) continue;
    view.index.push_back(static_cast<int64_t>(i));
    view.projected.push_back(projected);
    view.scene.splats.push_back(naive_splat(projected));
  }
  return view;
}
inline std::vector<GaussianShape> shapes_of(const GaussianSet& set) {
  std::vector<GaussianShape> shapes;
  for (int64_t i = 0; i < set.size(); ++i) shapes.push_back(gaussian_shape(set, i));
  return shapes;
}

inline void give_features(NaiveView& view, const std::vector<float>& features, int64_t channels) {
  view.scene.channels = channels;
  view.scene.features.clear();
  for (const int64_t i : view.index) {
    for (int64_t c = 0; c < channels; ++c)
      view.scene.features.push_back(features[static_cast<size_t>(i * channels + c)]);
  }
}

}  // namespace gld
