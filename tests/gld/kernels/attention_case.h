#pragma once

#include "gld/kernels/attention_kernel.h"
#include "tests/support/attention_reference.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace gld::test {

// Everything one case needs: float arrays as the kernel reads them (query, key and value are slices of one array, as
// after a joint projection), and the same numbers in double.
class Case {
 public:
  struct Draw {
    double logit_scale = 1;
    unsigned seed = 1;
  };

  Case(const AttentionShape& shape, const Draw& draw) : shape_(shape) {
    std::mt19937 engine(draw.seed);
    std::normal_distribution<float> normal;
    const auto fill = [&](int64_t tokens, double scale, std::vector<float>& values) {
      values.resize(static_cast<std::size_t>(shape.batch * tokens * shape.heads * shape.head_dim));
      for (float& x : values) x = static_cast<float>(scale) * normal(engine);
    };
    fill(shape.queries, draw.logit_scale, query_);
    fill(shape.keys, 1, key_);
    fill(shape.keys, 1, value_);
    fill(shape.queries, 1, output_gradient_);
  }

  void use_prope(const PropePointers* prope) { prope_ = prope; }
  std::vector<float>& query() { return query_; }
  std::vector<float>& key() { return key_; }
  std::vector<float>& value() { return value_; }

  AttentionForward forward_arrays() {
    AttentionForward arrays;
    arrays.shape = shape_;
    arrays.query = view<const float>(query_, shape_.queries);
    arrays.key = view<const float>(key_, shape_.keys);
    arrays.value = view<const float>(value_, shape_.keys);
    arrays.prope = prope_;
    output.assign(query_.size(), std::numeric_limits<float>::quiet_NaN());
    log_sum_exp.assign(static_cast<std::size_t>(shape_.batch * shape_.heads * shape_.queries), 7.0f);
    arrays.output = view<float>(output, shape_.queries);
    arrays.log_sum_exp = log_sum_exp.data();
    return arrays;
  }

  void forward(const KernelSettings& settings) { attention_forward(forward_arrays(), settings); }

  void backward(const KernelSettings& settings) {
    AttentionBackward arrays;
    arrays.forward = forward_arrays();
    attention_forward(arrays.forward, settings);
    const float nan = std::numeric_limits<float>::quiet_NaN();
    query_gradient.assign(query_.size(), nan);
    key_gradient.assign(key_.size(), nan);
    value_gradient.assign(value_.size(), nan);
    arrays.output_gradient = view<const float>(output_gradient_, shape_.queries);
    arrays.query_gradient = view<float>(query_gradient, shape_.queries);
    arrays.key_gradient = view<float>(key_gradient, shape_.keys);
    arrays.value_gradient = view<float>(value_gradient, shape_.keys);
    attention_backward(arrays, settings);
  }

  const ReferenceAttention& reference() {
    if (reference_.output.empty()) {
      reference_.query.assign(query_.begin(), query_.end());
      reference_.key.assign(key_.begin(), key_.end());
      reference_.value.assign(value_.begin(), value_.end());
      run_reference(shape_, prope_, reference_);
    }
    return reference_;
  }

  ReferenceGradients reference_gradients() {
    const std::vector<double> gradient(output_gradient_.begin(), output_gradient_.end());
    return test::reference_gradients(shape_, prope_, reference(), gradient);
  }

  std::vector<float> output, log_sum_exp, query_gradient, key_gradient, value_gradient;

 private:
  template <class Float, class Array>
  StridedHeads<Float> view(Array& array, int64_t tokens) const {
    return {array.data(), tokens * shape_.heads * shape_.head_dim, shape_.heads * shape_.head_dim,
            shape_.head_dim};
  }

  AttentionShape shape_;
  const PropePointers* prope_ = nullptr;
  std::vector<float> query_, key_, value_, output_gradient_;
  ReferenceAttention reference_;
};

// Returns max |a - b| / max |b|; infinite when a value is not finite.
inline double relative_error(const std::vector<float>& found, const std::vector<double>& expected) {
  double error = 0, largest = 0;
  EXPECT_EQ(found.size(), expected.size());
  for (std::size_t i = 0; i < found.size(); ++i) {
    if (!std::isfinite(found[i])) return std::numeric_limits<double>::infinity();
    error = std::max(error, std::abs(static_cast<double>(found[i]) - expected[i]));
    largest = std::max(largest, std::abs(expected[i]));
  }
  return largest > 0 ? error / largest : error;
}

inline void expect_gradients(Case& problem, const KernelSettings& settings, double tolerance) {
  problem.backward(settings);
  const auto expected = problem.reference_gradients();
  EXPECT_LE(relative_error(problem.query_gradient, expected.query), tolerance);
  EXPECT_LE(relative_error(problem.key_gradient, expected.key), tolerance);
  EXPECT_LE(relative_error(problem.value_gradient, expected.value), tolerance);
}

inline AttentionShape shape_of(int64_t queries, int64_t keys, int64_t head_dim) {
  return {2, 2, queries, keys, head_dim};
}

// Random tables for a scene; what they hold is up to gld/camera_encoding/prope.h and of no concern here.
struct PropeCase {
  PropeCase(int64_t views, int64_t prefix, int64_t height, int64_t width, int64_t head_dim) {
    std::mt19937 engine(5);
    std::normal_distribution<float> normal;
    const auto fill = [&](int64_t count, std::vector<float>& values) {
      values.resize(static_cast<std::size_t>(count));
      for (float& x : values) x = normal(engine);
    };
    fill(views * 16, query);
    fill(views * 16, key_value);
    fill(views * 16, output);
    const auto angles = [&](int64_t count, std::vector<float>& cosines, std::vector<float>& sines) {
      fill(count, cosines);
      sines = cosines;
      for (float& x : cosines) x = std::cos(x);
      for (float& x : sines) x = std::sin(x);
    };
    angles(width * head_dim / 8, column_cos, column_sin);
    angles(height * head_dim / 8, row_cos, row_sin);
    pointers = {views,
                prefix,
                height,
                width,
                query.data(),
                key_value.data(),
                output.data(),
                column_cos.data(),
                column_sin.data(),
                row_cos.data(),
                row_sin.data()};
  }

  std::vector<float> query, key_value, output, column_cos, column_sin, row_cos, row_sin;
  PropePointers pointers;
};

}  // namespace gld::test
