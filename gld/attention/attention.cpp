#include "gld/attention/attention.h"

#include "gld/attention/composed_attention.h"
#include "gld/attention/fused_attention.h"
#include "gld/base/error.h"
#include "gld/tensors/torch_version.h"

#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {
namespace {

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
}

}  // namespace

torch::Tensor attention(const AttentionInputs& inputs) {
  check_inputs(inputs);
  if (fused_attention_applies(inputs)) return fused_attention(inputs);
  if (has_library_attention(inputs.query.device())) return library_attention(inputs);
  return row_blocked_attention(inputs);
}

}  // namespace gld
