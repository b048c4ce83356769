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
// brought to the unit of the cameras by the rays, as exported depth is (gld/cameras/pose_alignment.h); where the two do not
// agree well enough for that, or one source leaves the unit open, the cameras alone decide.
VisiblePairs visible_pairs(const Views& views, const GeometryOutput& source_geometry);

nlohmann::ordered_json view_pairs_json(const ViewVisibility& visibility);

}  // namespace gld
