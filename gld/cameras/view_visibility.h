#pragma once

#include "gld/cameras/camera.h"

#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// Planar depth of a view, row by row, in the unit of its camera's pose. Its pixels cover the image evenly; values that
// are not finite and positive are not known.
struct PlanarDepth {
  int64_t width = 0;
  int64_t height = 0;
  std::vector<float> values;

  static bool known(float depth) { return std::isfinite(depth) && depth > 0; }
};

// Which views of a scene see common space, as far as cameras (and depth) can tell. Attention between the others can be
// left out: an approximation, because the networks were trained with all pairs.
struct ViewVisibility {
  int64_t views = 0;
  std::vector<uint8_t> attends;  // (views, views), symmetric; 1 where the pair attends, as on the diagonal
  bool used_depth = false;
  // Targets that share space with no source view and were given the nearest one.
  std::vector<int64_t> lonely_targets;

  bool attends_to(int64_t a, int64_t b) const { return attends[static_cast<size_t>(a * views + b)] != 0; }
  bool all() const;
  // Blocks (ordered pairs of views) that are computed, as a share of all.
  double kept() const;
};

// Decides every pair by the space each view can see: the pyramid of its image, a tenth larger on every side, cut off at
// a far depth; two views attend when their spaces intersect. In doubt they do:
// - With cameras alone the space ends so far away (100 times the largest distance between camera centres) that only
//   views which look apart share nothing. Walls are not known.
// - source_depth, one map a source view in order, ends a source's space a quarter behind its surfaces, cell by cell,
// and
//   a target's at twice the farthest surface of any source. Views in different rooms then share nothing. It must be in
//   the unit of the poses.
// Every view attends to itself and every target to at least one source view, so that none is without evidence. World
// offset and unit do not matter. The cameras must have passed check_cameras (gld/cameras/camera_checks.h). Throws Error
// where source_depth is neither empty nor one map a source view.
ViewVisibility view_visibility(const Views& views, const std::vector<PlanarDepth>& source_depth = {});

// For people: one line, and where pairs are left out one line a view with a mark under every view it attends to.
std::string view_visibility_text(const ViewVisibility& visibility);

}  // namespace gld
