#include "gld/tensors/tensor_pictures.h"

namespace gld {

std::vector<float> numbers_of(const torch::Tensor& tensor) {
  const auto values = tensor.to(torch::kCPU, torch::kFloat32).contiguous();
  const float* first = values.data_ptr<float>();
  return {first, first + values.numel()};
}

torch::Tensor planes_of(const std::vector<float>& values, int64_t channels, int64_t width, int64_t height) {
  return torch::tensor(at::ArrayRef<float>(values)).view({height, width, channels}).permute({2, 0, 1});
}

torch::Tensor picture_of(const std::vector<float>& rgb, int64_t width, int64_t height) {
  return planes_of(rgb, 3, width, height);
}

std::vector<float> pixels_of(const torch::Tensor& picture) { return numbers_of(picture.permute({1, 2, 0})); }

}  // namespace gld
