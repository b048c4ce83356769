#include "models/scene_geometry/source_warp.h"

#include "gld/cameras/picture_warp.h"
#include "models/scene_geometry/geometry_placement.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include <torch/types.h>

namespace gld {
namespace {

std::vector<float> numbers_of(const torch::Tensor& tensor) {
  const auto values = tensor.to(torch::kCPU, torch::kFloat32).contiguous();
  const float* first = values.data_ptr<float>();
  return {first, first + values.numel()};
}

double median(std::vector<float> values) {
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
  return factor <= 1 ? photographs : torch::avg_pool2d(photographs, factor);
}

// A carried picture with how far it is to be trusted: the less the nearer its camera stood (in median depths: an error
// of depth moves a pixel by its share of that) and the more it covers.
struct RankedPicture {
  CarriedPicture picture;
  double rank = 0;
};

// Those of which something is seen, the most trusted first.
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
    carried.rank = (apart / median(sources[i].depth.values) + kNoParallax) / share;
    ranked.push_back(std::move(carried));
  }
  std::stable_sort(ranked.begin(), ranked.end(),
                   [](const RankedPicture& a, const RankedPicture& b) { return a.rank < b.rank; });
  return ranked;
}

torch::Tensor colours_of(const CarriedPicture& carried) {
  return torch::tensor(at::ArrayRef<float>(carried.rgb), torch::kFloat32)
      .view({carried.height, carried.width, 3})
      .permute({2, 0, 1});
}

// How far a picture agrees with the mean of all at each pixel, (height, width): exp(-mean distance of the colours /
// 0.1) where it is seen, 0 where it is not.
torch::Tensor agreement_of(const CarriedPicture& carried, const torch::Tensor& mean) {
  constexpr double kFarOff = 0.1;
  const auto seen = torch::tensor(at::ArrayRef<uint8_t>(carried.seen), torch::kUInt8)
                        .to(torch::kFloat32)
                        .view({carried.height, carried.width});
  return seen * torch::exp(-(colours_of(carried) - mean).abs().mean(0) / kFarOff);
}

}  // namespace

GeometryInputs geometry_inputs(const LatentSpace& space, const SourceLatents& sources) {
  GeometryInputs inputs;
  for (const auto& level : sources.levels) inputs.levels.push_back(space.decodable(level));
  inputs.leading = sources.levels.back().narrow(1, 0, space.leading_tokens()).contiguous();
  return inputs;
}

std::vector<torch::Tensor> encode_completed(const LatentSpace& space, const torch::Tensor& source_images,
                                            const SourceWarp& warp, int64_t deepest) {
  const auto views = torch::cat({source_images, warp.completed.to(source_images.options())});
  std::vector<torch::Tensor> levels = space.encode(views, deepest);
  for (auto& level : levels) level = level.slice(0, source_images.size(0));
  return levels;
}

SourceWarp no_source_warp(const Views& views, int64_t count, const std::string& doubt) {
  const Camera& camera = views.cameras.front();
  return {torch::zeros({views.num_targets(), count, camera.height, camera.width}), {}, doubt};
}

SourceWarp warp_sources(const Views& views, const torch::Tensor& source_images,
                        const GeometryOutput& source_geometry, int64_t count) {
  if (views.num_sources < 2) {
    return no_source_warp(views, count, "the depth of a single source view has no scale");
  }
  const std::vector<Camera> given(views.cameras.begin(),
                                  views.cameras.begin() + static_cast<std::ptrdiff_t>(views.num_sources));
  // Where the rays tell the scale, photographs need not be asked: carry_pictures() matches them anyway.
  GeometryPlacement placement = place_geometry(source_geometry, given);
  if (!placement.scale) {
    ScaleEvidence evidence;
    evidence.photographs = reduced_photographs(source_images);
    placement = place_geometry(source_geometry, given, evidence);
  }
  if (!placement.scale) {
    return no_source_warp(
        views, count,
        "the unit of the source views' depth is not known (" +
            (placement.problem.empty() ? estimates_text(placement.estimates) : placement.problem) + ")");
  }
  std::vector<PicturedView> sources;
  for (int64_t i = 0; i < views.num_sources; ++i) {
    PicturedView source;
    source.camera = given[static_cast<size_t>(i)];
    const auto depth = source_geometry.depth[i];
    source.depth = {depth.size(1), depth.size(0),
                    numbers_of(depth.to(torch::kFloat64) * placement.scale->scale)};
    source.width = source_images.size(3);
    source.height = source_images.size(2);
    source.rgb = numbers_of(source_images[i].permute({1, 2, 0}));
    sources.push_back(std::move(source));
  }
  SourceWarp warp = no_source_warp(views, count, "");
  std::vector<torch::Tensor> completed;
  for (int64_t target = 0; target < views.num_targets(); ++target) {
    const Camera& camera = views.cameras[static_cast<size_t>(views.num_sources + target)];
    auto pictures = carry_pictures(sources, camera);
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

}  // namespace gld
