#include "gld/latents/streaming_moments.h"

#include "gld/base/error.h"

#include <cmath>
#include <string>
#include <utility>

namespace gld {

StreamingMoments::StreamingMoments(int64_t channels)
    : mean_(static_cast<size_t>(channels)), squares_(static_cast<size_t>(channels)) {}

StreamingMoments::StreamingMoments(int64_t count, std::vector<double> mean, std::vector<double> squares)
    : count_(count), mean_(std::move(mean)), squares_(std::move(squares)) {
  if (count_ < 0 || mean_.size() != squares_.size()) {
    fail({"latent statistics", "a count and as many means as sums of squares",
          std::to_string(count_) + ", " + std::to_string(mean_.size()) + " and " +
              std::to_string(squares_.size()),
          "compute the statistics again"});
  }
}

void StreamingMoments::add(const float* rows, int64_t count) {
  if (count <= 0) return;
  const size_t channels = mean_.size();
  StreamingMoments batch(static_cast<int64_t>(channels));
  batch.count_ = count;
  for (int64_t row = 0; row < count; ++row) {
    for (size_t c = 0; c < channels; ++c) batch.mean_[c] += rows[static_cast<size_t>(row) * channels + c];
  }
  for (size_t c = 0; c < channels; ++c) {
    batch.mean_[c] /= static_cast<double>(count);
    if (!std::isfinite(batch.mean_[c])) {
      fail({"latent statistics", "finite features",
            "a number that is not finite in channel " + std::to_string(c),
            "check the images and the backbone's weights"});
    }
  }
  for (int64_t row = 0; row < count; ++row) {
    for (size_t c = 0; c < channels; ++c) {
      const double difference = rows[static_cast<size_t>(row) * channels + c] - batch.mean_[c];
      batch.squares_[c] += difference * difference;
    }
  }
  merge(batch);
}

void StreamingMoments::merge(const StreamingMoments& other) {
  if (other.channels() != channels()) {
    fail({"latent statistics", std::to_string(channels()) + " channels", std::to_string(other.channels()),
          "merge statistics of the same level and backbone"});
  }
  if (other.count_ == 0) return;
  const double ours = static_cast<double>(count_), theirs = static_cast<double>(other.count_);
  const double total = ours + theirs;
  for (size_t c = 0; c < mean_.size(); ++c) {
    const double difference = other.mean_[c] - mean_[c];
    mean_[c] += difference * (theirs / total);
    squares_[c] += other.squares_[c] + difference * difference * (ours * theirs / total);
  }
  count_ += other.count_;
}

std::vector<double> StreamingMoments::variance() const {
  if (count_ == 0) {
    fail({"latent statistics", "at least one token", "none", "give scenes with images"});
  }
  std::vector<double> variance = squares_;
  for (double& value : variance) value /= static_cast<double>(count_);
  return variance;
}

}  // namespace gld
