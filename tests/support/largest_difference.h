#pragma once

#include <torch/types.h>

namespace gld::test {

inline double largest_difference(const torch::Tensor& a, const torch::Tensor& b) {
  return (a - b).abs().max().item<double>();
}

}  // namespace gld::test
