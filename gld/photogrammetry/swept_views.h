#pragma once

#include "gld/cameras/camera.h"
#include "gld/photogrammetry/photo_consistency.h"
#include "gld/photogrammetry/plane_sweep.h"
#include "gld/photogrammetry/plane_sweep_stereo.h"
#include "gld/photogrammetry/stereo_picture.h"

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

namespace gld {

// Of a plane-sweep stereo (plane_sweep_stereo.h): which depths of each view are looked at, and in which other
// photographs.

// This takes pixels and planar depth of one camera to another's, both counted from pixel middles.
struct BetweenViews {
  Eigen::Matrix3d turned;
  Eigen::Vector3d moved;

  BetweenViews(const Camera& from, const Camera& to);
  // Returns (x, y, 1) times its depth in the other view.
  Eigen::Vector3d operator()(double x, double y, double depth) const {
    return depth * (turned * Eigen::Vector3d(x, y, 1)) + moved;
  }
};

// Returns whether (x, y, 1) times its depth lies in the picture, before its camera.
bool lies_inside(const Eigen::Vector3d& place, const StereoPicture& picture);

// This tells which views stand far enough from each other to say something.
class Baselines {
 public:
  // The views must outlive this object.
  explicit Baselines(const std::vector<PicturedView>& views);
  bool apart(size_t a, size_t b) const;

 private:
  const std::vector<PicturedView>& views_;
  double least_ = 0;
};

// 1 over the unit of the cameras.
struct InverseDepths {
  double least = 0;
  double most = 0;
  bool empty() const { return !(most > least); }
};

// The range of the points before the view and inside of it; empty where they are few.
struct PointRange {
  InverseDepths depths;
  bool all_over = false;  // the view: points say how far what they lie on is, not the sky
};
PointRange range_of_points(const StereoPicture& view, const std::vector<Eigen::Vector3d>& points);
// Returns whether a hundredth of the view is seen to be far (StereoDepth::least).
bool shows_something_far(const StereoDepth& found);
// The range goes from infinity to where a quarter of the picture is inside of another photograph.
InverseDepths range_of_visibility(size_t view, const std::vector<StereoPicture>& pictures,
                                  const Baselines& baselines);
// Returns what the first pass is sure of, from infinity where a hundredth of it is seen to be far; or nothing.
InverseDepths range_of_found(const StereoDepth& found);
// Returns the range of a prior times its scale; the prior is 0 where not known.
InverseDepths range_of_prior(const std::vector<float>& prior, double scale);

// Returns that many planes, none of them at infinity, whose depth is no number.
SweptPlanes planes_over(const InverseDepths& range, int64_t count);

// Returns those which see most of what the view sees at the middle of its range, from somewhere else.
std::vector<size_t> photographs_for(size_t view, const std::vector<StereoPicture>& pictures,
                                    const Baselines& baselines, const InverseDepths& range, int64_t most);

// The prior as a view's costs take it.
struct ScaledPrior {
  std::vector<float> log_depth;  // (height, width), scaled; not a number where not known
  double steepness = 0;          // of the cost, for each squared unit of log depth
  double dearest = 0;

  bool any() const { return !log_depth.empty(); }
};

// What a view is swept over.
struct SweptView {
  std::vector<size_t> compared;  // the other views; none where no view says anything
  SweptPlanes planes;
  ScaledPrior prior;
};

// Correlation falls off over a pixel or two: planes that lie as near to each other in the photographs are one minimum.
int64_t planes_of_one_minimum(size_t view, const std::vector<StereoPicture>& pictures,
                              const SweptView& swept);

// Returns whether so many confident pixels of so many are too few to say something of range or prior.
bool hardly_any(size_t confident, size_t of);

}  // namespace gld
