#include "models/splats/latent_fit.h"

#include "gld/base/json_text.h"
#include "gld/base/sha256.h"
#include "gld/machine/timing.h"
#include "gld/tensors/weight_tensors.h"

#include <cmath>
#include <map>
#include <utility>

#include <fmt/format.h>

namespace gld {

torch::Tensor feature_tensor(const std::vector<float>& values, int64_t channels) {
  const auto rows = static_cast<int64_t>(values.size()) / channels;
  return torch::from_blob(const_cast<float*>(values.data()), {rows, channels}, torch::kFloat32).clone();
}

LatentFit fit_latents(const StillGaussians& gaussians, const LatentPictures& latents,
                      const FeatureSolveOptions& options, const KernelSettings& settings) {
  LatentFit fit;
  fit.tag = latents.tag;
  fit.statistics = latents.statistics;
  fit.seconds = seconds_of([&] {
    std::vector<FeatureView> views;
    for (int64_t view = 0; view < gaussians.fitted; ++view) {
      const auto number = static_cast<size_t>(view);
      const Camera camera = latents.camera_of(gaussians.cameras[number]);
      views.push_back(
          {view_of_splats(gaussians.set, splat_camera(camera, gaussians.set.origin, gaussians.projection),
                          settings),
           latents.pictures[number]});
    }
    const SolvedFeatures solved = solve_features(views, gaussians.set.size(), options, settings);
    fit.features = feature_tensor(solved.features, latents.tag.channels);
    fit.iterations = solved.iterations();
    fit.residual = solved.residuals.back();
  });
  return fit;
}

SplatImage rendered_features(const StillGaussians& gaussians, const torch::Tensor& features,
                             const Camera& over_latents, const KernelSettings& settings) {
  const auto values = features.contiguous();
  SplatFeatures given;
  given.values = values.data_ptr<float>();
  given.channels = values.size(1);
  given.by_index = true;
  const SplatView view = view_of_splats(
      gaussians.set, splat_camera(over_latents, gaussians.set.origin, gaussians.projection), settings);
  return composite(view, given, settings).image;
}

double latent_error(const StillGaussians& gaussians, const LatentFit& fit, const LatentPictures& latents,
                    int64_t first, int64_t end, const KernelSettings& settings) {
  std::vector<torch::Tensor> rendered, encoded;
  for (int64_t view = first; view < end; ++view) {
    const auto number = static_cast<size_t>(view);
    rendered.push_back(tensor_of(
        rendered_features(gaussians, fit.features, latents.camera_of(gaussians.cameras[number]), settings)));
    encoded.push_back(tensor_of(latents.pictures[number]));
  }
  const auto truth = torch::stack(encoded).to(torch::kFloat64);
  const auto apart = torch::stack(rendered).to(torch::kFloat64) - truth;
  const auto spread = truth - truth.mean({0, 2, 3}, true);
  return std::sqrt(apart.square().sum().item<double>() / spread.square().sum().item<double>());
}

void save_latent_fits(const std::filesystem::path& file, const std::vector<LatentFit>& fits,
                      const std::filesystem::path& splats,
                      const std::vector<std::pair<std::string, std::string>>& notes) {
  std::map<std::string, torch::Tensor> tensors;
  nlohmann::ordered_json tags = nlohmann::ordered_json::object();
  for (const LatentFit& fit : fits) {
    const std::string name = fmt::format("level{}", fit.tag.level);
    tensors[name + ".features"] = fit.features;
    tensors[name + ".mean"] = fit.statistics.mean;
    tensors[name + ".deviation"] = (fit.statistics.variance + fit.statistics.epsilon).sqrt();
    tags[name] = tag_json(fit.tag);
  }
  std::map<std::string, std::string> metadata(notes.begin(), notes.end());
  metadata["gld:latent_space"] = json_text(tags);
  metadata["gld:splats"] = sha256_of_file(splats);
  save_safetensors(file, tensors, metadata);
}

}  // namespace gld
