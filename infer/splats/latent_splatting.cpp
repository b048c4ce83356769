#include "infer/splats/latent_splatting.h"

#include "datasets/loading/batching.h"
#include "datasets/splats/splat_picture.h"
#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/machine/stage_record.h"
#include "gld/machine/timing.h"

#include <utility>

namespace gld {
namespace {

// Keeps as many of them as asked for, evenly spread; the first and the last stay.
template <class View>
void thin_out(std::vector<View>& views, int64_t wanted) {
  const auto count = static_cast<int64_t>(views.size());
  if (wanted == 0 || wanted >= count) return;
  std::vector<View> kept;
  for (int64_t i = 0; i < wanted; ++i) {
    const int64_t from = wanted == 1 ? count / 2 : (i * (count - 1) + (wanted - 1) / 2) / (wanted - 1);
    kept.push_back(std::move(views[static_cast<size_t>(from)]));
  }
  views = std::move(kept);
}

// Returns depth of all views, fitted ones first; undefined where one has none.
torch::Tensor depth_of(const SplatFitViews& views) {
  std::vector<torch::Tensor> maps;
  const auto take = [&maps](const DepthMap& depth) {
    if (!depth.empty()) maps.push_back(to_tensor(depth));
  };
  for (const SplatPicture& picture : views.pictures) take(picture.depth);
  for (const DepthMap& depth : views.held_out_depth) take(depth);
  return maps.size() == views.fitted.size() + views.held_out.size() ? torch::stack(maps) : torch::Tensor();
}

}  // namespace

LatentSplattingOptions::LatentSplattingOptions() {
  fit.density.most_gaussians = 30000;
  fit.steps = 1000;
}

void LatentSplattingOptions::visit(FieldVisitor& visitor) {
  visitor.text({"model", "the model bundle whose latents are splatted and decoded"}, model);
  visit_side(visitor, side);
  visitor.integer({"held_out", "views that are not fitted but compared with, evenly spread over the scene"},
                  held_out, {1, 100000});
  visitor.integer({"input_views", "of the others so many are fitted, evenly spread; 0: all"}, input_views,
                  {0, 100000});
  visit_seed(visitor, seed, "the order of views and what density control draws");
  visit_threads(visitor, threads);
  visitor.group({"fit", "how Gaussians are fitted"}, fit);
  visitor.group({"solve", "how features are solved for"}, solve);
}

void LatentSplattingOptions::check() const { fit.check(); }

ScenesSplattingOptions::ScenesSplattingOptions() {
  generator.frames = 35;
  generator.width = generator.height = 256;
}

void ScenesSplattingOptions::visit(FieldVisitor& visitor) {
  visit_scenes(visitor, scenes, "generated ones");
  visitor.integer({"synthetic", "number of generated scenes"}, synthetic, {0, 1'000'000});
  visitor.integer({"synthetic_seed", "seed of the generated scenes"}, synthetic_seed, {0, 1'000'000'000'000});
  visitor.group({"generator", "generated scenes; seed and number come from the options above"}, generator);
  visit_out(visitor, out, overwrite);
  LatentSplattingOptions::visit(visitor);
}

void ScenesSplattingOptions::check() const {
  LatentSplattingOptions::check();
  check_out(out, "runs/splats");
  if (scenes.empty() && synthetic == 0) {
    fail({"scenes", "--scenes DIR or --synthetic N", "neither", "give one of them"});
  }
}

torch::Tensor LatentSplats::shown(size_t level, const KernelSettings& settings) const {
  return rendered_views(gaussians(), fits[level].features, levels[level], fitted, views(), settings);
}

torch::Tensor LatentSplats::encoded(size_t level, int64_t first, int64_t end) const {
  return levels[level].views(first, end);
}

torch::Tensor LatentSplats::colours(const KernelSettings& settings) const {
  std::vector<torch::Tensor> pictures;
  for (int64_t view = fitted; view < views(); ++view) {
    const Camera& camera = cameras[static_cast<size_t>(view)];
    pictures.push_back(tensor_of(splat_picture(fit.set, camera, projection, settings).image));
  }
  return torch::stack(pictures);
}

std::vector<torch::Tensor> LatentSplats::encoded_colours(const torch::Tensor& colours,
                                                         const LatentEncoding& encoding) const {
  const int64_t beside = encoding.encodes_alone() ? 0 : fitted;
  const auto pictures = torch::cat({images.slice(0, 0, beside), colours.clamp(0, 1)});
  const auto of_levels = encoding(pictures, decoded_levels(encoding.options()));
  std::vector<torch::Tensor> encoded;
  for (size_t level = 0; level < of_levels.size(); ++level) {
    // Levels without statistics in the model are normalised by those of the views, which are others here.
    const LatentPictures& of_colours = of_levels[level];
    const auto raw = raw_latents(of_colours.views(beside, beside + colours.size(0)), of_colours.statistics);
    encoded.push_back(normalised_latents(raw, levels[level].statistics));
  }
  return encoded;
}

LatentSplats splat_latents(const Scene& scene, const LatentEncoding& encoding,
                           const LatentSplattingOptions& options, const KernelSettings& settings) {
  const ImageSize size = latent_image_size(encoding.options(), fit_size(scene, options.side));
  require_memory_for_fit(scene_fit_work(scene, size, options.held_out, options.fit), options.fit,
                         available_memory_bytes(), scene.name);
  SplatFitViews views = load_fit_views(scene, size, options.held_out, settings);
  thin_out(views.fitted, options.input_views);
  thin_out(views.pictures, options.input_views);
  LatentSplats result;
  result.fitted = static_cast<int64_t>(views.fitted.size());
  std::vector<torch::Tensor> images;
  for (const FittedView* view : all_views(views)) {
    images.push_back(tensor_of(view->target.image));
    result.cameras.push_back(view->camera);
  }
  result.images = torch::stack(images);
  result.depth = depth_of(views);
  result.levels = encoding(result.images, decoded_levels(encoding.options()));
  give_latents(latent_views(result.levels, result.cameras), views);
  result.seconds = seconds_of([&] {
    SplatFitOptions fit_options = options.fit;
    result.fit = begin_splat_fit(views.pictures, scene.points_in_world, fit_options, scene.name, settings);
    begin_features(views.fitted, fit_options, settings, result.fit);
    while (result.fit.step < fit_options.steps) {
      stop_if_interrupted("in the fit of " + scene.name);
      splat_fit_step(views.fitted, fit_options, static_cast<uint64_t>(options.seed), settings, result.fit);
    }
    result.projection = fit_options.projection;
    for (const LatentPictures& latents : result.levels)
      result.fits.push_back(fit_latents(result.gaussians(), latents, options.solve, settings));
  });
  return result;
}

nlohmann::ordered_json mean_json(const SceneStatistics& statistics) {
  return {{"mean", statistics.mean}, {"interval_95", {statistics.interval.low, statistics.interval.high}}};
}

void require_encoder_and_decoder(const ModelBundle& bundle, const std::string& where) {
  for (const BundlePart& part : {BundlePart::backbone(), bundle.image_decoder_part()}) {
    if (bundle.has(part)) continue;
    fail({where, "a " + bundle_part_name(part) + " with weights", "none",
          "add it with gld convert or gld train"});
  }
}

}  // namespace gld
