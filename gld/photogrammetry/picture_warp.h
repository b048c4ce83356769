#pragma once

#include "gld/cameras/camera.h"
#include "gld/photogrammetry/photo_consistency.h"

#include <cstdint>
#include <vector>

namespace gld {

// A photograph carried into another view: what that view shows of it as far as the depth is right.
struct CarriedPicture {
  int64_t width = 0;
  int64_t height = 0;
  std::vector<float> rgb;     // (height, width, 3); 0 where nothing came to lie
  std::vector<uint8_t> seen;  // (height, width); 1 where something did

  double seen_share() const;  // of the pixels
};

// How a colour between pixels of a photograph is found.
enum class ColourSampling {
  kBilinear,  // of 2x2 pixels; what generators were trained to see. Half-way between pixels it is their mean, a blur.
  kCubic,  // of 4x4 pixels by Catmull-Rom's spline (Keys 1981, a = -1/2), which keeps edges; within [0, 1]
};

// How photographs are carried by the depth of the sources.
struct CarryOptions {
  // Depths up to exp(this) nearer and farther than the sources' say are tried. 0.35 is about a third, for depth that a
  // network predicts; what photographs were matched for needs less. 0 takes the depth as it is.
  double depth_reach = 0.35;
  double hidden_behind = 1.3;  // depths over what a source shows at a place, to be hidden from it; above 1
  ColourSampling colours =
      ColourSampling::kBilinear;  // of what is carried; depth is matched by bilinear ones
};

// The depth of a target view, row by row, of its camera's size and in the unit of the cameras.
struct TargetDepth {
  int64_t width = 0;
  int64_t height = 0;
  std::vector<double> values;    // infinity everywhere where no source's depth lies in front of the target
  std::vector<uint8_t> reached;  // 1 where the depth of some source comes to lie within 2 pixels
};

// Takes what the depth of the sources says of the target view's, the nearest surface in front, and then what the
// photographs themselves say: among depths up to options.depth_reach nearer and farther (of all sources together, so
// that an error of the scale is mended too) each pixel takes that at which the photographs differ least in the 9x9
// pixels around it, with a small price for leaving the predicted one. source.depth is in the unit of the cameras, of
// the same picture as source.rgb, which all of them have; depth that is not finite and positive says nothing.
TargetDepth matched_target_depth(const std::vector<PicturedView>& sources, const Camera& target,
                                 const CarryOptions& options = {});

// Returns each photograph of sources carried into the target view, of the target camera's size, which depth has as
// well. Colours are taken by options.colours from where a point was seen. A pixel that depth does not reach, that lies
// outside of a photograph or behind what it shows, is not seen in it.
std::vector<CarriedPicture> carry_pictures_to(const std::vector<PicturedView>& sources, const Camera& target,
                                              const TargetDepth& depth, const CarryOptions& options = {});

// Does both at once.
std::vector<CarriedPicture> carry_pictures(const std::vector<PicturedView>& sources, const Camera& target,
                                           const CarryOptions& options = {});

// Returns pictures carried into one view as one, without gaps: the mean of those that are seen at a pixel, and where
// none is, that of the nearest pixel with one. seen tells where; a picture of which nothing is seen is black. There is
// at least one picture.
CarriedPicture completed_picture(const std::vector<CarriedPicture>& carried);

// Returns the depth of the target view, of its camera's size, as one source's depth says: the nearest surface of what
// it shows, and where it shows nothing, that of the nearest pixel with one. It is in the unit of source.depth and of
// the cameras, and all zero where nothing lies in front of the target camera.
PlanarDepth depth_seen_from(const PicturedView& source, const Camera& target);

}  // namespace gld
