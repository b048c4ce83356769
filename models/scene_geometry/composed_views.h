#pragma once

#include "gld/cameras/camera.h"
#include "models/blending/photograph_blending.h"
#include "models/scene_geometry/photograph_depth.h"

#include <cstdint>
#include <vector>

#include <torch/types.h>

namespace gld {

// The source photographs with their depth and what evens their exposure: what is laid into one target after the other.
struct CarriableSources {
  std::vector<PicturedView> photographs;  // none where depth is not known
  std::vector<ColourGains> gains;
  PhotographViewOptions options;

  CarriableSources(const SourcePhotographs& sources, const SourceDepth& depth);
  // Places them `times` as large as the camera says.
  PlacedPhotographs placed_in(const Camera& target, int64_t times) const;
};

// Target views of which the photographs' part is kept and the rest generated
// (gld/photogrammetry/photograph_composition.h).
struct ComposedViews {
  torch::Tensor images;  // (target views, 3, height, width) in [0, 1], of the generated pictures' size
  // (target views, height, width) from 0 to 1: how much of a pixel comes from photographs.
  torch::Tensor shown;
  // (target views): the variance that errors are expected to have, mean over a view's pixels (expected_variance()).
  torch::Tensor expected_variance;
  // The same at the photographs' size, a whole multiple of the generated one.
  torch::Tensor large_images;
  torch::Tensor large_shown;
};

// Returns dB of target view number `target`.
double expected_psnr(const ComposedViews& views, int64_t target);

// Lays photographs together where several depths and several of them are possible: by rule
// (gld/photogrammetry/photograph_composition.h), and where `blending` is not null as that network chooses from there.
// generated is (target views, 3, height, width). Photographs that are `n` times as large as the generated pictures,
// rounded down, make the composition n times as large; its images of the generated size are means over n x n pixels.
ComposedViews compose_views(const Views& views, const SourcePhotographs& photographs,
                            const SourceDepth& depth, const torch::Tensor& generated,
                            const PhotographBlending* blending = nullptr);

// Returns (pictures, 3, height, width) with each side so many times as large, bicubically.
torch::Tensor enlarged(const torch::Tensor& pictures, int64_t times);

// Returns the target views that photographs show whole and agree on (PhotographView::complete()), by number from 0:
// nothing of them needs to be generated. They are looked at in the views' own size.
std::vector<int64_t> complete_targets(const Views& views, const SourcePhotographs& photographs,
                                      const SourceDepth& depth);

// Returns target views from photographs alone: as compose_views() with what is shown around it in the place of the few
// pixels that are not.
ComposedViews carried_views(const Views& views, const SourcePhotographs& photographs,
                            const SourceDepth& depth, const PhotographBlending* blending = nullptr);

// The target views as far as photographs show them by rule, gaps filled in smoothly and nothing generated: what a
// generated part has to beat.
struct FilledViews {
  torch::Tensor images;  // (target views, 3, height, width) of the views' size
  torch::Tensor
      shown;  // (target views, height, width), bool: where photographs show at least half of a pixel
};
FilledViews filled_views(const Views& views, const SourcePhotographs& photographs, const SourceDepth& depth);

}  // namespace gld
