#pragma once

#include "gld/base/options.h"
#include "gld/kernels/attention_kernel.h"
#include "gld/photogrammetry/photo_consistency.h"
#include "gld/photogrammetry/planar_depth.h"
#include "gld/photogrammetry/view_maps.h"

#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Core>

namespace gld {

struct StereoOptions : OptionsGroup {
  int64_t largest_side = 224;  // pixels: photographs are reduced to it by area; carried pictures are best so
  int64_t coarse_side = 112;   // pixels: of the first pass
  int64_t planes = 192;
  int64_t window = 9;       // pixels a side of what is correlated; odd
  int64_t photographs = 4;  // the most that one is compared with
  double small_step = 0.2;  // what one plane more or less than the pixel beside costs; correlation 0 costs 1
  double big_step = 1;      // what more planes cost, where both are equally bright
  int64_t memory_limit = 1024;  // MiB: how many views are worked on at a time

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Why depth of a pixel is not certain.
enum class StereoDoubt : uint8_t {
  kNone,
  kUnseen,  // no other photograph taken elsewhere shows what is there, or the photograph itself has no value
  kUntextured,  // nothing to match: the window has no contrast in this photograph
  kUnlike,      // what lies there in other photographs does not look like it
  kFar,  // too far for the distance between the cameras, or too near to where one lies as the other sees it
  kAmbiguous,     // another depth matches as well
  kContradicted,  // the other photographs' own depth says otherwise, or nothing around it is certain
  kEdge,          // a window about it shows two surfaces
};

// The measured figures of tests/shared/shared_stereo_test.cpp are of pixels with at least this confidence.
constexpr float kConfidentStereo = 0.5F;

struct StereoDepth {
  PlanarDepth depth;         // in the unit of the cameras; 0 where neither photographs nor prior say anything
  ConfidenceMap confidence;  // of the photographs' part in it, from 0 to 1
  std::vector<StereoDoubt> doubt;  // (height, width) kNone where confidence >= kConfidentStereo
  // In the unit of the cameras: where photographs show something that is too far for the distance between them (sky,
  // far ground), its depth is at least this, or it would lie a pixel elsewhere in one of them. 0 elsewhere, all over a
  // view of which less than a hundredth is far, and where the prior is the result.
  PlanarDepth least;
  std::vector<size_t>
      compared;  // the other views that it was compared with; none where no view stands elsewhere

  size_t confident_pixels() const;
  size_t far_pixels() const;
  double confident_share() const;  // of the pixels
};

// What the photographs say of the prior depth, over all their confident pixels in the first pass.
struct PriorAgreement {
  int64_t pixels = 0;  // that were asked; 0 where too few were confident: then the prior counts as it is
  double scale = 1;    // photographs' depth / prior
  // Standard deviation of the logarithm of that ratio; scale and spread are those of the half of the pixels that lies
  // closest together.
  double spread = 0;
  double uncertain = 0;  // that of depth where the photographs are not confident, without the prior's part
};

struct StereoScene {
  std::vector<StereoDepth> views;       // as given
  std::optional<PriorAgreement> prior;  // where at least one view had one

  double confident_share() const;  // of the views' pixels, their mean
};

// Returns the depth that photographs agree on under their cameras: a plane sweep over inverse depth, each photograph
// against at most `photographs` others, by the zero-mean normalised correlation of windows (so that gain and offset do
// not matter) of the better half of those that see a point; semi-global matching over eight paths; a parabola between
// planes; and the depths of other views as a check.
//
// views have the rgb of each, of at least 2 x 2 pixels; values that are not finite are not there. depth of a view is
// its prior, in the unit of the cameras up to a factor that all views share, or empty. points are sparse points of the
// scene in the world, or none. The cameras must have passed check_cameras (gld/cameras/camera_checks.h).
//
// The first pass, at coarse_side and without the prior, looks at all depths: those of the points that lie before the
// view where it has 20 of them, else from where a quarter of the picture is still inside of another photograph, to
// infinity. Where points leave some of a view free, there is such a pass before it in which that view is looked at to
// infinity, and which takes its place where something is seen to be far (sky). What is confident there limits the
// depths of the second pass, at largest_side, and says how far the prior is right: a prior within 5 % counts in the
// cost like a correlation of 0.4 at most and fills what photographs leave open, corrected by what they say nearby; one
// that is off by 30 % counts for nothing. Of a view that overlaps no other one the prior is the result, in the unit
// that the others' photographs tell. Where hardly any pixel is confident, in the first pass or in the second, the
// prior is the result as it is, with confidence 0: of 224 drawn rooms the 6 whose second pass was confident of less
// than a hundredth all had a wrong unit, by 16 to 76 %.
//
// Throws Error for a view without a photograph. The result is the same on any number of threads.
StereoScene stereo_depth(const std::vector<PicturedView>& views,
                         const std::vector<Eigen::Vector3d>& points = {}, const StereoOptions& options = {},
                         const KernelSettings& settings = {});

}  // namespace gld
