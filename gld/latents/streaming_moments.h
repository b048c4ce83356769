#pragma once

#include <cstdint>
#include <vector>

namespace gld {

// Mean and variance of each channel over rows that come in batches, in double. Batches are summed in two passes and
// merged by the update of Chan, Golub and LeVeque (1983), so that a mean far from zero costs no digits; the result
// does not depend on how the rows are split beyond rounding, and parts from several processes can be merged.
class StreamingMoments {
 public:
  explicit StreamingMoments(int64_t channels);
  // Takes the state of another one, e.g. from a file. squares are sums of squared differences from the mean.
  StreamingMoments(int64_t count, std::vector<double> mean, std::vector<double> squares);

  // rows are count x channels numbers, row by row. Throws Error where one is not finite.
  void add(const float* rows, int64_t count);
  // Throws Error when other has another number of channels.
  void merge(const StreamingMoments& other);

  int64_t channels() const { return static_cast<int64_t>(mean_.size()); }
  int64_t count() const { return count_; }
  const std::vector<double>& mean() const { return mean_; }
  const std::vector<double>& squares() const { return squares_; }
  // Returns squares / count (population variance, as in the published statistics). Throws Error without rows.
  std::vector<double> variance() const;

 private:
  int64_t count_ = 0;
  std::vector<double> mean_;
  std::vector<double> squares_;
};

}  // namespace gld
