#include "models/depth_refinement/refined_source_depth.h"

#include "gld/base/error.h"
#include "gld/cameras/resized_camera.h"
#include "gld/photogrammetry/depth_hypotheses.h"
#include "gld/tensors/tensor_pictures.h"

#include <cmath>
#include <limits>

#include <torch/autograd.h>

namespace gld {
namespace {

// Brings (1, height, width) to another size, each pixel the mean of those that it covers.
torch::Tensor resized(const torch::Tensor& map, int64_t height, int64_t width) {
  if (map.size(1) == height && map.size(2) == width) return map;
  return torch::adaptive_avg_pool2d(map.unsqueeze(0), {height, width})[0];
}

struct LogDepth {
  torch::Tensor values, known;  // (1, height, width); the values are 0 and known is false where nothing is
};

LogDepth log_depth_of(const PlanarDepth& depth, int64_t height, int64_t width) {
  const auto map = planes_of(depth.values, 1, depth.width, depth.height);
  const auto known = torch::isfinite(map).logical_and(map > 0);
  const auto share = resized(known.to(torch::kFloat32), height, width);
  const auto logs = resized(torch::where(known, map, torch::ones({})).log(), height, width);
  return {torch::where(share > 0, logs / share, torch::zeros({})), share > 0};
}

// Returns the view as the others show it by its own depth.
PlacedPhotographs others_placed_in(const std::vector<PicturedView>& even, size_t view) {
  const PlanarDepth& own = even[view].depth;
  PlacedPhotographs placed;
  placed.target = resized_camera(even[view].camera, own.width, own.height);
  placed.depth.width = own.width;
  placed.depth.height = own.height;
  for (const float value : own.values) {
    const bool known = PlanarDepth::known(value);
    placed.depth.values.push_back(known ? static_cast<double>(value)
                                        : std::numeric_limits<double>::infinity());
    placed.depth.reached.push_back(known ? 1 : 0);
  }
  for (size_t other = 0; other < even.size(); ++other) {
    if (other != view) placed.photographs.push_back(even[other]);
  }
  return nearest_photographs(placed);
}

// Returns the evidence of one view, without the dimension of views.
DepthEvidence view_evidence(const ToldDepth& told, const std::vector<ColourGains>& gains, size_t view,
                            int64_t side) {
  const auto even = evened_photographs(told.photographs, gains, told.photographs[view].camera);
  const PlacedPhotographs placed = reduced(others_placed_in(even, view), side);
  const int64_t height = placed.target.height, width = placed.target.width;
  DepthEvidence evidence;
  const PicturedView& own = even[view];
  evidence.colours =
      torch::adaptive_avg_pool2d(planes_of(own.rgb, 3, own.width, own.height), {height, width});
  const LogDepth depth = log_depth_of(own.depth, height, width);
  const LogDepth head = log_depth_of(told.head[view], height, width);
  const auto zero = torch::zeros({});
  const auto known = depth.values.masked_select(depth.known);
  const auto middle = known.numel() == 0 ? zero : known.median();
  evidence.log_depth = torch::where(depth.known, depth.values - middle, zero);
  evidence.head = torch::where(depth.known.logical_and(head.known), head.values - depth.values, zero);
  const ConfidenceMap& confidence = told.confidence[view];
  evidence.confidence =
      confidence.empty()
          ? torch::zeros({1, height, width})
          : resized(planes_of(confidence.values, 1, confidence.width, confidence.height), height, width);
  evidence.confidence = torch::where(depth.known, evidence.confidence, torch::ones({}));
  std::vector<torch::Tensor> differences, shown;
  for (const double factor : kDepthFactors) {
    const DepthHypothesis hypothesis = depth_hypothesis(placed, factor);
    shown.push_back(planes_of(hypothesis.shown, 1, width, height));
    differences.push_back(
        torch::where(shown.back() > 0, planes_of(hypothesis.rgb, 3, width, height) - evidence.colours, zero));
  }
  evidence.differences = torch::stack(differences);
  evidence.shown = torch::cat(shown);
  return evidence;
}

}  // namespace

DepthEvidence depth_evidence(const ToldDepth& told, int64_t side) {
  const torch::NoGradGuard no_gradients;
  const auto gains = exposure_gains(told.photographs);
  std::vector<DepthEvidence> views;
  for (size_t view = 0; view < told.photographs.size(); ++view)
    views.push_back(view_evidence(told, gains, view, side));
  DepthEvidence evidence;
  for (size_t part = 0; part < evidence.parts().size(); ++part) {
    std::vector<torch::Tensor> maps;
    maps.reserve(views.size());
    for (DepthEvidence& view : views) maps.push_back(*view.parts()[part]);
    *evidence.parts()[part] = torch::stack(maps);
  }
  return evidence;
}

std::vector<PlanarDepth> refined_depths(const DepthRefinement& refinement, const ToldDepth& told) {
  const torch::NoGradGuard no_gradients;
  const double strength = (1 + told.belief) / 2;
  const auto network = strength * refinement.forward(depth_evidence(told, refinement.options().side));
  if (!network.isfinite().all().item<bool>())
    fail({"mending depth", "finite corrections", "NaN or infinity",
          "check the depth_refinement with gld inspect"});
  std::vector<PlanarDepth> refined;
  for (size_t view = 0; view < told.photographs.size(); ++view) {
    PlanarDepth depth = told.photographs[view].depth;
    auto large = network.narrow(0, static_cast<int64_t>(view), 1);
    if (large.size(2) != depth.height || large.size(3) != depth.width)
      large = torch::upsample_bilinear2d(large, {depth.height, depth.width}, false);
    const ConfidenceMap& confidence = told.confidence[view];
    const auto confirmed = confidence.empty()
                               ? torch::zeros({1, 1, depth.height, depth.width})
                               : planes_of(confidence.values, 1, depth.width, depth.height).unsqueeze(0);
    const auto factors = depth_correction(confirmed, large).exp().contiguous();
    const float* factor = factors.data_ptr<float>();
    for (size_t i = 0; i < depth.values.size(); ++i) {
      if (PlanarDepth::known(depth.values[i])) depth.values[i] *= factor[i];
    }
    refined.push_back(std::move(depth));
  }
  return refined;
}

}  // namespace gld
