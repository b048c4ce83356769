#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include <torch/types.h>

namespace gld {

// What the multistep solvers of the data prediction (DPM-Solver++, UniPC) remember: the newest predictions first.
class DataHistory {
 public:
  void add(double time, const torch::Tensor& data, size_t limit) {
    times_.insert(times_.begin(), time);
    values_.insert(values_.begin(), data);
    times_.resize(std::min(times_.size(), limit));
    values_.resize(times_.size());
  }
  const std::vector<double>& times() const { return times_; }
  std::vector<double> newest_times(size_t count) const {
    return {times_.begin(), times_.begin() + static_cast<std::ptrdiff_t>(std::min(count, times_.size()))};
  }
  // Returns (next/start) x + sum_j weights_j D_j.
  torch::Tensor combine(const torch::Tensor& x, double ratio, const std::vector<double>& weights) const {
    auto result = x * ratio;
    for (size_t j = 0; j < weights.size(); ++j) {
      if (weights[j] != 0) result.add_(values_[j], weights[j]);
    }
    return result;
  }

 private:
  std::vector<double> times_;
  std::vector<torch::Tensor> values_;
};

}  // namespace gld
