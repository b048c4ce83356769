#include "gld/kernels/attention_rows.h"

#include "gld/base/error.h"

#include <string>

namespace gld {

std::vector<TokenRange> tiles(int64_t tokens, int64_t lanes) {
  std::vector<TokenRange> result;
  for (int64_t first = 0; first < tokens; first += lanes) {
    result.push_back({first, std::min(lanes, tokens - first)});
  }
  return result;
}

const PropeRow* Encoder::find(Encoding encoding, int64_t token, PropeRow& row) const {
  row = {};
  if (prope_ == nullptr) return nullptr;
  const int64_t tokens = prope_->prefix_tokens + prope_->grid_height * prope_->grid_width;
  const int64_t view = token / tokens;
  const int64_t place = token % tokens - prope_->prefix_tokens;
  if (place < 0) return nullptr;
  const int64_t column = place % prope_->grid_width * (head_dim_ / 8);
  const int64_t line = place / prope_->grid_width * (head_dim_ / 8);
  const float* matrices = encoding == Encoding::query       ? prope_->query_matrix
                          : encoding == Encoding::key_value ? prope_->key_value_matrix
                                                            : prope_->output_matrix;
  row.matrix = matrices + 16 * view;
  row.column_cos = prope_->column_cos + column;
  row.column_sin = prope_->column_sin + column;
  row.row_cos = prope_->row_cos + line;
  row.row_sin = prope_->row_sin + line;
  row.inverse_rotation = encoding == Encoding::output;
  return &row;
}

void check_attention(const AttentionForward& arrays, const KernelSettings& settings) {
  const AttentionShape& shape = arrays.shape;
  if (shape.head_dim < 1 || shape.head_dim > 256 || shape.queries < 0 || shape.keys < 0 ||
      settings.threads < 1) {
    fail({"attention kernel", "1 to 256 channels a head, token counts of at least 0 and at least one thread",
          std::to_string(shape.head_dim) + " channels, " + std::to_string(shape.queries) + " queries, " +
              std::to_string(shape.keys) + " keys, " + std::to_string(settings.threads) + " threads",
          ""});
  }
  if (arrays.prope != nullptr) {
    const PropePointers& prope = *arrays.prope;
    const int64_t tokens = prope.views * (prope.prefix_tokens + prope.grid_height * prope.grid_width);
    if (shape.head_dim % 8 != 0 || tokens != shape.queries || tokens != shape.keys) {
      fail({"attention kernel",
            std::to_string(tokens) +
                " queries and keys with a multiple of 8 channels a head for the camera encoding",
            std::to_string(shape.queries) + " queries and " + std::to_string(shape.keys) + " keys with " +
                std::to_string(shape.head_dim) + " channels",
            ""});
    }
  }
}

}  // namespace gld
