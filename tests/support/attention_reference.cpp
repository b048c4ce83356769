#include "tests/support/attention_reference.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace gld::test {
namespace {

using Row = std::vector<double>;

enum class Part { query, key_value, output };

// Returns the encoding of one token as a dense head_dim x head_dim matrix.
std::vector<Row> encoding_matrix(const PropePointers* prope, Part part, int64_t token, int64_t head_dim) {
  const auto size = static_cast<std::size_t>(head_dim);
  std::vector<Row> matrix(size, Row(size, 0.0));
  for (std::size_t i = 0; i < size; ++i) matrix[i][i] = 1;
  if (prope == nullptr) return matrix;
  const int64_t tokens = prope->prefix_tokens + prope->grid_height * prope->grid_width;
  const int64_t view = token / tokens;
  const int64_t place = token % tokens - prope->prefix_tokens;
  if (place < 0) return matrix;
  const float* p = (part == Part::query       ? prope->query_matrix
                    : part == Part::key_value ? prope->key_value_matrix
                                              : prope->output_matrix) +
                   16 * view;
  for (std::size_t c = 0; c < size / 2; c += 4) {
    for (std::size_t i = 0; i < 4; ++i) {
      for (std::size_t j = 0; j < 4; ++j) matrix[c + i][c + j] = p[4 * i + j];
    }
  }
  const int64_t eighth = head_dim / 8;
  const auto e = static_cast<std::size_t>(eighth);
  const float* cosines[] = {prope->column_cos + place % prope->grid_width * eighth,
                            prope->row_cos + place / prope->grid_width * eighth};
  const float* sines[] = {prope->column_sin + place % prope->grid_width * eighth,
                          prope->row_sin + place / prope->grid_width * eighth};
  const double sign = part == Part::output ? -1 : 1;
  for (std::size_t quarter = 0; quarter < 2; ++quarter) {
    const std::size_t first = size / 2 + quarter * 2 * e;
    for (std::size_t c = 0; c < e; ++c) {
      matrix[first + c][first + c] = cosines[quarter][c];
      matrix[first + c][first + e + c] = sign * sines[quarter][c];
      matrix[first + e + c][first + c] = -sign * sines[quarter][c];
      matrix[first + e + c][first + e + c] = cosines[quarter][c];
    }
  }
  return matrix;
}

Row product(const std::vector<Row>& matrix, const Row& x) {
  Row y(x.size(), 0.0);
  for (std::size_t i = 0; i < x.size(); ++i) {
    for (std::size_t j = 0; j < x.size(); ++j) y[i] += matrix[i][j] * x[j];
  }
  return y;
}

Row transposed_product(const std::vector<Row>& matrix, const Row& x) {
  Row y(x.size(), 0.0);
  for (std::size_t i = 0; i < x.size(); ++i) {
    for (std::size_t j = 0; j < x.size(); ++j) y[j] += matrix[i][j] * x[i];
  }
  return y;
}

double dot(const Row& a, const Row& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += a[i] * b[i];
  return sum;
}

void add(Row& a, double factor, const Row& b) {
  for (std::size_t i = 0; i < a.size(); ++i) a[i] += factor * b[i];
}

class Head {
 public:
  Head(const AttentionShape& shape, const PropePointers* prope, int64_t batch, int64_t head)
      : shape_(shape), prope_(prope), batch_(batch), head_(head) {}

  std::size_t offset(int64_t token, int64_t tokens) const {
    return static_cast<std::size_t>(((batch_ * tokens + token) * shape_.heads + head_) * shape_.head_dim);
  }
  Row row(const std::vector<double>& array, int64_t token, int64_t tokens) const {
    const auto begin = array.begin() + static_cast<std::ptrdiff_t>(offset(token, tokens));
    return Row(begin, begin + shape_.head_dim);
  }
  void store(const Row& row, int64_t token, int64_t tokens, std::vector<double>& array) const {
    std::copy(row.begin(), row.end(), array.begin() + static_cast<std::ptrdiff_t>(offset(token, tokens)));
  }
  // The token is encoded for attending, or by the transpose (which gradients go through).
  Row encode(Part part, int64_t token, const Row& x) const {
    return prope_ == nullptr ? x : product(encoding_matrix(prope_, part, token, shape_.head_dim), x);
  }
  Row encode_transposed(Part part, int64_t token, const Row& x) const {
    return prope_ == nullptr ? x
                             : transposed_product(encoding_matrix(prope_, part, token, shape_.head_dim), x);
  }
  std::vector<Row> encoded(const std::vector<double>& array, Part part, int64_t tokens) const {
    std::vector<Row> rows;
    for (int64_t token = 0; token < tokens; ++token) {
      rows.push_back(encode(part, token, row(array, token, tokens)));
    }
    return rows;
  }
  // Returns the probabilities of one query and the log of their sum.
  Row probabilities(const Row& query, const std::vector<Row>& keys, double& log_sum_exp) const {
    const double scale = 1 / std::sqrt(static_cast<double>(shape_.head_dim));
    Row p(keys.size(), -std::numeric_limits<double>::infinity());
    double highest = -std::numeric_limits<double>::infinity();
    for (int64_t k = 0; k < shape_.keys; ++k) {
      const auto i = static_cast<std::size_t>(k);
      p[i] = scale * dot(query, keys[i]);
      highest = std::max(highest, p[i]);
    }
    double sum = 0;
    for (double& x : p) {
      x = std::exp(x - highest);
      sum += x;
    }
    for (double& x : p) x = sum > 0 ? x / sum : 0;
    log_sum_exp = sum > 0 ? highest + std::log(sum) : -std::numeric_limits<double>::infinity();
    return p;
  }

 private:
  const AttentionShape& shape_;
  const PropePointers* prope_;
  int64_t batch_;
  int64_t head_;
};

}  // namespace

void run_reference(const AttentionShape& shape, const PropePointers* prope, ReferenceAttention& arrays) {
  arrays.output.assign(arrays.query.size(), 0.0);
  arrays.log_sum_exp.clear();
  for (int64_t index = 0; index < shape.batch * shape.heads; ++index) {
    const Head head(shape, prope, index / shape.heads, index % shape.heads);
    const auto queries = head.encoded(arrays.query, Part::query, shape.queries);
    const auto keys = head.encoded(arrays.key, Part::key_value, shape.keys);
    const auto values = head.encoded(arrays.value, Part::key_value, shape.keys);
    for (int64_t q = 0; q < shape.queries; ++q) {
      double log_sum_exp = 0;
      const Row p = head.probabilities(queries[static_cast<std::size_t>(q)], keys, log_sum_exp);
      Row sum(static_cast<std::size_t>(shape.head_dim), 0.0);
      for (std::size_t k = 0; k < p.size(); ++k) add(sum, p[k], values[k]);
      head.store(head.encode(Part::output, q, sum), q, shape.queries, arrays.output);
      arrays.log_sum_exp.push_back(log_sum_exp);
    }
  }
}

ReferenceGradients reference_gradients(const AttentionShape& shape, const PropePointers* prope,
                                       const ReferenceAttention& arrays,
                                       const std::vector<double>& output_gradient) {
  ReferenceGradients gradients = {std::vector<double>(arrays.query.size()),
                                  std::vector<double>(arrays.key.size()),
                                  std::vector<double>(arrays.value.size())};
  const double scale = 1 / std::sqrt(static_cast<double>(shape.head_dim));
  const auto size = static_cast<std::size_t>(shape.head_dim);
  for (int64_t index = 0; index < shape.batch * shape.heads; ++index) {
    const Head head(shape, prope, index / shape.heads, index % shape.heads);
    const auto queries = head.encoded(arrays.query, Part::query, shape.queries);
    const auto keys = head.encoded(arrays.key, Part::key_value, shape.keys);
    const auto values = head.encoded(arrays.value, Part::key_value, shape.keys);
    std::vector<Row> key_sums(keys.size(), Row(size, 0.0)), value_sums(keys.size(), Row(size, 0.0));
    for (int64_t q = 0; q < shape.queries; ++q) {
      double log_sum_exp = 0;
      const Row& query = queries[static_cast<std::size_t>(q)];
      const Row p = head.probabilities(query, keys, log_sum_exp);
      const Row gradient =
          head.encode_transposed(Part::output, q, head.row(output_gradient, q, shape.queries));
      Row dp(p.size());
      double mean = 0;
      for (std::size_t k = 0; k < p.size(); ++k) {
        dp[k] = dot(gradient, values[k]);
        mean += p[k] * dp[k];
        add(value_sums[k], p[k], gradient);
      }
      Row query_sum(size, 0.0);
      for (std::size_t k = 0; k < p.size(); ++k) {
        const double logit_gradient = scale * p[k] * (dp[k] - mean);
        add(query_sum, logit_gradient, keys[k]);
        add(key_sums[k], logit_gradient, query);
      }
      head.store(head.encode_transposed(Part::query, q, query_sum), q, shape.queries, gradients.query);
    }
    for (int64_t k = 0; k < shape.keys; ++k) {
      const auto i = static_cast<std::size_t>(k);
      head.store(head.encode_transposed(Part::key_value, k, key_sums[i]), k, shape.keys, gradients.key);
      head.store(head.encode_transposed(Part::key_value, k, value_sums[i]), k, shape.keys, gradients.value);
    }
  }
  return gradients;
}

}  // namespace gld::test
