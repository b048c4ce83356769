#include "gld/attention/composed_attention.h"

#include "gld/tensors/torch_version.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include <torch/types.h>

namespace gld {
namespace {

// Logits held at once, over all batch entries and heads: 64 MB in float32.
constexpr int64_t kLogitsPerBlock = int64_t{1} << 24;

// (batch, tokens, heads, head_dim) each.
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

// (batch * heads, tokens, head_dim) -> the result of attention().
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

// The tokens of the views that `attends` names, (batch * heads, tokens, head_dim).
torch::Tensor select_views(const torch::Tensor& tokens, const bool* attends, int64_t views) {
  const int64_t per_view = tokens.size(1) / views;
  std::vector<torch::Tensor> seen;
  for (int64_t view = 0; view < views; ++view) {
    if (attends[view]) seen.push_back(tokens.narrow(1, view * per_view, per_view));
  }
  if (seen.empty()) return {};
  return torch::cat(seen, 1);
}

torch::Tensor attend_masked(const HeadsFirst& arrays, const torch::Tensor& view_mask) {
  const auto mask = view_mask.contiguous();
  const int64_t views = mask.size(0);
  const int64_t queries_per_view = arrays.query.size(1) / views;
  std::vector<torch::Tensor> outputs;
  for (int64_t view = 0; view < views; ++view) {
    const bool* attends = mask.data_ptr<bool>() + view * views;
    const auto part = arrays.query.narrow(1, view * queries_per_view, queries_per_view);
    const auto seen_keys = select_views(arrays.key, attends, views);
    outputs.push_back(seen_keys.defined()
                          ? attend(part, seen_keys, select_views(arrays.value, attends, views))
                          : torch::zeros_like(part));
  }
  return torch::cat(outputs, 1);
}

}  // namespace

torch::Tensor composed_attention(const AttentionInputs& inputs) {
  const auto arrays = heads_first(inputs);
  auto logits = torch::bmm(arrays.query, arrays.key.transpose(1, 2));
  if (!inputs.view_mask.defined()) {
    return finish(inputs, torch::bmm(torch::softmax(logits, -1), arrays.value));
  }
  const int64_t views = inputs.view_mask.size(0);
  const auto left_out = inputs.view_mask.logical_not()
                            .repeat_interleave(logits.size(1) / views, 0)
                            .repeat_interleave(logits.size(2) / views, 1)
                            .to(logits.device());
  logits = logits.masked_fill(left_out, -std::numeric_limits<double>::infinity());
  // The softmax of a row without keys is not a number.
  const auto probabilities = torch::softmax(logits, -1).masked_fill(left_out, 0.0);
  return finish(inputs, torch::bmm(probabilities, arrays.value));
}

torch::Tensor row_blocked_attention(const AttentionInputs& inputs) {
  const auto arrays = heads_first(inputs);
  return finish(inputs, inputs.view_mask.defined() ? attend_masked(arrays, inputs.view_mask)
                                                   : attend(arrays.query, arrays.key, arrays.value));
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
