#include "models/layers/layers.h"

#include "gld/base/error.h"
#include "gld/machine/block_memory.h"
#include "gld/tensors/fused_ops.h"
#include "gld/tensors/learning_product.h"
#include "gld/tensors/transposed_product.h"

#include <cstdint>
#include <limits>
#include <string>

#include <torch/autograd.h>

#include <sys/mman.h>
#include <unistd.h>

namespace gld {
namespace {

// Weights that were read in place are pages of a mapped file, which stay with the process as long as any tensor of the
// file does: beside the packed weights they would double what a model takes. Pages of a file that nobody wrote to go,
// to come again when they are read (MADV_PAGEOUT; a kernel before 5.4 keeps them). Memory of our own is left alone: it
// is given back anyway.
void page_out(const torch::Tensor& tensor) {
#ifdef MADV_PAGEOUT
  if (tensor.storage().data_ptr().get_deleter() == &give_block) return;
  const auto page = static_cast<size_t>(::sysconf(_SC_PAGESIZE));
  const auto bytes = static_cast<size_t>(tensor.numel() * tensor.element_size());
  auto* begin = static_cast<char*>(tensor.data_ptr());
  const size_t in_front = (page - reinterpret_cast<uintptr_t>(begin) % page) % page;
  if (in_front >= bytes) return;
  const size_t whole_pages = (bytes - in_front) / page * page;
  if (whole_pages > 0) ::madvise(begin + in_front, whole_pages, MADV_PAGEOUT);
#else
  (void)tensor;
#endif
}

void require_channels(const torch::Tensor& x, int64_t channels, const std::string& layer) {
  if (x.dim() == 0 || x.size(-1) != channels) {
    fail({layer, std::to_string(channels) + " channels in the last dimension",
          "a tensor of shape " + c10::str(x.sizes()), "check the sizes in the model's configuration"});
  }
}

}  // namespace

Linear::Linear(const LinearSizes& sizes, const ParameterPlacement& placement)
    : parts_(sizes.parts), packing_(sizes.packing) {
  weight = register_parameter("weight", torch::empty({sizes.outputs, sizes.inputs}, placement.options()));
  if (sizes.bias) bias = register_parameter("bias", torch::empty({sizes.outputs}, placement.options()));
}

torch::Tensor Linear::forward(const torch::Tensor& x) const { return forward_parts(x, 0, parts_); }

torch::Tensor Linear::forward_parts(const torch::Tensor& x, int64_t first, int64_t count) const {
  require_channels(x, weight.size(1), "linear layer");
  if ((packed_ || rounded_.defined()) && torch::GradMode::is_enabled() && x.requires_grad()) {
    fail({"linear layer", "no gradients through packed weights", "an input that wants them",
          "train without use_precision"});
  }
  if (packed_) return packed_->times(x, bias, first, count);
  torch::Tensor own_weight = rounded_.defined() ? rounded_ : weight, own_bias = bias;
  if (first != 0 || count != parts_) {
    const int64_t share = weight.size(0) / parts_;
    own_weight = own_weight.narrow(0, first * share, count * share);
    if (bias.defined()) own_bias = bias.narrow(0, first * share, count * share);
  }
  if (rounded_.defined()) return times_rounded(x, own_weight, own_bias);
  if (learning_precision_ != ComputePrecision::kFloat32 && learning_product_applies(x, own_weight)) {
    return learning_product(x, own_weight, own_bias, learning_precision_);
  }
  return times_transposed(x, own_weight, own_bias);
}

bool Linear::learn_in(ComputePrecision precision) {
  if (packing_ == LinearPacking::kNever) return false;
  learning_precision_ = precision;
  return true;
}

void Linear::use_precision(const LayerPrecision& precision) {
  if (packing_ == LinearPacking::kNever) return;
  const torch::NoGradGuard no_gradients;
  if (PackedLayer::applies(weight, precision.linear)) {
    packed_ = std::make_unique<const PackedLayer>(weight, parts_, precision.linear);
  } else if (rounded_product_applies(weight, precision.linear)) {
    rounded_ = weight.to(torch::kBFloat16);
  } else {
    return;
  }
  if (precision.originals == PackedOriginals::kKeep) return;
  if (weight.is_cpu()) page_out(weight);
  // The shape stays without the numbers; who reads them all the same finds NaN.
  weight.set_data(
      torch::full({1}, std::numeric_limits<float>::quiet_NaN(), weight.options()).expand(weight.sizes()));
}

LayerNorm::LayerNorm(int64_t channels, double epsilon, const ParameterPlacement& placement)
    : epsilon_(epsilon) {
  weight = register_parameter("weight", torch::empty({channels}, placement.options()));
  bias = register_parameter("bias", torch::empty({channels}, placement.options()));
}

torch::Tensor LayerNorm::forward(const torch::Tensor& x) const {
  require_channels(x, weight.size(0), "LayerNorm");
  return torch::layer_norm(x, {weight.size(0)}, weight, bias, epsilon_);
}

RmsNorm::RmsNorm(int64_t channels, double epsilon, const ParameterPlacement& placement) : epsilon_(epsilon) {
  weight = register_parameter("weight", torch::empty({channels}, placement.options()));
}

torch::Tensor RmsNorm::forward(const torch::Tensor& x) const {
  require_channels(x, weight.size(0), "RMSNorm");
  RmsNormInputs inputs;
  inputs.x = x;
  inputs.weight = weight;
  inputs.epsilon = epsilon_;
  return rms_norm(inputs);
}

PatchEmbed::PatchEmbed(const PatchEmbedSizes& sizes, const ParameterPlacement& placement) : sizes_(sizes) {
  auto proj = std::make_shared<torch::nn::Module>();
  weight = proj->register_parameter(
      "weight", torch::empty({sizes.embed_dim, sizes.in_channels, sizes.patch_size, sizes.patch_size},
                             placement.options()));
  bias = proj->register_parameter("bias", torch::empty({sizes.embed_dim}, placement.options()));
  register_module("proj", proj);
}

torch::Tensor PatchEmbed::forward_image(const torch::Tensor& image) const {
  const int64_t p = sizes_.patch_size;
  if (image.dim() != 4 || image.size(1) != sizes_.in_channels || image.size(2) % p != 0 ||
      image.size(3) % p != 0) {
    fail({"patch embedding",
          "(views, " + std::to_string(sizes_.in_channels) + ", height, width) with sides divisible by " +
              std::to_string(p),
          c10::str(image.sizes()), "resize or crop the image to whole patches"});
  }
  const int64_t views = image.size(0), rows = image.size(2) / p, columns = image.size(3) / p;
  const auto patches = image.reshape({views, sizes_.in_channels, rows, p, columns, p})
                           .permute({0, 2, 4, 1, 3, 5})
                           .reshape({views * rows * columns, sizes_.in_channels * p * p});
  return times_transposed(patches, weight.flatten(1), bias).view({views, rows * columns, sizes_.embed_dim});
}

torch::Tensor PatchEmbed::forward_tokens(const torch::Tensor& tokens) const {
  if (sizes_.patch_size != 1) {
    fail({"patch embedding", "patch_size 1 for tokens", std::to_string(sizes_.patch_size),
          "set patch_size: 1 in the model's configuration"});
  }
  require_channels(tokens, sizes_.in_channels, "patch embedding");
  return times_transposed(tokens, weight.flatten(1), bias);
}

}  // namespace gld
