#pragma once

#include "gld/cameras/camera.h"
#include "infer/evaluate/evaluation_models.h"

#include <cstdint>
#include <optional>
#include <vector>

#include <torch/types.h>

namespace gld {

// Pictures of all views, sources first, encoded together.
struct EncodedPictures {
  torch::Tensor images;               // (views, 3, height, width); undefined where there are none
  std::vector<torch::Tensor> raw;     // (views, leading + patch tokens, channels)
  std::vector<torch::Tensor> levels;  // as decoders take them, (views, tokens, channels)
  LatentGrid grid;
};

EncodedPictures encoded_pictures(const EvaluationModels& models, const torch::Tensor& images);

// Decodes all levels that the decoder takes, or `alone` with the others zero: (views, 3, height, width) on the CPU.
torch::Tensor reconstruction(const EvaluationModels& models, const EncodedPictures& pictures,
                             std::optional<int64_t> alone);

// Returns pictures of the target views encoded beside the sources' and decoded; undefined where there are none.
torch::Tensor through_decoder(const EvaluationModels& models, const torch::Tensor& source_images,
                              const torch::Tensor& images);

}  // namespace gld
