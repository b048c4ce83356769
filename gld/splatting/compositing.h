#pragma once

#include "gld/splatting/splat_view.h"
#include "gld/splatting/tile_records.h"

#include <cstdint>
#include <vector>

namespace gld {

// Some channels of a picture, each row by row. Rows begin `stride` numbers apart, a multiple of kSplatTile; what lies
// behind a row's end is 0 in what gradients are taken from.
struct SplatImage {
  int64_t channels = 0, width = 0, height = 0, stride = 0;
  std::vector<float> values;  // (channels, height, stride)

  SplatImage() = default;
  SplatImage(int64_t image_channels, int64_t image_width, int64_t image_height);
  int64_t plane() const { return height * stride; }
  float* row(int64_t channel, int64_t y) { return values.data() + channel * plane() + y * stride; }
  const float* row(int64_t channel, int64_t y) const {
    return values.data() + channel * plane() + y * stride;
  }
};

// What is composited, front to back: w_i = alpha_i prod_{j < i} (1 - alpha_j), a channel is the sum of w_i f_i and
// of the background through what is left. alpha is at most .99; a Gaussian that would leave less than the camera's
// least transmittance ends its pixel, and is not in it.
struct SplatFeatures {
  const float* values = nullptr;  // (rows, channels)
  int64_t channels = 0;
  bool by_index = false;               // rows are the set's Gaussians; else the view's splats, front to back
  std::vector<float> background = {};  // (channels), or empty for 0
};

struct CompositedView {
  SplatImage image;
  SplatImage transmittance;  // one channel: what is left behind the last Gaussian
};
// The records of a view's tiles, which composite_backward() need not find again: of the same view, and of what else is
// here, which is compared.
struct TileLists {
  std::vector<TileRecords> tiles;
  int64_t strip = 0;      // pixels, of the instruction set
  int64_t stride = 0;     // of a plane's rows
  bool by_index = false;  // as SplatFeatures has it
};
CompositedView composite(const SplatView& view, const SplatFeatures& features, const KernelSettings& settings,
                         TileLists* keep = nullptr);

// d loss / d what was composited, for every splat of the view. Sums go by Gaussian in the order of tiles: they are
// equal to the bit whatever settings.threads is.
struct CompositingGradients {
  std::vector<float> features;  // (splats, channels)
  // (splats, kSplatMoments): sums of a = alpha d loss / d alpha, where alpha is held as the camera says, times 1, u, v,
  // u u, u v, v v (u and v of VisibleSplat). Empty where only features were asked for.
  std::vector<float> moments;
};
enum class SplatGradients { kFeatures, kFeaturesAndShapes };
CompositingGradients composite_backward(const SplatView& view, const SplatFeatures& features,
                                        const SplatImage& of_image, SplatGradients wanted,
                                        const KernelSettings& settings, const TileLists* kept = nullptr);

// Returns d loss / d the splat's place, covariance and opacity, from its moments.
ProjectedGradient projected_gradient(const VisibleSplat& splat, const float* moments);

// The weights of a view's pixels as a sparse matrix by rows, a row a pixel (row by row, without what lies behind a
// row's end), a column a Gaussian of the set; front to back within a row, those of 0 left out.
struct PixelWeights {
  std::vector<int64_t> first;    // (height width + 1) into the others
  std::vector<int32_t> columns;  // indices in the set
  std::vector<float> values;
};
PixelWeights pixel_weights(const SplatView& view, const KernelSettings& settings);

// Renders a picture of a set in 3DGS's colours.
CompositedView render_colours(const GaussianSet& set, const SplatView& view, const KernelSettings& settings);

// What a step of fitting needs: the gradients of all parameters (zero for Gaussians that are not seen), and for
// density control how the loss changes with the place in the picture, d loss / d mean in pixels, (splats, 2), empty
// where only features were asked for.
struct ColourGradients {
  GaussianSet of_set;
  std::vector<float> of_means_in_picture;
};
// colours are view_colours of the same set. With kFeatures gradients are of colours and harmonics alone, with
// geometry's left 0. gradients.of_set is reused where it has the set's size; what it held is gone. kept is as
// composite() kept them for the same colours, or null.
void render_colours_backward(const GaussianSet& set, const SplatView& view, const std::vector<float>& colours,
                             const SplatImage& of_image, SplatGradients wanted,
                             const KernelSettings& settings, ColourGradients& gradients,
                             const TileLists* kept = nullptr);

// Renders a picture of a set's features.
CompositedView render_features(const GaussianSet& set, const SplatView& view, const KernelSettings& settings);
// Its gradients, of features and geometry, are added to of_set, which has the set's shape.
void render_features_backward(const GaussianSet& set, const SplatView& view, const SplatImage& of_image,
                              const KernelSettings& settings, GaussianSet& of_set);

}  // namespace gld
