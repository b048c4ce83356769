#include "gld/attention.h"

#include "gld/error.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {
namespace {

// Logits held at once, over all batch entries and heads: 64 MB in float32.
constexpr int64_t kLogitsPerBlock = int64_t{1} << 24;

void require(bool condition, const std::string& expected, const std::string& found) {
  if (!condition) fail({"attention", expected, found, "check what calls it"});
}

void check_inputs(const AttentionInputs& inputs) {
  const auto& query = inputs.query;
  const auto& key = inputs.key;
  require(query.dim() == 4 && key.dim() == 4, "queries and keys of shape (batch, tokens, heads, head_dim)",
          c10::str(query.sizes(), " and ", key.sizes()));
  require(key.sizes() == inputs.value.sizes(), "keys and values of one shape",
          c10::str(key.sizes(), " and ", inputs.value.sizes()));
  require(query.size(0) == key.size(0) && query.size(2) == key.size(2) && query.size(3) == key.size(3),
          "queries and keys with the same batch, heads and head size",
          c10::str(query.sizes(), " and ", key.sizes()));
  if (inputs.prope != nullptr) {
    require(query.sizes() == key.sizes(), "as many queries as keys with a camera encoding",
            c10::str(query.sizes(), " and ", key.sizes()));
  }
  if (!inputs.view_mask.defined()) return;
  const auto& mask = inputs.view_mask;
  require(mask.dim() == 2 && mask.size(0) == mask.size(1) && mask.scalar_type() == torch::kBool &&
              mask.device().is_cpu(),
          "a view mask of shape (views, views) and type bool on the CPU",
          c10::str(mask.sizes(), " of type ", mask.scalar_type()));
  require(mask.size(0) > 0 && query.size(1) % mask.size(0) == 0 && key.size(1) % mask.size(0) == 0,
          "token counts that the view mask's views divide",
          c10::str(query.size(1), " queries and ", key.size(1), " keys for ", mask.size(0), " views"));
}

// All arguments are (batch * heads, tokens, head_dim), the queries already multiplied by the scale.
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

torch::Tensor attend_masked(const torch::Tensor& query, const torch::Tensor& key, const torch::Tensor& value,
                            const torch::Tensor& view_mask) {
  const auto mask = view_mask.contiguous();
  const int64_t views = mask.size(0);
  const int64_t queries_per_view = query.size(1) / views;
  std::vector<torch::Tensor> outputs;
  for (int64_t view = 0; view < views; ++view) {
    const bool* attends = mask.data_ptr<bool>() + view * views;
    const auto part = query.narrow(1, view * queries_per_view, queries_per_view);
    const auto seen_keys = select_views(key, attends, views);
    outputs.push_back(seen_keys.defined() ? attend(part, seen_keys, select_views(value, attends, views))
                                          : torch::zeros_like(part));
  }
  return torch::cat(outputs, 1);
}

}  // namespace

torch::Tensor attention(const AttentionInputs& inputs) {
  check_inputs(inputs);
  auto query = inputs.query;
  auto key = inputs.key;
  auto value = inputs.value;
  if (inputs.prope != nullptr) {
    query = encode_query(*inputs.prope, query);
    key = encode_key_value(*inputs.prope, key);
    value = encode_key_value(*inputs.prope, value);
  }
  const int64_t batch = query.size(0), rows = query.size(1), heads = query.size(2), head_dim = query.size(3);
  const auto heads_first = [&](const torch::Tensor& x) {
    return x.transpose(1, 2).reshape({batch * heads, x.size(1), head_dim});
  };
  const auto scaled_query = heads_first(query * (1.0 / std::sqrt(static_cast<double>(head_dim))));
  auto output = inputs.view_mask.defined()
                    ? attend_masked(scaled_query, heads_first(key), heads_first(value), inputs.view_mask)
                    : attend(scaled_query, heads_first(key), heads_first(value));
  output = output.view({batch, heads, rows, head_dim}).transpose(1, 2).contiguous();
  return inputs.prope == nullptr ? output : encode_output(*inputs.prope, output);
}

}  // namespace gld
