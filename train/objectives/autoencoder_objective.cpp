#include "train/objectives/autoencoder_objective.h"

#include "gld/base/error.h"
#include "gld/metrics/metric_list.h"
#include "models/layers/layer_precision.h"
#include "models/weights/weight_loading.h"
#include "train/objectives/scene_pixels.h"

#include <algorithm>
#include <string>
#include <utility>

#include <ATen/CPUGeneratorImpl.h>

#include <fmt/format.h>

namespace gld {
namespace {

// Returns a square of that side of each image, wherever the generator puts it; all of images that are no larger.
torch::Tensor cropped(const torch::Tensor& images, int64_t side, torch::Generator generator) {
  const int64_t height = images.size(2), width = images.size(3);
  if (side == 0 || (height <= side && width <= side)) return images;
  const auto place = [&](int64_t room) {
    return torch::randint(0, std::max<int64_t>(room, 0) + 1, {1}, generator, torch::kInt64).item<int64_t>();
  };
  std::vector<torch::Tensor> squares;
  for (int64_t view = 0; view < images.size(0); ++view) {
    const int64_t top = place(height - side), left = place(width - side);
    squares.push_back(
        images[view].narrow(1, top, std::min(side, height)).narrow(2, left, std::min(side, width)));
  }
  return torch::stack(squares);
}

}  // namespace

void AutoencoderObjectiveOptions::visit(FieldVisitor& visitor) {
  visitor.real({"reconstruction_weight", "of the absolute error of images"}, reconstruction_weight, {0, 1e6});
  visitor.real({"divergence_weight", "of the latents' distance from standard normal ones"}, divergence_weight,
               {0, 1e6});
  visitor.integer({"crop", "side in pixels of the square of each image that is learnt from; 0: all of it"},
                  crop, {0, 65536});
}

AutoencoderObjective::AutoencoderObjective(const BundleOptions& model,
                                           const AutoencoderObjectiveOptions& options,
                                           const ParameterPlacement& placement, int64_t seed,
                                           std::shared_ptr<Backbone> trained)
    : model_(model), options_(options), placement_(placement), backbone_(std::move(trained)) {
  const int64_t side = model_.backbone.patch_side();
  if (options_.crop % side != 0) {
    fail({"autoencoder.crop", fmt::format("0 or a multiple of {}, the autoencoder's patches", side),
          std::to_string(options_.crop), "choose whole patches"});
  }
  if (backbone_) return;
  backbone_ = model_.backbone.make(placement);
  backbone_->initialise(at::detail::createCPUGenerator(static_cast<uint64_t>(seed)));
}

int64_t AutoencoderObjective::learn_in(ComputePrecision precision) {
  return gld::learn_in(*backbone_, precision);
}

std::vector<NamedParameter> AutoencoderObjective::parameters() const {
  return named_parameters(*backbone_, model_.backbone.architecture().published_prefix());
}

std::vector<NamedParameter> AutoencoderObjective::untrained() const {
  return named_untrained(*backbone_, model_.backbone.architecture().published_prefix());
}

Losses AutoencoderObjective::losses(const TrainingBatch& batch, const StepContext& context) {
  const double share = 1.0 / static_cast<double>(batch.scenes.size());
  Losses losses;
  PartMeans parts;
  for (const TrainingScene& scene : batch.scenes) {
    const auto images = cropped(scene.images, options_.crop, context.generator).to(placement_.device);
    const Autoencoding made = backbone_->autoencode(images, context.generator);
    const auto error = (made.images - images).abs().mean();
    const auto total = options_.reconstruction_weight * error + options_.divergence_weight * made.divergence;
    losses.total = losses.total.defined() ? losses.total + share * total : share * total;
    parts.add("reconstruction", error);
    parts.add("divergence", made.divergence);
  }
  losses.parts = parts.take();
  return losses;
}

Validation AutoencoderObjective::validate(const std::vector<TrainingScene>& scenes) {
  Validation validation;
  double psnr = 0, error = 0;
  for (const TrainingScene& scene : scenes) {
    const auto images = scene.images.to(placement_.device);
    const auto grid = model_.backbone.grid_of(images.size(0), images.size(2), images.size(3));
    const auto decoded = backbone_->decode(backbone_->encode(images, 0).front(), grid);
    error += (decoded - images).abs().mean().item<double>();
    psnr += measure_images(metric_named("psnr"), images, decoded).mean();
    if (validation.rows.size() >= 4) continue;
    PictureRow row;
    row.name = scene.name;
    for (int64_t view = 0; view < std::min<int64_t>(scene.views.size(), 2); ++view) {
      row.pictures.emplace_back("image", images[view].to(torch::kCPU));
      row.pictures.emplace_back("decoded", decoded[view].to(torch::kCPU).clamp(0.0, 1.0));
    }
    validation.rows.push_back(std::move(row));
  }
  const auto count = static_cast<double>(scenes.size());
  validation.values = {{"reconstruction", error / count}, {"psnr", psnr / count}};
  return validation;
}

void AutoencoderObjective::export_model(const std::filesystem::path& folder, DType dtype) const {
  save_bundle_options(folder, model_);
  save_bundle_part(folder, BundlePart::backbone(), named_tensors(*backbone_), dtype);
}

}  // namespace gld
