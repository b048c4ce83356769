#include "models/scene_geometry/composed_views.h"

#include "gld/cameras/resized_camera.h"
#include "gld/photogrammetry/photograph_composition.h"
#include "gld/tensors/tensor_pictures.h"
#include "models/blending/blended_view.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include <torch/nn/functional/upsampling.h>

namespace gld {
namespace {

// Returns how many times larger than the views the photographs are, a whole number.
int64_t magnification(const Views& views, const SourcePhotographs& photographs) {
  const Camera& camera = views.cameras.front();
  int64_t times = camera.width;
  for (const PicturedView& view : photographs.views) {
    times = std::min({times, view.width / camera.width, view.height / camera.height});
  }
  return std::max<int64_t>(times, 1);
}

// Returns the target views as photographs show them, each `times` as large as its camera says.
std::vector<PhotographView> photograph_views(const Views& views, const SourcePhotographs& photographs,
                                             const SourceDepth& depth, int64_t times,
                                             const PhotographBlending* blending) {
  const CarriableSources sources(photographs, depth);
  std::vector<PhotographView> shown;
  for (int64_t view = views.num_sources; view < views.size(); ++view) {
    const PlacedPhotographs placed = sources.placed_in(views.cameras[static_cast<size_t>(view)], times);
    shown.push_back(view_from_photographs(placed));
    if (blending != nullptr) blend_photographs(*blending, placed, shown.back());
  }
  return shown;
}

torch::Tensor reduced(const torch::Tensor& pictures, int64_t times) {
  return times == 1 ? pictures : torch::avg_pool2d(pictures, times);
}

ComposedViews composed_of(const std::vector<torch::Tensor>& images, const std::vector<torch::Tensor>& shares,
                          const std::vector<double>& variances, int64_t times) {
  ComposedViews result;
  result.expected_variance = torch::tensor(at::ArrayRef<double>(variances));
  result.large_images = torch::stack(images);
  result.large_shown = torch::stack(shares);
  result.images = reduced(result.large_images, times);
  result.shown = reduced(result.large_shown.unsqueeze(1), times).squeeze(1);
  return result;
}

}  // namespace

CarriableSources::CarriableSources(const SourcePhotographs& sources, const SourceDepth& depth) {
  options.carry.depth_reach = depth.reach;
  if (!depth.known()) return;
  photographs = sources.views;
  for (size_t i = 0; i < photographs.size(); ++i) photographs[i].depth = depth.views[i];
  gains = exposure_gains(photographs);
}

PlacedPhotographs CarriableSources::placed_in(const Camera& target, int64_t times) const {
  return place_photographs(photographs, gains,
                           resized_camera(target, times * target.width, times * target.height), options);
}

double expected_psnr(const ComposedViews& views, int64_t target) {
  return -10 * std::log10(views.expected_variance[target].item<double>());
}

torch::Tensor enlarged(const torch::Tensor& pictures, int64_t times) {
  if (times == 1) return pictures;
  namespace F = torch::nn::functional;
  return F::interpolate(pictures,
                        F::InterpolateFuncOptions()
                            .size(std::vector<int64_t>{times * pictures.size(2), times * pictures.size(3)})
                            .mode(torch::kBicubic)
                            .align_corners(false));
}

std::vector<int64_t> complete_targets(const Views& views, const SourcePhotographs& photographs,
                                      const SourceDepth& depth) {
  std::vector<int64_t> complete;
  if (!depth.known()) return complete;
  const auto shown = photograph_views(views, photographs, depth, 1, nullptr);
  for (size_t i = 0; i < shown.size(); ++i) {
    if (shown[i].complete()) complete.push_back(static_cast<int64_t>(i));
  }
  return complete;
}

ComposedViews carried_views(const Views& views, const SourcePhotographs& photographs,
                            const SourceDepth& depth, const PhotographBlending* blending) {
  const int64_t times = magnification(views, photographs);
  std::vector<torch::Tensor> images, shares;
  std::vector<double> variances;
  for (const PhotographView& view : photograph_views(views, photographs, depth, times, blending)) {
    images.push_back(picture_of(filled(view), view.width, view.height));
    shares.push_back(torch::ones({view.height, view.width}));
    variances.push_back(expected_variance(view, std::numeric_limits<double>::infinity()));
  }
  return composed_of(images, shares, variances, times);
}

ComposedViews compose_views(const Views& views, const SourcePhotographs& photographs,
                            const SourceDepth& depth, const torch::Tensor& generated,
                            const PhotographBlending* blending) {
  const int64_t times = magnification(views, photographs);
  const auto shown = photograph_views(views, photographs, depth, times, blending);
  const auto large = enlarged(generated.to(torch::kCPU, torch::kFloat32), times).clamp(0, 1);
  std::vector<torch::Tensor> images, shares;
  std::vector<double> variances;
  for (size_t i = 0; i < shown.size(); ++i) {
    const PhotographView& view = shown[i];
    const auto pixels = pixels_of(large[static_cast<int64_t>(i)]);
    const double of_generated = generated_variance(view, pixels);
    const ComposedPicture composed = compose(view, pixels, of_generated);
    variances.push_back(expected_variance(view, of_generated));
    images.push_back(picture_of(composed.rgb, view.width, view.height));
    shares.push_back(torch::tensor(at::ArrayRef<float>(composed.shown)).view({view.height, view.width}));
  }
  return composed_of(images, shares, variances, times);
}

FilledViews filled_views(const Views& views, const SourcePhotographs& photographs, const SourceDepth& depth) {
  const int64_t times = magnification(views, photographs);
  std::vector<torch::Tensor> pictures, shown;
  for (const PhotographView& view : photograph_views(views, photographs, depth, times, nullptr)) {
    pictures.push_back(picture_of(filled(view), view.width, view.height));
    std::vector<float> known(view.variance.size());
    for (size_t pixel = 0; pixel < known.size(); ++pixel) known[pixel] = view.shown(pixel) ? 1.0F : 0.0F;
    shown.push_back(torch::tensor(at::ArrayRef<float>(known)).view({1, view.height, view.width}));
  }
  return {reduced(torch::stack(pictures), times), reduced(torch::stack(shown), times).squeeze(1) >= 0.5};
}

}  // namespace gld
