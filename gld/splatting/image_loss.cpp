#include "gld/splatting/image_loss.h"

#include "gld/kernels/kernel_table.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

namespace gld {
namespace {

constexpr int64_t kRadius = kWeightedRows / 2;
constexpr float kMeanGuard = 0.01F * 0.01F, kVarianceGuard = 0.03F * 0.03F;

std::array<float, kWeightedRows> window_weights() {
  constexpr double kDeviation = 1.5;
  std::array<double, kWeightedRows> weights{};
  for (int64_t k = 0; k < kWeightedRows; ++k) {
    const auto x = static_cast<double>(k - kRadius);
    weights[static_cast<size_t>(k)] = std::exp(-x * x / (2 * kDeviation * kDeviation));
  }
  const double sum = std::accumulate(weights.begin(), weights.end(), 0.0);
  std::array<float, kWeightedRows> result{};
  for (size_t k = 0; k < result.size(); ++k) result[k] = static_cast<float>(weights[k] / sum);
  return result;
}

// This gives rows of pictures under the window; there is one a thread.
class Window {
 public:
  Window(int64_t width, const KernelTable& kernels)
      : width_(width),
        kernels_(kernels),
        weights_(window_weights()),
        zeros_(static_cast<size_t>(width), 0.0F),
        padded_(static_cast<size_t>(width + 2 * kRadius), 0.0F) {}

  void row(const SplatImage& image, int64_t channel, int64_t y, float* result) {
    WeightedRows rows{};
    rows.weights = weights_.data();
    rows.count = width_;
    for (int64_t k = 0; k < kWeightedRows; ++k) {
      const int64_t from = y + k - kRadius;
      rows.rows[k] = from >= 0 && from < image.height ? image.row(channel, from) : zeros_.data();
    }
    rows.sum = padded_.data() + kRadius;
    kernels_.weighted_rows(rows);
    for (int64_t k = 0; k < kWeightedRows; ++k) rows.rows[k] = padded_.data() + k;
    rows.sum = result;
    kernels_.weighted_rows(rows);
  }

 private:
  int64_t width_;
  const KernelTable& kernels_;
  std::array<float, kWeightedRows> weights_;
  std::vector<float> zeros_, padded_;
};

// Calls work(channel, y, window) for every row.
template <class Work>
void for_each_row(const SplatImage& image, const KernelSettings& settings, const Work& work) {
  const KernelTable& kernels = kernel_table(settings.instruction_set);
#pragma omp parallel num_threads(settings.threads)
  {
    Window window(image.width, kernels);
#pragma omp for schedule(static)
    for (int64_t row = 0; row < image.channels * image.height; ++row)
      work(row / image.height, row % image.height, window);
  }
}

}  // namespace

LossTarget loss_target(SplatImage image, std::vector<uint8_t> valid, const KernelSettings& settings) {
  LossTarget target;
  SplatImage squares = image;
  for (float& value : squares.values) value *= value;
  target.mean = target.square = SplatImage(image.channels, image.width, image.height);
  for_each_row(image, settings, [&](int64_t channel, int64_t y, Window& window) {
    window.row(image, channel, y, target.mean.row(channel, y));
    window.row(squares, channel, y, target.square.row(channel, y));
  });
  target.image = std::move(image);
  target.valid = std::move(valid);
  return target;
}

ImageLoss image_loss(const SplatImage& image, const LossTarget& target, double dissimilarity,
                     const KernelSettings& settings) {
  const int64_t width = image.width, height = image.height, channels = image.channels;
  const double numbers = static_cast<double>(channels * width * height);
  const auto columns = static_cast<size_t>(width);
  SplatImage x = image;
  if (!target.valid.empty()) {
    for (int64_t c = 0; c < channels; ++c) {
      for (int64_t i = 0; i < width * height; ++i) {
        if (target.valid[static_cast<size_t>(i)] == 0)
          x.row(c, i / width)[i % width] = target.image.row(c, i / width)[i % width];
      }
    }
  }
  SplatImage square(channels, width, height), product = square, of_mean = square, of_square = square,
                                              of_product = square;
  ImageLoss result;
  result.gradient = SplatImage(channels, width, height);
  std::vector<double> absolute(static_cast<size_t>(channels * height)), similarity(absolute.size());
  for_each_row(x, settings, [&](int64_t c, int64_t y, Window&) {
    const float *a = x.row(c, y), *b = target.image.row(c, y);
    float *aa = square.row(c, y), *ab = product.row(c, y);
    double sum = 0;
    for (int64_t i = 0; i < width; ++i) {
      aa[i] = a[i] * a[i];
      ab[i] = a[i] * b[i];
      sum += std::abs(a[i] - b[i]);
    }
    absolute[static_cast<size_t>(c * height + y)] = sum;
  });
  for_each_row(x, settings, [&](int64_t c, int64_t y, Window& window) {
    std::vector<float> mean(columns), second(columns), mixed(columns);
    window.row(x, c, y, mean.data());
    window.row(square, c, y, second.data());
    window.row(product, c, y, mixed.data());
    const float *target_mean = target.mean.row(c, y), *target_square = target.square.row(c, y);
    float *dm = of_mean.row(c, y), *ds = of_square.row(c, y), *dp = of_product.row(c, y);
    double sum = 0;
    for (int64_t i = 0; i < width; ++i) {
      const float m = mean[static_cast<size_t>(i)], t = target_mean[i];
      const float variances = second[static_cast<size_t>(i)] - m * m + target_square[i] - t * t;
      const float covariance = mixed[static_cast<size_t>(i)] - m * t;
      const float a1 = 2 * m * t + kMeanGuard, a2 = 2 * covariance + kVarianceGuard,
                  b1 = m * m + t * t + kMeanGuard, b2 = variances + kVarianceGuard;
      const float inverse = 1 / (b1 * b2), ssim = a1 * a2 * inverse;
      dp[i] = 2 * a1 * inverse;
      ds[i] = -ssim / b2;
      dm[i] = 2 * t * (a2 - a1) * inverse + 2 * m * ssim * (1 / b2 - 1 / b1);
      sum += ssim;
    }
    similarity[static_cast<size_t>(c * height + y)] = sum;
  });
  const auto absolute_share = static_cast<float>((1 - dissimilarity) / numbers),
             similarity_share = static_cast<float>(-dissimilarity / numbers);
  for_each_row(x, settings, [&](int64_t c, int64_t y, Window& window) {
    std::vector<float> mean(columns), second(columns), mixed(columns);
    window.row(of_mean, c, y, mean.data());
    window.row(of_square, c, y, second.data());
    window.row(of_product, c, y, mixed.data());
    const float *a = x.row(c, y), *b = target.image.row(c, y);
    float* const gradient = result.gradient.row(c, y);
    for (int64_t i = 0; i < width; ++i) {
      const auto at = static_cast<size_t>(i);
      const float sign = static_cast<float>(a[i] > b[i]) - static_cast<float>(a[i] < b[i]);
      gradient[i] =
          absolute_share * sign + similarity_share * (mean[at] + 2 * a[i] * second[at] + b[i] * mixed[at]);
    }
    if (target.valid.empty()) return;
    for (int64_t i = 0; i < width; ++i) {
      if (target.valid[static_cast<size_t>(y * width + i)] == 0) gradient[i] = 0;
    }
  });
  result.absolute = std::accumulate(absolute.begin(), absolute.end(), 0.0) / numbers;
  result.similarity = std::accumulate(similarity.begin(), similarity.end(), 0.0) / numbers;
  result.loss = (1 - dissimilarity) * result.absolute + dissimilarity * (1 - result.similarity);
  return result;
}

double mean_squared_error(const SplatImage& image, const LossTarget& target) {
  double sum = 0, count = 0;
  for (int64_t c = 0; c < image.channels; ++c) {
    for (int64_t y = 0; y < image.height; ++y) {
      for (int64_t x = 0; x < image.width; ++x) {
        if (!target.valid.empty() && target.valid[static_cast<size_t>(y * image.width + x)] == 0) continue;
        const double off = std::clamp(image.row(c, y)[x], 0.0F, 1.0F) - target.image.row(c, y)[x];
        sum += off * off;
        count += 1;
      }
    }
  }
  return count > 0 ? sum / count : 0;
}

double decibels(double mean_squared) { return -10 * std::log10(mean_squared); }

}  // namespace gld
