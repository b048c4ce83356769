#pragma once

#include "gld/cameras/camera.h"
#include "gld/cameras/photo_consistency.h"

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

// Each photograph of sources carried into the target view, of the target camera's size. source.depth in the unit of the
// cameras, of the same picture as source.rgb, which all of them have.
//
// The depth of the target view is what the depth of the sources says of it, the nearest surface in front, and then
// what the photographs themselves say: among depths up to a third nearer and farther (of all sources together, so that
// an error of the scale is mended too) each pixel takes that at which the photographs differ least in the 9x9 pixels
// around it, with a small price for leaving the predicted one. Colours are taken bilinearly from where that point was
// seen. A pixel that no source's depth reaches within 2 pixels, that lies outside of a photograph or behind what it
// shows, is not seen in it. Depth that is not finite and positive says nothing.
std::vector<CarriedPicture> carry_pictures(const std::vector<PicturedView>& sources, const Camera& target);

// Pictures carried into one view as one, without gaps: the mean of those that are seen at a pixel, and where none is,
// that of the nearest pixel with one. seen tells where; a picture of which nothing is seen is black. At least one
// picture.
CarriedPicture completed_picture(const std::vector<CarriedPicture>& carried);

// The depth of the target view, of its camera's size, as one source's depth says: the nearest surface of what it
// shows, and where it shows nothing, that of the nearest pixel with one. In the unit of source.depth and of the
// cameras; all zero where nothing lies in front of the target camera.
PlanarDepth depth_seen_from(const PicturedView& source, const Camera& target);

}  // namespace gld
