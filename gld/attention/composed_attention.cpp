#include "gld/attention/composed_attention.h"

#include "gld/tensors/torch_version.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include <torch/types.h>

namespace gld {
namespace {

// So many logits are held at once, over all batch entries and heads: 64 MB in float32.
constexpr int64_t kLogitsPerBlock = int64_t{1} << 24;

// Each is (batch, tokens, heads, head_dim).
struct EncodedTokens {
  torch::Tensor query;
  torch::Tensor key;
  torch::Tensor value;
};

EncodedTokens with_camera_encoding(const AttentionInputs& inputs) {
  if (inputs.prope == nullptr) return {inputs.query, inputs.key, inputs.value};
  return {encode_query(*inputs.prope, inputs.query), encode_key_value(*inputs.prope, inputs.key),
          encode_key_value(*inputs.prope, inputs.value)};
}

// Encoded (batch * heads, tokens, head_dim), the queries already multiplied by the scale.
struct HeadsFirst {
  torch::Tensor query;
  torch::Tensor key;
  torch::Tensor value;
};

HeadsFirst heads_first(const AttentionInputs& inputs) {
  const EncodedTokens tokens = with_camera_encoding(inputs);
  const int64_t head_dim = tokens.query.size(3);
  const auto arrange = [&](const torch::Tensor& x) {
    return x.transpose(1, 2).reshape({x.size(0) * x.size(2), x.size(1), head_dim});
  };
  return {arrange(tokens.query * (1.0 / std::sqrt(static_cast<double>(head_dim)))), arrange(tokens.key),
          arrange(tokens.value)};
}

// Makes the result of attention() of (batch * heads, tokens, head_dim).
torch::Tensor finish(const AttentionInputs& inputs, const torch::Tensor& output) {
  const auto& query = inputs.query;
  const auto tokens_first =
      output.view({query.size(0), query.size(2), query.size(1), query.size(3)}).transpose(1, 2).contiguous();
  return inputs.prope == nullptr ? tokens_first : encode_output(*inputs.prope, tokens_first);
}

torch::Tensor attend(const torch::Tensor& query, const torch::Tensor& key, const torch::Tensor& value) {
  const int64_t rows = query.size(1);
  const int64_t logits_per_row = std::max<int64_t>(1, query.size(0) * key.size(1));
  const int64_t block = std::max<int64_t>(1, kLogitsPerBlock / logits_per_row);
  const auto transposed_key = key.transpose(1, 2);
  std::vector<torch::Tensor> blocks;
  for (int64_t first = 0; first < rows; first += block) {
    const auto part = query.narrow(1, first, std::min(block, rows - first));
    blocks.push_back(torch::bmm(torch::softmax(torch::bmm(part, transposed_key), -1), value));
  }
  return blocks.size() == 1 ? blocks.front() : torch::cat(blocks, 1);
}

}  // namespace

torch::Tensor composed_attention(const AttentionInputs& inputs) {
  const auto arrays = heads_first(inputs);
  const auto logits = torch::bmm(arrays.query, arrays.key.transpose(1, 2));
  return finish(inputs, torch::bmm(torch::softmax(logits, -1), arrays.value));
}

torch::Tensor row_blocked_attention(const AttentionInputs& inputs) {
  const auto arrays = heads_first(inputs);
  return finish(inputs, attend(arrays.query, arrays.key, arrays.value));
}

torch::Tensor library_attention(const AttentionInputs& inputs) {
  const EncodedTokens tokens = with_camera_encoding(inputs);
  const auto arranged = [&](const torch::Tensor& x) {
    return inputs.precision == ComputePrecision::kBFloat16 ? x.transpose(1, 2).to(torch::kBFloat16)
                                                           : x.transpose(1, 2);
  };
  const auto output =
      gld::scaled_dot_product_attention(arranged(tokens.query), arranged(tokens.key), arranged(tokens.value))
          .to(inputs.query.scalar_type())
          .transpose(1, 2)
          .contiguous();
  return inputs.prope == nullptr ? output : encode_output(*inputs.prope, output);
}

}  // namespace gld
