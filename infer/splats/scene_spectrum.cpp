#include "infer/splats/scene_spectrum.h"

#include "datasets/splats/splat_picture.h"
#include "gld/machine/stage_record.h"
#include "gld/metrics/latent_spectrum.h"
#include "infer/splats/world_noise.h"

#include <numeric>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

// Colours are averaged over so many pixels a latent pixel, as an autoencoder's latents stand for.
constexpr int64_t kPixelsALatent = 8;

// All views at a square size, fitted ones first: (views, 3, side, side) and their cameras.
struct SizedViews {
  torch::Tensor images;
  std::vector<Camera> cameras;
};
SizedViews sized_views(const Scene& scene, int64_t side, const SpectrumSettings& settings) {
  const SplatFitViews views =
      load_fit_views(scene, ImageSize{side, side}, settings.held_out, settings.kernels);
  SizedViews result;
  std::vector<torch::Tensor> images;
  for (const FittedView* view : all_views(views)) {
    images.push_back(tensor_of(view->target.image));
    result.cameras.push_back(view->camera);
  }
  result.images = torch::stack(images);
  return result;
}

// Returns the rings of views `first` to `end` as they are encoded and as features show them, and pictures of the first.
ViewSpectrum view_spectrum(const StillGaussians& gaussians, const LatentFit& fit,
                           const LatentPictures& latents, int64_t first, int64_t end,
                           const KernelSettings& kernels, SpaceSpectrum* pictures) {
  std::vector<torch::Tensor> encoded, rendered;
  for (int64_t view = first; view < end; ++view) {
    const auto number = static_cast<size_t>(view);
    encoded.push_back(latents.raw(latents.pictures[number]));
    rendered.push_back(latents.raw(
        rendered_features(gaussians, fit.features, latents.camera_of(gaussians.cameras[number]), kernels)));
  }
  const auto of_encoder = torch::stack(encoded), of_splats = torch::stack(rendered);
  const int64_t last = last_whole_ring(of_encoder.size(2));
  if (pictures != nullptr) {
    pictures->encoded_picture = principal_pictures(of_encoder, of_encoder)[0];
    pictures->rendered_picture = principal_pictures(of_splats, of_encoder)[0];
  }
  return {ring_amplitudes(of_encoder, last, SpectrumWindow::kHann),
          ring_amplitudes(of_splats, last, SpectrumWindow::kHann), ring_amplitudes(of_encoder, last),
          ring_amplitudes(of_splats, last)};
}

SpaceSpectrum space_spectrum(const std::string& name, const StillGaussians& gaussians,
                             const LatentPictures& latents, const SpectrumSettings& settings) {
  const LatentFit fit = fit_latents(gaussians, latents, settings.solve, settings.kernels);
  const auto views = static_cast<int64_t>(gaussians.cameras.size());
  SpaceSpectrum result;
  result.space = name;
  result.tag = latents.tag;
  result.fitted = view_spectrum(gaussians, fit, latents, 0, gaussians.fitted, settings.kernels, nullptr);
  result.held_out =
      view_spectrum(gaussians, fit, latents, gaussians.fitted, views, settings.kernels, &result);
  result.held_out_error = latent_error(gaussians, fit, latents, gaussians.fitted, views, settings.kernels);
  return result;
}

LatentTag tag_of(const std::string& space) {
  LatentTag tag;
  tag.model = space;
  return tag;
}

}  // namespace

SceneSpectrum scene_spectrum(const Scene& scene, const SpectrumSettings& settings) {
  SplatFitOptions fit_options = settings.fit;
  const ImageSize size{settings.side, settings.side};
  require_memory_for_fit(scene_fit_work(scene, size, settings.held_out, fit_options), fit_options,
                         available_memory_bytes(), scene.name);
  const SplatFitViews views = load_fit_views(scene, size, settings.held_out, settings.kernels);
  SplatFit fit =
      begin_splat_fit(views.pictures, scene.points_in_world, fit_options, scene.name, settings.kernels);
  while (fit.step < fit_options.steps)
    splat_fit_step(views.fitted, fit_options, static_cast<uint64_t>(settings.seed), settings.kernels, fit);
  SceneSpectrum result;
  result.scene = scene.name;
  result.gaussians = fit.set.size();
  const auto decibels = view_decibels(views.held_out, fit.set, fit_options.projection, settings.kernels);
  result.held_out_psnr =
      std::accumulate(decibels.begin(), decibels.end(), 0.0) / static_cast<double>(decibels.size());

  const SizedViews of_colours = sized_views(scene, settings.latent_side * kPixelsALatent, settings);
  StillGaussians gaussians{fit.set, fit_options.projection, of_colours.cameras,
                           static_cast<int64_t>(views.fitted.size())};
  result.picture = of_colours.images[gaussians.fitted];
  result.spaces.push_back(space_spectrum(
      kColourSpace, gaussians,
      latent_pictures_of(torch::avg_pool2d(of_colours.images, kPixelsALatent), tag_of(kColourSpace)),
      settings));

  const WorldNoise noise = make_world_noise(typical_pixel(gaussians, settings.latent_side, settings.kernels),
                                            static_cast<uint64_t>(settings.seed));
  std::vector<torch::Tensor> textures;
  for (const Camera& camera : gaussians.cameras)
    textures.push_back(noise_picture(noise, gaussians, camera, settings.latent_side, settings.kernels));
  result.spaces.push_back(space_spectrum(
      kNoiseSpace, gaussians, latent_pictures_of(torch::stack(textures), tag_of(kNoiseSpace)), settings));

  for (const ModelBundle& model : settings.models) {
    const BundleOptions& options = model.options();
    const SizedViews sized = sized_views(
        scene, image_size_of_latents(options, settings.latent_side, settings.latent_side).width, settings);
    gaussians.cameras = sized.cameras;
    for (const LatentPictures& latents :
         LatentEncoding(model)(sized.images, latent_levels(settings.levels, options, "--levels"))) {
      const std::string name = options.backbone.levels() == 1
                                   ? options.name
                                   : fmt::format("{}, level {}", options.name, latents.tag.level);
      result.spaces.push_back(space_spectrum(name, gaussians, latents, settings));
    }
  }
  return result;
}

}  // namespace gld
