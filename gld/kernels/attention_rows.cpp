#include "gld/kernels/attention_rows.h"

#include "gld/base/error.h"

#include <string>

namespace gld {

std::vector<Segment> segments(const AttentionForward& arrays, SegmentSide side) {
  const bool of_queries = side == SegmentSide::queries;
  const int64_t own_tokens = of_queries ? arrays.shape.queries : arrays.shape.keys;
  const int64_t partner_tokens = of_queries ? arrays.shape.keys : arrays.shape.queries;
  if (arrays.mask == nullptr) {
    if (partner_tokens == 0) return {{{0, own_tokens}, {}}};
    return {{{0, own_tokens}, {{0, partner_tokens}}}};
  }
  const int64_t views = arrays.mask->views;
  const int64_t own_view = own_tokens / views;
  const int64_t partner_view = partner_tokens / views;
  const auto attends = [&](int64_t own, int64_t partner) {
    return arrays.mask->attends[of_queries ? own * views + partner : partner * views + own] != 0;
  };
  std::vector<Segment> result;
  for (int64_t view = 0; view < views; ++view) {
    bool same_as_before = view > 0;
    for (int64_t partner = 0; same_as_before && partner < views; ++partner) {
      same_as_before = attends(view, partner) == attends(view - 1, partner);
    }
    if (same_as_before) {
      result.back().own.count += own_view;
      continue;
    }
    Segment segment = {{view * own_view, own_view}, {}};
    for (int64_t partner = 0; partner < views; ++partner) {
      if (!attends(view, partner)) continue;
      if (!segment.partners.empty() &&
          segment.partners.back().first + segment.partners.back().count == partner * partner_view) {
        segment.partners.back().count += partner_view;
      } else {
        segment.partners.push_back({partner * partner_view, partner_view});
      }
    }
    result.push_back(std::move(segment));
  }
  return result;
}

std::vector<Tile> tiles(const std::vector<Segment>& segments, int64_t lanes) {
  std::vector<Tile> result;
  for (const Segment& segment : segments) {
    for (int64_t done = 0; done < segment.own.count; done += lanes) {
      result.push_back({{segment.own.first + done, std::min(lanes, segment.own.count - done)}, &segment});
    }
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
  if (arrays.mask != nullptr && (arrays.mask->views < 1 || shape.queries % arrays.mask->views != 0 ||
                                 shape.keys % arrays.mask->views != 0)) {
    fail({"attention kernel",
          "tokens that divide evenly into the " + std::to_string(arrays.mask->views) + " views of the mask",
          std::to_string(shape.queries) + " queries and " + std::to_string(shape.keys) + " keys", ""});
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
