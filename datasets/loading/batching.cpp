#include "datasets/loading/batching.h"

#include "gld/base/error.h"

#include <algorithm>

namespace gld {

torch::Tensor to_tensor(const Image& image) {
  // from_blob does not own the bytes; the conversion to float copies them.
  const torch::Tensor bytes =
      torch::from_blob(const_cast<uint8_t*>(image.rgb.data()), {image.height, image.width, 3}, torch::kUInt8);
  return bytes.permute({2, 0, 1}).to(torch::kFloat32).div(255).contiguous();
}

Image to_image(const torch::Tensor& image) {
  if (image.dim() != 3 || image.size(0) != 3) {
    fail({"image", "a tensor (3, height, width)", std::to_string(image.dim()) + " dimensions", {}});
  }
  const torch::Tensor bytes = image.detach()
                                  .to(torch::kCPU, torch::kFloat32)
                                  .clamp(0, 1)
                                  .nan_to_num(0)  // of NaN the conversion to bytes is undefined
                                  .mul(255)
                                  .round()
                                  .to(torch::kUInt8)
                                  .permute({1, 2, 0})
                                  .contiguous();
  Image result(image.size(2), image.size(1));
  std::copy_n(bytes.data_ptr<uint8_t>(), result.rgb.size(), result.rgb.begin());
  return result;
}

torch::Tensor to_tensor(const DepthMap& depth) {
  return torch::from_blob(const_cast<float*>(depth.metres.data()), {depth.height, depth.width},
                          torch::kFloat32)
      .clone();
}

DepthMap to_depth_map(const torch::Tensor& depth) {
  if (depth.dim() != 2) {
    fail({"depth", "a tensor (height, width)", std::to_string(depth.dim()) + " dimensions", {}});
  }
  const torch::Tensor values = depth.detach().to(torch::kCPU, torch::kFloat32).contiguous();
  DepthMap result(depth.size(1), depth.size(0));
  std::copy_n(values.data_ptr<float>(), result.metres.size(), result.metres.begin());
  return result;
}

SceneTensors to_tensors(const SceneImages& scene) {
  SceneTensors tensors;
  std::vector<torch::Tensor> images;
  std::vector<torch::Tensor> depths;
  std::vector<torch::Tensor> masks;
  for (const SizedFrame& frame : scene.views) {
    images.push_back(to_tensor(frame.image));
    if (!frame.depth.empty()) depths.push_back(to_tensor(frame.depth));
    torch::Tensor mask = torch::ones({frame.image.height, frame.image.width});
    if (!frame.validity.empty()) {
      mask = torch::from_blob(const_cast<uint8_t*>(frame.validity.valid.data()),
                              {frame.validity.height, frame.validity.width}, torch::kUInt8)
                 .to(torch::kFloat32);
    }
    masks.push_back(mask);
    tensors.views.cameras.push_back(frame.camera);
  }
  tensors.images = torch::stack(images);
  tensors.validity = torch::stack(masks);
  // Depth of some views only would be a trap; the loader gives it for all or none.
  if (depths.size() == scene.views.size()) tensors.depth = torch::stack(depths);
  tensors.views.num_sources = scene.num_sources;
  return tensors;
}

}  // namespace gld
