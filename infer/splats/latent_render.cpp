#include "infer/splats/latent_render.h"

#include "datasets/formats/cameras_json.h"
#include "datasets/loading/batching.h"
#include "datasets/splats/splat_picture.h"
#include "gld/base/error.h"
#include "gld/cameras/resized_camera.h"
#include "gld/report/report_text.h"
#include "gld/tensors/compute_threads.h"
#include "infer/splats/latent_splatting.h"
#include "models/bundle/part_lineage.h"
#include "models/refiner/latent_refining.h"
#include "models/splats/splat_refiner.h"
#include "models/splats/splatted_scene.h"

#include <algorithm>
#include <memory>
#include <utility>

#include <torch/autograd.h>

#include <fmt/format.h>

namespace gld {
namespace {

// This draws latents of a run of gld splat fit --features.
struct LatentDrawing {
  DrawnSplats splats;
  LatentDecoding decoding;
  std::vector<LatentFit> fits;
  std::shared_ptr<const DenoisingUnet> refiner;
  std::unique_ptr<LatentRefining> refining;
  std::unique_ptr<LatentEncoding> encoding;  // of refiners of colours that are encoded

  // Returns what is shown of a level, (channels, height, width), normalised.
  torch::Tensor latents_of(const LatentFit& fit, const Camera& camera) const {
    if (encoding) {
      const ImageSize size = image_size_of_latents(encoding->options(), fit.tag.width, fit.tag.height);
      const Camera over = resized_camera(camera, size.width, size.height);
      const auto colours =
          tensor_of(splat_picture(splats.set, over, splats.projection, splats.settings).image);
      return (*encoding)(colours.clamp(0, 1).unsqueeze(0), {fit.tag.level}).front().views(0, 1)[0];
    }
    const StillGaussians still{splats.set, splats.projection, {}, 0};
    const Camera over = resized_camera(camera, fit.tag.width, fit.tag.height);
    return tensor_of(rendered_features(still, fit.features, over, splats.settings));
  }

  Image operator()(Camera& camera) const {
    const torch::NoGradGuard no_grad;
    std::vector<torch::Tensor> maps;
    for (const LatentFit& fit : fits) {
      auto latents = latents_of(fit, camera);
      if (refining) latents = (*refining)(camera, latents);
      maps.push_back(raw_latents(latents.unsqueeze(0), fit.statistics));
    }
    const auto picture = decoding(maps)[0].clamp(0, 1);
    camera = resized_camera(camera, picture.size(2), picture.size(1));
    return to_image(picture);
  }
};

std::vector<LatentFit> fits_of(const SplatRenderOptions& options, const DrawnSplats& splats,
                               const ModelBundle& bundle) {
  const std::filesystem::path file = std::filesystem::path(options.splats) / kSplatFeaturesFile;
  if (!std::filesystem::is_regular_file(file)) {
    fail({options.splats, std::string("features beside the Gaussians, ") + kSplatFeaturesFile, "none",
          "make them with gld splat fit --features 0 --model " + options.model});
  }
  std::vector<LatentFit> fits;
  const std::vector<int64_t> decoded = decoded_levels(bundle.options());
  for (LatentFit& fit : read_latent_fits(file, splats.file)) {
    if (std::find(decoded.begin(), decoded.end(), fit.tag.level) != decoded.end())
      fits.push_back(std::move(fit));
  }
  if (fits.size() != decoded.size()) {
    fail({file.string(),
          fmt::format("the {} levels that {} decodes images of", decoded.size(), bundle.options().name),
          fmt::format("{} of them", fits.size()), "fit them with gld splat fit --features all"});
  }
  for (const LatentFit& fit : fits) {
    require_same_latent_space(fit.tag, bundle, file.string());
    if (fit.features.size(0) != splats.set.size()) {
      fail({file.string(), fmt::format("features of {} Gaussians", splats.set.size()),
            std::to_string(fit.features.size(0)), "make it again with gld splat fit --features"});
    }
  }
  return fits;
}

std::vector<Camera> fitted_cameras(const std::filesystem::path& run) {
  std::vector<Camera> cameras;
  for (const CameraRecord& record : read_cameras_json(splat_file_in(run, kSplatCamerasFile)).records) {
    if (record.role == "source") cameras.push_back(record.camera);
  }
  return cameras;
}

DrawSplats latent_drawing(const SplatRenderOptions& options, const DrawnSplats& splats) {
  use_threads(options.threads);
  const ModelBundle bundle = ModelBundle::open(options.model);
  require_encoder_and_decoder(bundle, options.model);
  const auto drawing = std::make_shared<LatentDrawing>(LatentDrawing{
      splats, LatentDecoding(bundle), fits_of(options, splats, bundle), nullptr, nullptr, nullptr});
  if (options.show == SplatShown::kRefined) {
    if (!has_splat_refiner(bundle)) {
      fail({options.model, "a refiner with weights", "none",
            "train one with gld train refiner, or --show latents"});
    }
    print_warnings(mixed_parts(bundle, {BundlePart::refiner()}, /*allow_mixed=*/false));
    const LatentFit& fit = drawing->fits.front();
    require_same_normalisation(fit.tag, bundle, options.splats);
    // Of the fit itself, whatever cameras the path is about.
    const std::vector<Camera> fitted = fitted_cameras(options.splats);
    const int64_t encoded = fit.encoded.defined() ? fit.encoded.size(0) : 0;
    if (encoded != static_cast<int64_t>(fitted.size())) {
      fail({options.splats,
            fmt::format("what its {} fitted views are encoded as, which the refiner looks at", fitted.size()),
            encoded == 0 ? "none" : fmt::format("{} views", encoded),
            "fit them again with gld splat fit --features 0 --model " + options.model});
    }
    drawing->refiner = bundle.load_refiner();
    drawing->refining = std::make_unique<LatentRefining>(*drawing->refiner, fitted, fit.encoded);
    if (bundle.options().refiner.degraded == DegradedLatents::kColours)
      drawing->encoding = std::make_unique<LatentEncoding>(bundle);
  }
  return [drawing](Camera& camera) { return (*drawing)(camera); };
}

}  // namespace

void run_splat_render_with_latents(const SplatRenderOptions& options) {
  run_splat_render(options, [&](const DrawnSplats& splats) { return latent_drawing(options, splats); });
}

}  // namespace gld
