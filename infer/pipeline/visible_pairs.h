#pragma once

#include "gld/cameras/view_visibility.h"
#include "models/decoders/geometry_head.h"

#include <string>
#include <vector>

#include <torch/types.h>

#include <nlohmann/json.hpp>

namespace gld {

// Which view pairs attend (`view_pairs: visible`), and what was unusual, one sentence each.
struct VisiblePairs {
  ViewVisibility visibility;
  std::vector<std::string> warnings;

  // What DitSceneInputs::view_mask takes: bool (views, views) on the CPU; undefined where every pair attends, so that
  // such a scene computes exactly what it would without looking.
  torch::Tensor view_mask() const;
};

// From the cameras alone.
VisiblePairs visible_pairs(const Views& views);

// From cameras and the DPT head's depth and rays of the source views (N, height, width; num_sources = N). Depth is
// brought to the unit of the cameras as exported depth is (models/scene_geometry/geometry_placement.h), by the rays
// and by the photographs, (N, 3, height, width) or undefined; where neither tells it, the cameras alone decide.
VisiblePairs visible_pairs(const Views& views, const GeometryOutput& source_geometry,
                           const torch::Tensor& photographs = {});

nlohmann::ordered_json view_pairs_json(const ViewVisibility& visibility);

}  // namespace gld
