#pragma once

#include "gld/photogrammetry/planar_depth.h"

#include <string>
#include <utility>
#include <vector>

namespace gld {

// Depth of the source views of a scene, whoever says it: a geometry head, the photographs themselves, a sensor. What
// carries photographs into target views asks this, and not for where it came from.
struct SourceDepth {
  // One map a source view, of any size, in the unit of the scene's cameras; none where that is not known.
  std::vector<PlanarDepth> views;
  // How far it may be off, a natural logarithm: carrying tries depths so far nearer and farther. A network is off by a
  // third, its scale included.
  double reach = 0.35;
  std::string from;   // who says it, for people: "geometry head"
  std::string doubt;  // why it is not known; empty where it is

  bool known() const { return !views.empty(); }
};

// Returns depth that the scene itself has, which is not off: one map a source view.
inline SourceDepth depth_of_scene(std::vector<PlanarDepth> views) {
  SourceDepth depth;
  depth.views = std::move(views);
  depth.reach = 0;
  depth.from = "the scene";
  return depth;
}

// Returns the depth off on purpose, to see what depends on it: the first view's is 1 + error times as far, the second's
// 1 - error times, and so on in turns, so that views contradict each other. error is at least 0 and below 1.
inline SourceDepth with_depth_error(SourceDepth depth, double error) {
  for (size_t view = 0; view < depth.views.size(); ++view) {
    const auto factor = static_cast<float>(view % 2 == 0 ? 1 + error : 1 - error);
    for (float& value : depth.views[view].values) value *= factor;
  }
  return depth;
}

}  // namespace gld
