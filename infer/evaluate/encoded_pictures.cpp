#include "infer/evaluate/encoded_pictures.h"

#include "models/conditioning/decoder_inputs.h"

namespace gld {

EncodedPictures encoded_pictures(const EvaluationModels& models, const torch::Tensor& images) {
  EncodedPictures pictures;
  pictures.images = images;
  const auto backbone = models.models.backbone();
  const auto& architecture = backbone->architecture();
  pictures.grid = architecture.grid_of(images.size(0), images.size(2), images.size(3));
  pictures.raw = backbone->encode(images.to(models.device), architecture.levels() - 1);
  for (const auto& level : pictures.raw) pictures.levels.push_back(backbone->decodable(level).patches);
  return pictures;
}

torch::Tensor reconstruction(const EvaluationModels& models, const EncodedPictures& pictures,
                             std::optional<int64_t> alone) {
  auto levels = pictures.levels;
  for (size_t level = 0; alone && level < levels.size(); ++level) {
    if (static_cast<int64_t>(level) != *alone) levels[level] = torch::Tensor();
  }
  const auto features = image_features(levels, models.models.levels.decoded_levels());
  return models.models.rgb_decoder()->decode(features, pictures.grid).to(torch::kCPU);
}

torch::Tensor through_decoder(const EvaluationModels& models, const torch::Tensor& source_images,
                              const torch::Tensor& images) {
  if (!images.defined()) return {};
  return reconstruction(models, encoded_pictures(models, torch::cat({source_images, images})), std::nullopt)
      .narrow(0, source_images.size(0), images.size(0));
}

}  // namespace gld
