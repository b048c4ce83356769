#pragma once

#include "datasets/scenes/scene.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// What the poses of a scene might be in truth. The first is what they should be.
enum class PoseMeaning { kAsRead, kOpenGl, kInverted, kInvertedOpenGl };
std::string pose_meaning_text(PoseMeaning meaning);

// How well a meaning explains the pixels of neighbouring frames.
struct PoseEvidence {
  PoseMeaning meaning = PoseMeaning::kAsRead;
  double agreement = 0;  // share of comparisons that agree, 0 to 1
};

struct PoseHypotheses {
  std::string
      method;  // "depth carried between views", "epipolar lines of matched points" or empty: nothing to test
  int64_t comparisons = 0;
  std::vector<PoseEvidence> evidence;  // in the order of PoseMeaning
  double median_depth = 0;             // of matched points that agree as read; 0 where unknown
  // Returns the meaning that explains the pixels clearly better than the others; kAsRead when none does.
  PoseMeaning best() const;
};

// Tests the meanings on up to most_pairs pairs of neighbouring frames: with depth where the scene has it, otherwise by
// matching image features and asking how many matches lie within 2 pixels (at 640 pixels' width) of their epipolar line
// with positive depth.
PoseHypotheses test_pose_meanings(const Scene& scene, int64_t most_pairs);

// Returns the frame's camera under another meaning.
Camera reinterpreted(const Camera& camera, PoseMeaning meaning);

}  // namespace gld
