#include "gld/tensors/packed_layer.h"

#include "gld/kernels/matrix_product.h"
#include "gld/tensors/torch_version.h"
#include "gld/tensors/transposed_product.h"

#include <torch/types.h>

namespace gld {
namespace {

// In float32, weights of fewer inputs are not worth being packed.
constexpr int64_t kFewestPackedInputs = 32;

}  // namespace

PackedLayer::PackedLayer(const torch::Tensor& weight, int64_t parts, ComputePrecision precision)
    : outputs_a_part_(weight.size(0) / parts) {
  const auto rows = weight.contiguous();
  const PackingSettings settings = packing_settings(precision, thread_count());
  for (int64_t part = 0; part < parts; ++part) {
    WeightMatrix matrix;
    matrix.data = rows.data_ptr<float>() + part * outputs_a_part_ * rows.size(1);
    matrix.outputs = outputs_a_part_;
    matrix.inputs = matrix.stride = rows.size(1);
    parts_.emplace_back(matrix, settings);
  }
}

bool PackedLayer::applies(const torch::Tensor& weight, ComputePrecision precision) {
  return weight.is_cpu() && weight.scalar_type() == torch::kFloat32 && weight.numel() > 0 &&
         (precision != ComputePrecision::kFloat32 || weight.size(1) >= kFewestPackedInputs);
}

torch::Tensor PackedLayer::times(const torch::Tensor& x, const torch::Tensor& bias, int64_t first,
                                 int64_t count) const {
  const int64_t outputs = count * outputs_a_part_, inputs = parts_.front().inputs();
  const auto own_bias =
      bias.defined() ? bias.narrow(0, first * outputs_a_part_, outputs).contiguous() : torch::Tensor();
  auto shape = x.sizes().vec();
  shape.back() = outputs;
  auto flat = x.reshape({-1, inputs});
  if (flat.stride(1) != 1 || flat.stride(0) < inputs) flat = flat.contiguous();
  const bool float32 = parts_.front().settings().precision == ComputePrecision::kFloat32;
  if (float32 && flat.size(0) < kFewestPackedRows)
    return times_transposed(x, unpacked(first, count), own_bias);
  const auto y = torch::empty({flat.size(0), outputs}, x.options());
  PackedProduct product;
  product.rows = flat.size(0);
  product.x = flat.data_ptr<float>();
  product.x_stride = flat.stride(0);
  product.y_stride = outputs;
  for (int64_t part = 0; part < count; ++part) {
    ProductTarget target;
    target.weights = &parts_[static_cast<size_t>(first + part)];
    target.bias = own_bias.defined() ? own_bias.data_ptr<float>() + part * outputs_a_part_ : nullptr;
    target.y = y.data_ptr<float>() + part * outputs_a_part_;
    product.targets.push_back(target);
  }
  packed_product(product, thread_count());
  return y.view(shape);
}

torch::Tensor PackedLayer::unpacked(int64_t first, int64_t count) const {
  const int64_t inputs = parts_.front().inputs();
  auto weight = torch::empty({count * outputs_a_part_, inputs});
  for (int64_t part = 0; part < count; ++part) {
    parts_[static_cast<size_t>(first + part)].unpack(weight.data_ptr<float>() +
                                                     part * outputs_a_part_ * inputs);
  }
  return weight;
}

int64_t PackedLayer::bytes() const {
  int64_t sum = 0;
  for (const auto& part : parts_) sum += part.bytes();
  return sum;
}

}  // namespace gld
