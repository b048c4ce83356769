#include "models/scene_geometry/photograph_depth.h"

#include "gld/cameras/resized_camera.h"
#include "gld/photogrammetry/edge_following_depth.h"
#include "gld/photogrammetry/fused_view_depth.h"
#include "gld/photogrammetry/matched_source_depth.h"
#include "gld/photogrammetry/photograph_composition.h"
#include "gld/tensors/tensor_pictures.h"
#include "gld/tensors/torch_version.h"
#include "models/scene_geometry/source_warp.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace gld {
namespace {

// Returns how far photographs confirm that depth of a view; empty where it is of another size, which is not what was
// matched.
ConfidenceMap confirmation(const StereoDepth& matched, const PlanarDepth& depth) {
  return matched.confidence.values.size() == depth.values.size() ? matched.confidence : ConfidenceMap();
}

PhotographDepth depth_of_head(const Views& views, const torch::Tensor& source_images,
                              const GeometryOutput* head, double single_source_unit) {
  PhotographDepth result;
  result.depth = head != nullptr ? source_depth_of_head(views, source_images, *head, single_source_unit)
                                 : source_depth_of_head(views, source_images, {}, /*single_source_unit=*/0);
  result.head = result.depth.views;
  return result;
}

// Returns the depth of two photographs or more.
PhotographDepth matched_depth(const Views& views, const torch::Tensor& source_images,
                              const SourcePhotographs& photographs, const GeometryOutput* head,
                              const StereoOptions& options) {
  std::vector<PicturedView> matched = photographs.views;
  if (head != nullptr) {
    for (size_t i = 0; i < matched.size(); ++i) {
      const auto map = head->depth[static_cast<int64_t>(i)];
      matched[i].depth = {map.size(1), map.size(0), numbers_of(map)};
    }
  }
  KernelSettings settings;
  settings.threads = static_cast<int>(thread_count());
  StereoScene stereo = stereo_depth(matched, photographs.points_in_world, options, settings);
  PhotographDepth result;
  // The prior's unit is free: photographs that agree nowhere leave it open.
  const bool open_unit = head != nullptr && (!stereo.prior || stereo.prior->pixels == 0);
  if (open_unit) {
    result = depth_of_head(views, source_images, head, /*single_source_unit=*/0);
  } else {
    result.depth = matched_source_depth(stereo);
    result.depth.from = head != nullptr ? "photographs and geometry head" : "photographs";
    if (head != nullptr) result.head = depth_in_unit(*head, views.num_sources, stereo.prior->scale);
  }
  result.stereo = std::move(stereo);
  return result;
}

// Neither a network that has seen rooms nor an edge brings nearer what photographs show to be far. The depth may have
// another size than what was matched.
void keep_far(const StereoScene& stereo, size_t view, PlanarDepth& depth) {
  if (view >= stereo.views.size()) return;
  const PlanarDepth& least = stereo.views[view].least;
  for (int64_t y = 0; y < depth.height; ++y) {
    for (int64_t x = 0; x < depth.width; ++x) {
      const int64_t row = (2 * y + 1) * least.height / (2 * depth.height);
      const int64_t column = (2 * x + 1) * least.width / (2 * depth.width);
      float& value = depth.values[static_cast<size_t>(y * depth.width + x)];
      value = std::max(value, least.values[static_cast<size_t>(row * least.width + column)]);
    }
  }
}

// What photographs confirm stays.
void follow_edges(const SourcePhotographs& photographs, PhotographDepth& found) {
  for (size_t view = 0; view < found.depth.views.size(); ++view) {
    PlanarDepth& depth = found.depth.views[view];
    const ConfidenceMap confirmed =
        view < found.stereo.views.size() ? confirmation(found.stereo.views[view], depth) : ConfidenceMap();
    depth = edge_following_depth(depth, photographs.views[view], confirmed, static_cast<int>(thread_count()));
  }
}

}  // namespace

SourcePhotographs photographs_of_images(const Views& views, const torch::Tensor& source_images) {
  SourcePhotographs photographs;
  for (int64_t i = 0; i < source_images.size(0); ++i) {
    PicturedView view;
    view.camera = views.cameras[static_cast<size_t>(i)];
    view.width = source_images.size(3);
    view.height = source_images.size(2);
    view.rgb = pixels_of(source_images[i]);
    photographs.views.push_back(std::move(view));
  }
  return photographs;
}

PhotographDepth photograph_depth(const Views& views, const torch::Tensor& source_images,
                                 const SourcePhotographs& photographs, const GeometryOutput* head,
                                 const PhotographDepthOptions& options) {
  PhotographDepth found;
  if (!options.stereo || views.num_sources == 1) {
    found = depth_of_head(views, source_images, head, options.single_source_unit);
  } else {
    found = matched_depth(views, source_images, photographs, head, *options.stereo);
    if (options.refinement != nullptr) refine(*options.refinement, photographs, found);
  }
  if (options.follows_edges) follow_edges(photographs, found);
  for (size_t view = 0; view < found.depth.views.size(); ++view)
    keep_far(found.stereo, view, found.depth.views[view]);
  return found;
}

std::optional<ToldDepth> told_depth(const SourcePhotographs& photographs, const PhotographDepth& found,
                                    int64_t side) {
  if (!found.depth.known() || found.head.empty() || found.stereo.views.empty()) return std::nullopt;
  ToldDepth told;
  told.head = found.head;
  told.belief = belief_in_prior(found.stereo.prior);
  for (size_t i = 0; i < photographs.views.size(); ++i) {
    told.photographs.push_back(reduced_view(photographs.views[i], side));
    told.photographs.back().depth = found.depth.views[i];
    told.confidence.push_back(confirmation(found.stereo.views[i], found.depth.views[i]));
  }
  return told;
}

void refine(const DepthRefinement& refinement, const SourcePhotographs& photographs, PhotographDepth& found) {
  const auto told = told_depth(photographs, found, refinement.options().side);
  if (!told) return;
  found.depth.views = refined_depths(refinement, *told);
  found.depth.from += ", mended by a network";
}

std::vector<PlanarDepth> fused_view_depths(const Views& views, const torch::Tensor& source_images,
                                           const SourceDepth& depth, const StereoScene& stereo,
                                           const torch::Tensor& predicted) {
  constexpr double kEnough = 0.1;
  if (stereo.confident_share() < kEnough) return {};
  // As large as the model sees them: the predicted depth is no larger.
  const SourcePhotographs pictures = photographs_of_images(views, source_images);
  std::vector<ConfirmedDepth> sources;
  for (size_t i = 0; i < depth.views.size(); ++i) {
    ConfirmedDepth source{pictures.views[i], confirmation(stereo.views[i], depth.views[i])};
    source.view.depth = depth.views[i];
    sources.push_back(std::move(source));
  }
  std::vector<FusedViewDepth> fused;
  double log_units = 0, told = 0;
  const auto maps = predicted.to(torch::kCPU, torch::kFloat32);
  const auto first = static_cast<size_t>(views.size() - maps.size(0));
  const double believed = belief_in_prior(stereo.prior);
  const auto head = [&](size_t view) {
    const auto map = maps[static_cast<int64_t>(view - first)];
    return PredictedDepth{{map.size(1), map.size(0), numbers_of(map)}, believed};
  };
  for (size_t view = first; view < views.cameras.size(); ++view) {
    fused.push_back(view < sources.size()
                        ? fused_source_depth(sources[view], head(view))
                        : fused_target_depth(sources, depth.reach, views.cameras[view], head(view)));
    if (fused.back().depth.values.empty()) continue;
    log_units += std::log(fused.back().unit);
    told += 1;
  }
  std::vector<PlanarDepth> depths;
  if (told == 0) return depths;
  for (size_t i = 0; i < fused.size(); ++i) {
    if (fused[i].depth.values.empty()) {
      fused[i].depth = head(first + i).depth;
      for (float& value : fused[i].depth.values)
        value = static_cast<float>(static_cast<double>(value) * std::exp(log_units / told));
    }
    depths.push_back(std::move(fused[i].depth));
    if (first + i < sources.size()) keep_far(stereo, first + i, depths.back());
  }
  return depths;
}

}  // namespace gld
