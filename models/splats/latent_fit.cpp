#include "models/splats/latent_fit.h"

#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/sha256.h"
#include "gld/latents/relative_latent_error.h"
#include "gld/machine/stage_record.h"
#include "gld/machine/timing.h"
#include "gld/splatting/feature_harmonics.h"
#include "gld/tensors/weight_tensors.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {
namespace {

[[noreturn]] void refuse_features(const std::filesystem::path& file, const std::string& expected,
                                  const std::string& found) {
  fail({file.string(), expected, found, "make it again with gld splat fit --features"});
}

// Returns empty text where the file says nothing.
std::string note_of(const WeightFile& file, const std::string& key) {
  const auto found = file.metadata().find(key);
  return found == file.metadata().end() ? std::string() : found->second;
}

// Returns a tensor of these sizes (0: any) and type, finite.
torch::Tensor checked_tensor(const WeightFile& file, const std::string& name,
                             const std::vector<int64_t>& sizes, torch::Dtype type) {
  auto values = read_tensor(file, name);
  bool as_said = values.dim() == static_cast<int64_t>(sizes.size()) && values.scalar_type() == type;
  for (size_t i = 0; as_said && i < sizes.size(); ++i)
    as_said = sizes[i] == 0 || values.size(static_cast<int64_t>(i)) == sizes[i];
  if (!as_said) {
    refuse_features(
        file.path(),
        fmt::format("{} of shape ({}), {}, 0 being any", name, fmt::join(sizes, ", "), c10::toString(type)),
        fmt::format("{}, {}", c10::str(values.sizes()), c10::toString(values.scalar_type())));
  }
  if (!values.isfinite().all().item<bool>())
    refuse_features(file.path(), fmt::format("finite numbers in {}", name), "NaN or infinity");
  return values;
}

// Returns features of either kind, (gaussians, channels) or (gaussians, coefficients, channels).
torch::Tensor checked_features(const WeightFile& file, const std::string& name, int64_t channels) {
  if (read_tensor(file, name).dim() != 3) return checked_tensor(file, name, {0, channels}, torch::kFloat32);
  auto features = checked_tensor(file, name, {0, 0, channels}, torch::kFloat32);
  if (degree_of_coefficients(features.size(1)) < 1) {
    refuse_features(file.path(), name + " with 4, 9 or 16 coefficients of spherical harmonics",
                    std::to_string(features.size(1)));
  }
  return features;
}

}  // namespace

torch::Tensor feature_tensor(const std::vector<float>& values, int64_t channels) {
  const auto rows = static_cast<int64_t>(values.size()) / channels;
  return torch::from_blob(const_cast<float*>(values.data()), {rows, channels}, torch::kFloat32).clone();
}

namespace {

// Throws Error where the solve would not fit into memory: four tables of 64 channels, and the features twice.
void require_memory_for_solve(int64_t gaussians, const LatentPictures& latents,
                              const FeatureSolveOptions& options) {
  constexpr double kGigabyte = 1e9;
  constexpr int64_t kTables = 4, kTogether = 64, kCopies = 2;
  const int64_t unknowns = gaussians * harmonic_coefficients(options.feature_degree);
  const int64_t needed =
      unknowns * static_cast<int64_t>(sizeof(float)) *
      (kTables * std::min(kTogether, latents.tag.channels) + kCopies * latents.tag.channels);
  const int64_t free_bytes = available_memory_bytes();
  if (free_bytes <= 0 || needed <= free_bytes) return;
  fail({fmt::format("features of level {}", latents.tag.level),
        fmt::format("{:.1f} GB of memory for {} Gaussians, {} channels and harmonics of degree {}",
                    static_cast<double>(needed) / kGigabyte, gaussians, latents.tag.channels,
                    options.feature_degree),
        fmt::format("{:.1f} GB that are free", static_cast<double>(free_bytes) / kGigabyte),
        "make --most-gaussians or --feature-degree smaller"});
}

}  // namespace

LatentFit fit_latents(const StillGaussians& gaussians, const LatentPictures& latents,
                      const FeatureSolveOptions& options, const KernelSettings& settings) {
  require_memory_for_solve(gaussians.set.size(), latents, options);
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
    const SolvedFeatures solved = solve_features(views, gaussians.set, options, settings);
    fit.features = feature_tensor(solved.features, latents.tag.channels);
    if (options.feature_degree > 0) {
      fit.features =
          fit.features.reshape({gaussians.set.size(), harmonic_coefficients(options.feature_degree), -1});
    }
    fit.iterations = solved.iterations();
    fit.residual = solved.residuals.back();
  });
  return fit;
}

SplatImage rendered_features(const StillGaussians& gaussians, const torch::Tensor& features,
                             const Camera& over_latents, const KernelSettings& settings) {
  const auto values = features.contiguous();
  const SplatView view = view_of_splats(
      gaussians.set, splat_camera(over_latents, gaussians.set.origin, gaussians.projection), settings);
  SplatFeatures given;
  given.values = values.data_ptr<float>();
  given.channels = values.size(-1);
  given.by_index = values.dim() == 2;
  std::vector<float> seen;
  if (!given.by_index) {
    seen = seen_features(gaussians.set, view, given.values, degree_of_coefficients(values.size(1)),
                         given.channels, settings);
    given.values = seen.data();
  }
  return composite(view, given, settings).image;
}

torch::Tensor rendered_views(const StillGaussians& gaussians, const torch::Tensor& features,
                             const LatentPictures& latents, int64_t first, int64_t end,
                             const KernelSettings& settings) {
  std::vector<torch::Tensor> rendered;
  for (int64_t view = first; view < end; ++view) {
    const Camera over = latents.camera_of(gaussians.cameras[static_cast<size_t>(view)]);
    rendered.push_back(tensor_of(rendered_features(gaussians, features, over, settings)));
  }
  return torch::stack(rendered);
}

double latent_error(const StillGaussians& gaussians, const LatentFit& fit, const LatentPictures& latents,
                    int64_t first, int64_t end, const KernelSettings& settings) {
  return relative_latent_error(rendered_views(gaussians, fit.features, latents, first, end, settings),
                               latents.views(first, end));
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
    if (fit.encoded.defined()) tensors[name + ".encoded"] = fit.encoded.to(torch::kFloat16);
    tags[name] = tag_json(fit.tag);
  }
  std::map<std::string, std::string> metadata(notes.begin(), notes.end());
  metadata["gld:latent_space"] = json_text(tags);
  metadata["gld:splats"] = sha256_of_file(splats);
  save_safetensors(file, tensors, metadata);
}

std::vector<LatentFit> read_latent_fits(const std::filesystem::path& file,
                                        const std::filesystem::path& splats) {
  const auto weights = WeightFile::open(file);
  if (note_of(*weights, "gld:splats") != sha256_of_file(splats))
    refuse_features(file, "features of the Gaussians of " + splats.string(), "those of another file");
  const auto tags =
      nlohmann::json::parse(note_of(*weights, "gld:latent_space"), nullptr, /*allow_exceptions=*/false);
  if (!tags.is_object())
    refuse_features(file, "the latent spaces that gld splat fit writes", "something else");
  std::vector<LatentFit> fits;
  for (const auto& item : tags.items()) {
    const std::string& name = item.key();
    const auto tag = tag_of_json(item.value());
    if (!tag) refuse_features(file, "the latent space of " + name, "something else");
    LatentFit fit;
    fit.tag = *tag;
    fit.features = checked_features(*weights, name + ".features", tag->channels);
    fit.statistics.mean = checked_tensor(*weights, name + ".mean", {tag->channels}, torch::kFloat32);
    fit.statistics.variance =
        checked_tensor(*weights, name + ".deviation", {tag->channels}, torch::kFloat32).square();
    fit.statistics.epsilon = 0;
    const std::string encoded = name + ".encoded";
    if (weights->find(encoded) != nullptr) {
      fit.encoded =
          checked_tensor(*weights, encoded, {0, tag->channels, tag->height, tag->width}, torch::kFloat16)
              .to(torch::kFloat32);
    }
    fits.push_back(std::move(fit));
  }
  std::sort(fits.begin(), fits.end(),
            [](const LatentFit& a, const LatentFit& b) { return a.tag.level < b.tag.level; });
  return fits;
}

}  // namespace gld
