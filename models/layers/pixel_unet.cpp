#include "models/layers/pixel_unet.h"

#include "gld/base/error.h"
#include "gld/cameras/image_size.h"

#include <cmath>

namespace gld {

void PixelUnetOptions::visit(FieldVisitor& visitor) {
  visitor.integers(
      {"channels", "channels at full size, half, a quarter and so on; none for a model without this network"},
      channels, {1, 4096});
  visitor.integer({"side", "longer side, in pixels, of the pictures that it looks at"}, side, {8, 4096});
}

void PixelUnetOptions::check() const {
  constexpr size_t kMost = 8;
  if (channels.size() > kMost || channels.size() == 1) {
    fail({"channels", "none, or 2 to 8 numbers", std::to_string(channels.size()),
          "write for example channels: [24, 32, 48, 64]"});
  }
}

PixelUnet::PixelUnet(torch::nn::Module& owner, const PixelUnetOptions& options, int64_t inputs,
                     const ParameterPlacement& placement) {
  options.check();
  const auto& channels = options.channels;
  const auto encoder = owner.register_module("encoder", std::make_shared<torch::nn::Module>());
  const auto decoder = owner.register_module("decoder", std::make_shared<torch::nn::Module>());
  for (size_t i = 0; i < channels.size(); ++i) {
    encoder_.push_back(
        make_pair(*encoder, std::to_string(i), {i == 0 ? inputs : channels[i - 1], channels[i]}, placement));
  }
  for (size_t i = 0; i + 1 < channels.size(); ++i) {
    decoder_.push_back(
        make_pair(*decoder, std::to_string(i), {channels[i] + channels[i + 1], channels[i]}, placement));
  }
}

torch::Tensor PixelUnet::Pair::operator()(const torch::Tensor& x) const {
  return torch::gelu(second->forward(torch::gelu(first->forward(x))));
}

torch::Tensor PixelUnet::operator()(const torch::Tensor& inputs) const {
  std::vector<torch::Tensor> levels;
  torch::Tensor x = inputs;
  for (const Pair& pair : encoder_) {
    if (!levels.empty()) x = torch::avg_pool2d(x, {2, 2}, {2, 2}, {0, 0}, /*ceil_mode=*/true);
    x = pair(x);
    levels.push_back(x);
  }
  for (size_t i = decoder_.size(); i-- > 0;) {
    const auto larger = torch::upsample_bilinear2d(x, {levels[i].size(2), levels[i].size(3)}, false);
    x = decoder_[i](torch::cat({levels[i], larger}, 1));
  }
  return x;
}

PixelUnet::Pair PixelUnet::make_pair(torch::nn::Module& parent, const std::string& name, const Widths& widths,
                                     const ParameterPlacement& placement) {
  const auto pair = parent.register_module(name, std::make_shared<torch::nn::Module>());
  const auto convolution = [&](const char* own, int64_t inputs) {
    return pair->register_module(
        own, std::make_shared<Convolution>(same_size_convolution(inputs, widths.outputs, 3), placement));
  };
  auto first = convolution("first", widths.inputs);
  return {first, convolution("second", widths.outputs)};
}

Cost pixel_unet_cost(const PixelUnetOptions& options, const PixelUnetEnds& ends, int64_t height,
                     int64_t width) {
  Cost cost;
  if (!options.exists()) return cost;
  const ImageSize seen = image_within(width, height, options.side);
  const auto whole = static_cast<double>(seen.width * seen.height);
  const auto& channels = options.channels;
  const auto add_pair = [&](size_t level, double inputs) {
    const double here = whole / std::pow(4.0, static_cast<double>(level));
    const auto own = static_cast<double>(channels[level]);
    add_convolution(cost, here, inputs, own, 3);
    add_convolution(cost, here, own, own, 3);
  };
  for (size_t i = 0; i < channels.size(); ++i)
    add_pair(i, static_cast<double>(i == 0 ? ends.inputs : channels[i - 1]));
  for (size_t i = 0; i + 1 < channels.size(); ++i)
    add_pair(i, static_cast<double>(channels[i] + channels[i + 1]));
  add_convolution(cost, whole, static_cast<double>(channels.front()), static_cast<double>(ends.outputs), 3);
  // This counts what it sees, and its widest maps, of the last pair: both that are seen beside each other, put
  // together, the same as LibTorch lays it out for its convolution, and what comes out before and after GELU.
  cost.working_bytes =
      bytes_of_floats(whole * static_cast<double>(ends.inputs + 5 * channels[0] + 3 * channels[1]));
  return cost;
}

}  // namespace gld
