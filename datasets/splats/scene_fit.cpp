#include "datasets/splats/scene_fit.h"

#include "datasets/scenes/resize_crop.h"
#include "datasets/splats/splat_picture.h"
#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/splatting/splat_ply.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include <fmt/format.h>

namespace gld {

void visit_side(FieldVisitor& visitor, int64_t& side) {
  visitor.integer({"side", "pixels of a picture's longer side at most"}, side, {16, 8192});
}

void SceneFitOptions::visit(FieldVisitor& visitor) {
  visit_side(visitor, side);
  visitor.integer({"held_out", "views that are not fitted but compared with, evenly spread over the scene"},
                  held_out, {0, 100000});
  visit_seed(visitor, seed, "the order of views and what density control draws");
  visitor.group({"fit", "how Gaussians are fitted"}, fit);
}

namespace {

std::vector<const Frame*> pictured_frames(const Scene& scene) {
  std::vector<const Frame*> frames;
  for (const Frame& frame : scene.frames) {
    if (frame.has_image()) frames.push_back(&frame);
  }
  return frames;
}

}  // namespace

ImageSize fit_size(const Scene& scene, int64_t side) {
  const auto frames = pictured_frames(scene);
  if (frames.empty()) {
    fail({"scene " + scene.name, "frames with pictures", "none", "give it some"});
  }
  const Camera& first = frames.front()->camera;
  const double shrink =
      std::min(1.0, static_cast<double>(side) / static_cast<double>(std::max(first.width, first.height)));
  return {std::max<int64_t>(1, std::lround(shrink * static_cast<double>(first.width))),
          std::max<int64_t>(1, std::lround(shrink * static_cast<double>(first.height)))};
}

SplatWork scene_fit_work(const Scene& scene, const ImageSize& size, int64_t held_out,
                         const SplatFitOptions& options) {
  SplatWork work;
  const auto frames = static_cast<int64_t>(pictured_frames(scene).size());
  work.views = std::max<int64_t>(1, frames - held_out);
  work.held_out = frames - work.views;
  work.width = size.width;
  work.height = size.height;
  const bool depth = std::any_of(scene.frames.begin(), scene.frames.end(),
                                 [](const Frame& frame) { return frame.has_depth(); });
  work.start = settled_start(options.start.from, depth, !scene.points_in_world.empty());
  work.gaussians = most_gaussians_of(work, options);
  return work;
}

SplatFitViews load_fit_views(const Scene& scene, const ImageSize& size, int64_t held_out,
                             const KernelSettings& settings) {
  const auto frames = pictured_frames(scene);
  const auto count = static_cast<int64_t>(frames.size());
  if (count - held_out < 1) {
    fail({"--held-out", fmt::format("less than the scene's {} views with a picture", count),
          fmt::format("{}", held_out), "keep fewer of them apart"});
  }
  SplatFitViews views;
  int64_t next_held_out = 0;
  for (int64_t i = 0; i < count; ++i) {
    const Frame& frame = *frames[static_cast<size_t>(i)];
    const SizedFrame sized = load_sized(frame, size, FrameParts::kImageAndDepth);
    const auto& valid = sized.validity.valid;
    if (!valid.empty() && std::none_of(valid.begin(), valid.end(), [](uint8_t one) { return one != 0; })) {
      fail({"frame " + frame.name, "a pixel that its mask leaves", "none",
            "leave the frame out of the scene"});
    }
    FittedView view{frame.name,
                    sized.camera,
                    loss_target(splat_image_of(sized.image), sized.validity.valid, settings),
                    {}};
    // The k-th of n stands in the middle of the k-th of n equal parts.
    if (next_held_out < held_out && i == (2 * next_held_out + 1) * count / (2 * held_out)) {
      ++next_held_out;
      views.held_out.push_back(std::move(view));
      views.held_out_depth.push_back(sized.depth);
      continue;
    }
    views.pictures.push_back({sized.camera, sized.image, sized.depth, sized.validity.valid});
    views.fitted.push_back(std::move(view));
  }
  return views;
}

std::vector<const FittedView*> all_views(const SplatFitViews& views) {
  std::vector<const FittedView*> all;
  for (const auto* some : {&views.fitted, &views.held_out}) {
    for (const FittedView& view : *some) all.push_back(&view);
  }
  return all;
}

void give_latents(std::vector<LatentView> latents, SplatFitViews& views) {
  auto next = latents.begin();
  for (auto* some : {&views.fitted, &views.held_out}) {
    for (FittedView& view : *some) view.latent = std::move(*next++);
  }
}

std::vector<double> view_decibels(const std::vector<FittedView>& views, const GaussianSet& set,
                                  const ProjectionOptions& projection, const KernelSettings& settings) {
  std::vector<double> values;
  values.reserve(views.size());
  for (const FittedView& view : views) {
    values.push_back(decibels(
        mean_squared_error(splat_picture(set, view.camera, projection, settings).image, view.target)));
  }
  return values;
}

Provenance splat_provenance(const std::string& scene_name, const SceneFitOptions& options) {
  struct Origin : OptionsGroup {
    std::string scene;
    SceneFitOptions options;
    void visit(FieldVisitor& visitor) override {
      visitor.text({"scene", "its name"}, scene);
      options.visit(visitor);
    }
  } origin;
  origin.scene = scene_name;
  origin.options = options;
  Provenance provenance = make_provenance("splat fit", origin);
  provenance.seed = options.seed;
  return provenance;
}

SceneFit fit_scene(const Scene& scene, const SceneFitOptions& options, const std::string& where,
                   const KernelSettings& settings,
                   const std::function<void(const SplatFitStep&)>& after_step) {
  SplatFitOptions fit_options = options.fit;
  check_without_latents(fit_options);
  SplatFitViews views = load_fit_views(scene, fit_size(scene, options.side), options.held_out, settings);
  SceneFit result;
  result.fit = begin_splat_fit(views.pictures, scene.points_in_world, fit_options, where, settings);
  views.pictures.clear();
  result.started_with = result.fit.set.size();
  result.views = static_cast<int64_t>(views.fitted.size());
  result.near = fit_options.projection.near;
  while (result.fit.step < fit_options.steps) {
    after_step(
        splat_fit_step(views.fitted, fit_options, static_cast<uint64_t>(options.seed), settings, result.fit));
  }
  const auto decibels = view_decibels(views.fitted, result.fit.set, fit_options.projection, settings);
  result.fitted_psnr =
      std::accumulate(decibels.begin(), decibels.end(), 0.0) / static_cast<double>(decibels.size());
  return result;
}

void write_fitted_splats(const std::filesystem::path& file, const GaussianSet& set,
                         const std::string& scene_name, const SceneFitOptions& options) {
  write_splat_ply(file, set, provenance_items(splat_provenance(scene_name, options)));
}

}  // namespace gld
