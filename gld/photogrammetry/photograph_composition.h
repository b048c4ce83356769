#pragma once

#include "gld/cameras/camera.h"
#include "gld/photogrammetry/exposure_gains.h"
#include "gld/photogrammetry/photo_consistency.h"
#include "gld/photogrammetry/picture_warp.h"

#include <cstdint>
#include <vector>

namespace gld {

// What is seen is kept: what photographs show of a target view, carried there at their own resolution, and a generated
// picture for the rest.

struct PhotographViewOptions {
  CarryOptions carry;
  // Pixels of the longer side at which the depth of the target view is matched; colours are carried at the size of the
  // target camera, whatever that is.
  int64_t matched_side = 256;
};

// A target view as far as photographs show it.
struct PhotographView {
  int64_t width = 0;
  int64_t height = 0;
  std::vector<float> rgb;  // (height, width, 3) in [0, 1]; 0 where nothing is shown
  // (height, width): the variance that a colour's error is expected to have, of numbers from 0 to 1: what photographs
  // that show the place disagree by, or for a single one a usual value. Infinity where none shows it.
  std::vector<float> variance;

  bool shown(size_t pixel) const { return variance[pixel] < kNotShown; }
  double shown_share() const;  // of the pixels
  // Returns whether photographs show all of it (but one pixel in a thousand, which are filled from around) and agree: a
  // second one confirms nine tenths, and the error that is expected is that of a photograph that nothing contradicts.
  bool complete() const;

  static constexpr float kNotShown = 1e30F;
  // Of a photograph that alone shows a place: nothing contradicts it, and nothing confirms its depth. About 24 dB,
  // which is what carried photographs of drawn rooms and of real places have there.
  static constexpr float kVarianceOfOne = 0.004F;
  // Colours differ by this where everything is right: noise of cameras, what lies between pixels.
  static constexpr float kColourNoise = 0.0004F;
};

// Photographs as they are laid into a target view: all of one brightness, that of the target, with the depth that they
// are carried by, of the target camera's size.
struct PlacedPhotographs {
  std::vector<PicturedView> photographs;
  Camera target;
  TargetDepth depth;  // empty without photographs
  CarryOptions carry;
};

// sources have depth in the unit of the cameras, as for matched_target_depth(); gains has one a source.
PlacedPhotographs place_photographs(const std::vector<PicturedView>& sources,
                                    const std::vector<ColourGains>& gains, const Camera& target,
                                    const PhotographViewOptions& options = {});

// Returns the photograph with at most `side` pixels on the longer side, each the mean of what it covers; depth stays as
// it is.
PicturedView reduced_view(const PicturedView& view, int64_t side);

// Returns the same with target and photographs of at most `side` pixels on the longer side.
PlacedPhotographs reduced(const PlacedPhotographs& placed, int64_t side);

// Where several photographs show a place, those count most whose camera looks at it from the target's side (by the
// angle between both lines of sight), and less towards a photograph's border, so that no seam is left there; where they
// contradict each other the one that counts most is taken alone.
PhotographView view_from_photographs(const PlacedPhotographs& placed);

// Does both at once.
PhotographView view_from_photographs(const std::vector<PicturedView>& sources,
                                     const std::vector<ColourGains>& gains, const Camera& target,
                                     const PhotographViewOptions& options = {});

// Returns the variance of a generated picture's errors, measured where photographs agree with each other best, and a
// usual value where there is no such place. generated is (height, width, 3) of the view's size.
double generated_variance(const PhotographView& view, const std::vector<float>& generated);

// Returns, from 0 to 1, how far a generated picture is believed where no photograph shows anything, by the variance of
// its errors where photographs agree best: 1 without errors, a half at 24 dB and where they agree hardly anywhere. It
// is measured at the view's own size, so that detail which a small generated picture cannot have is an error. One that
// is wrong there has nothing to say elsewhere; being brighter or darker all over is no fault, since compose() moves it.
double belief_in_generated(const PhotographView& view, const std::vector<float>& generated);

struct ComposedPicture {
  std::vector<float> rgb;    // (height, width, 3)
  std::vector<float> shown;  // (height, width): the share of a pixel that comes from photographs, from 0 to 1
};

// Each pixel is the mixture of the photographs' and the generated colour whose error is expected to be least:
// m = variance of generated / (variance of generated + variance of photographs). So that no border is seen where
// photographs end, the generated picture is moved by the smooth membrane through the differences from the photographs,
// which far away from all of them is their mean. What no photograph shows is the generated picture as far as it is
// believed (belief_in_generated()), and what is shown around it, filled in smoothly, for the rest.
ComposedPicture compose(const PhotographView& view, const std::vector<float>& generated,
                        double generated_variance);

// Returns the variance that the errors of the composed view are expected to have, mean over its pixels, of numbers from
// 0 to 1; with an infinite generated_variance it is of the view as photographs show it. What no photograph shows counts
// as wrong by a usual amount, whoever makes it up: nothing in the view tells.
double expected_variance(const PhotographView& view, double generated_variance);

// Returns the view with what no photograph shows filled in smoothly from around it: what there is without a generated
// picture. It is mid-grey where nothing is shown at all.
std::vector<float> filled(const PhotographView& view);

}  // namespace gld
