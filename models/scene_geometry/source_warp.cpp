#include "models/scene_geometry/source_warp.h"

#include "gld/base/error.h"
#include "gld/cameras/relative_cameras.h"
#include "gld/photogrammetry/picture_warp.h"
#include "gld/tensors/tensor_pictures.h"
#include "models/scene_geometry/geometry_placement.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <string>
#include <utility>
#include <vector>

#include <torch/types.h>

namespace gld {
namespace {

// Returns the median of the depths that are known: at least one.
double median_depth(const PlanarDepth& depth) {
  std::vector<float> values;
  std::copy_if(depth.values.begin(), depth.values.end(), std::back_inserter(values), PlanarDepth::known);
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Smaller photographs tell the scale well enough here, and matching them at all scales would be most of what a warp
// costs: at half the side a quarter of it.
torch::Tensor reduced_photographs(const torch::Tensor& photographs) {
  constexpr int64_t kLargestSide = 64;
  const int64_t factor =
      (std::max(photographs.size(2), photographs.size(3)) + kLargestSide - 1) / kLargestSide;
  if (factor <= 1) return photographs;
  // Sides that are no multiples are covered whole too: the cameras are of all of them.
  const auto reduced = [&](int64_t side) { return std::max<int64_t>(1, (side + factor / 2) / factor); };
  return torch::adaptive_avg_pool2d(photographs,
                                    {reduced(photographs.size(-2)), reduced(photographs.size(-1))});
}

// A carried picture with how far it is to be trusted: the less the nearer its camera stood (in median depths: an error
// of depth moves a pixel by its share of that) and the more it covers.
struct RankedPicture {
  CarriedPicture picture;
  double rank = 0;
};

// Returns those of which something is seen, the most trusted first.
std::vector<RankedPicture> ranked_pictures(std::vector<CarriedPicture> pictures, const Camera& target,
                                           const std::vector<PicturedView>& sources) {
  std::vector<RankedPicture> ranked;
  for (size_t i = 0; i < sources.size(); ++i) {
    const Camera& source = sources[i].camera;
    RankedPicture carried;
    carried.picture = std::move(pictures[i]);
    const double share = carried.picture.seen_share();
    if (share == 0) continue;
    const double apart =
        (source.world_from_camera.translation() - target.world_from_camera.translation()).norm();
    constexpr double kNoParallax = 0.1;
    carried.rank = (apart / median_depth(sources[i].depth) + kNoParallax) / share;
    ranked.push_back(std::move(carried));
  }
  std::stable_sort(ranked.begin(), ranked.end(),
                   [](const RankedPicture& a, const RankedPicture& b) { return a.rank < b.rank; });
  return ranked;
}

torch::Tensor colours_of(const CarriedPicture& carried) {
  return picture_of(carried.rgb, carried.width, carried.height);
}

// Returns how far a picture agrees with the mean of all at each pixel, (height, width): exp(-mean distance of the
// colours / 0.1) where it is seen, 0 where it is not.
torch::Tensor agreement_of(const CarriedPicture& carried, const torch::Tensor& mean) {
  constexpr double kFarOff = 0.1;
  const auto seen = torch::tensor(at::ArrayRef<uint8_t>(carried.seen), torch::kUInt8)
                        .to(torch::kFloat32)
                        .view({carried.height, carried.width});
  return seen * torch::exp(-(colours_of(carried) - mean).abs().mean(0) / kFarOff);
}

std::vector<Camera> source_cameras(const Views& views) {
  return {views.cameras.begin(), views.cameras.begin() + static_cast<std::ptrdiff_t>(views.num_sources)};
}

// Places the sources' depth, in their unit.
GeometryPlacement place_sources(const Views& views, const torch::Tensor& source_images,
                                const GeometryOutput& source_geometry) {
  const auto given = source_cameras(views);
  // Where the rays tell the scale, photographs need not be asked: carry_pictures() matches them anyway.
  GeometryPlacement placement = place_geometry(source_geometry, given);
  if (placement.scale) return placement;
  ScaleEvidence evidence;
  evidence.photographs = reduced_photographs(source_images);
  return place_geometry(source_geometry, given, evidence);
}

std::string unknown_unit(const GeometryPlacement& placement) {
  return "the unit of the source views' depth is not known (" +
         (placement.problem.empty() ? estimates_text(placement.estimates) : placement.problem) + ")";
}

// Returns source views with their depth. Without photographs they have no colours.
std::vector<PicturedView> pictured_sources(const Views& views, const SourceDepth& depth,
                                           const torch::Tensor& photographs = {}) {
  const auto given = source_cameras(views);
  if (depth.views.size() != given.size()) {
    fail({"depth of the source views", "a map for each of " + std::to_string(given.size()) + " source views",
          std::to_string(depth.views.size()), "give as many"});
  }
  std::vector<PicturedView> sources;
  for (int64_t i = 0; i < views.num_sources; ++i) {
    PicturedView source;
    source.camera = given[static_cast<size_t>(i)];
    source.depth = depth.views[static_cast<size_t>(i)];
    if (photographs.defined()) {
      source.width = photographs.size(3);
      source.height = photographs.size(2);
      source.rgb = pixels_of(photographs[i]);
    }
    sources.push_back(std::move(source));
  }
  return sources;
}

// Returns a warp with nothing carried.
SourceWarp no_source_warp(const Views& views, int64_t count, const std::string& doubt) {
  const Camera& camera = views.cameras.front();
  return {torch::zeros({views.num_targets(), count, camera.height, camera.width}), {}, doubt};
}

}  // namespace

std::vector<PlanarDepth> depth_in_unit(const GeometryOutput& geometry, int64_t views, double unit) {
  std::vector<PlanarDepth> maps;
  for (int64_t i = 0; i < views; ++i) {
    const auto map = geometry.depth[i];
    maps.push_back({map.size(1), map.size(0), numbers_of(map.to(torch::kFloat64) * unit)});
  }
  return maps;
}

SourceDepth source_depth_of_head(const Views& views, const torch::Tensor& source_images,
                                 const GeometryOutput& source_geometry, double single_source_unit) {
  SourceDepth depth;
  if (views.num_sources == 1) {
    const auto& view = source_geometry.single_view;
    depth.from =
        view ? "geometry head, in the unit that its view suggests" : "geometry head, in the usual unit";
    if (single_source_unit > 0) {
      depth.views = depth_in_unit(source_geometry, 1,
                                  view ? view->guess(views.cameras.front()).metres : single_source_unit);
    } else {
      depth.doubt = kNoScaleOfOneSource;
    }
    return depth;
  }
  depth.from = "geometry head";
  const GeometryPlacement placement = place_sources(views, source_images, source_geometry);
  if (!placement.scale) {
    depth.doubt = unknown_unit(placement);
    return depth;
  }
  depth.views = depth_in_unit(source_geometry, views.num_sources, placement.scale->scale);
  return depth;
}

SourceWarp warp_sources(const Views& views, const torch::Tensor& source_images, const SourceDepth& depth,
                        int64_t count) {
  if (!depth.known()) return no_source_warp(views, count, depth.doubt);
  const auto sources = pictured_sources(views, depth, source_images);
  SourceWarp warp = no_source_warp(views, count, "");
  std::vector<torch::Tensor> completed;
  for (int64_t target = 0; target < views.num_targets(); ++target) {
    const Camera& camera = views.cameras[static_cast<size_t>(views.num_sources + target)];
    CarryOptions carry;
    carry.depth_reach = depth.reach;
    auto pictures = carry_pictures(sources, camera, carry);
    completed.push_back(colours_of(completed_picture(pictures)));
    const auto ranked = ranked_pictures(std::move(pictures), camera, sources);
    const auto kept = std::min(count, static_cast<int64_t>(ranked.size()));
    for (int64_t i = 0; i < kept; ++i) {
      warp.agreement[target][i] = agreement_of(ranked[static_cast<size_t>(i)].picture, completed.back());
    }
  }
  if (!completed.empty()) warp.completed = torch::stack(completed);
  return warp;
}

NearestSourceDepth nearest_source_depth(const Views& views, const SourceDepth& depth) {
  if (!depth.known()) return {{}, depth.doubt};
  const auto sources = pictured_sources(views, depth);
  std::vector<torch::Tensor> depths;
  for (int64_t target = views.num_sources; target < views.size(); ++target) {
    const auto seen = depth_seen_from(sources[static_cast<size_t>(nearest_source(views, target))],
                                      views.cameras[static_cast<size_t>(target)]);
    depths.push_back(torch::tensor(at::ArrayRef<float>(seen.values)).view({seen.height, seen.width}));
  }
  return {torch::stack(depths), {}};
}

}  // namespace gld
