#include "gld/splatting/feature_solve.h"

#include "gld/base/error.h"
#include "gld/kernels/kernel_table.h"
#include "gld/splatting/feature_harmonics.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

namespace gld {
namespace {

int64_t padded(int64_t channels) { return (channels + kSparseStride - 1) / kSparseStride * kSparseStride; }

// Rows of channels, each padded with zeros to a multiple of kSparseStride.
struct ChannelTable {
  int64_t rows = 0, stride = 0;
  std::vector<float> values;

  ChannelTable(int64_t row_count, int64_t channels)
      : rows(row_count),
        stride(padded(channels)),
        values(static_cast<size_t>(row_count * padded(channels)), 0.0F) {}
  float* row(int64_t number) { return values.data() + number * stride; }
  const float* row(int64_t number) const { return values.data() + number * stride; }
};

struct Sparse {
  std::vector<int64_t> first;
  std::vector<int32_t> columns;
  std::vector<float> values;

  int64_t rows() const { return static_cast<int64_t>(first.size()) - 1; }
};

// Entries of a column keep the order of the rows.
Sparse transposed(const Sparse& from, int64_t columns) {
  Sparse to;
  to.first.assign(static_cast<size_t>(columns) + 1, 0);
  for (const int32_t column : from.columns) ++to.first[static_cast<size_t>(column) + 1];
  for (size_t i = 0; i + 1 < to.first.size(); ++i) to.first[i + 1] += to.first[i];
  to.columns.resize(from.columns.size());
  to.values.resize(from.values.size());
  std::vector<int64_t> next(to.first.begin(), to.first.end() - 1);
  for (int64_t row = 0; row < from.rows(); ++row) {
    for (int64_t k = from.first[static_cast<size_t>(row)]; k < from.first[static_cast<size_t>(row) + 1];
         ++k) {
      const auto place =
          static_cast<size_t>(next[static_cast<size_t>(from.columns[static_cast<size_t>(k)])]++);
      to.columns[place] = static_cast<int32_t>(row);
      to.values[place] = from.values[static_cast<size_t>(k)];
    }
  }
  return to;
}

// Adds the weights of a view's pixels, and of each harmonic of its Gaussians: their columns are (gaussian,
// coefficient).
void add_rows(const SplatView& view, const GaussianSet& set, int64_t degree, const KernelSettings& settings,
              Sparse& rows) {
  const PixelWeights weights = pixel_weights(view, settings);
  const int64_t before = rows.first.back(), each = harmonic_coefficients(degree);
  for (size_t pixel = 1; pixel < weights.first.size(); ++pixel)
    rows.first.push_back(before + each * weights.first[pixel]);
  const std::vector<float> harmonics = feature_harmonics(set, view, degree, settings);
  std::vector<int32_t> splat_of(static_cast<size_t>(set.size()), -1);
  for (int64_t i = 0; i < view.size(); ++i)
    splat_of[static_cast<size_t>(view.splats[static_cast<size_t>(i)].index)] = static_cast<int32_t>(i);
  for (size_t entry = 0; entry < weights.columns.size(); ++entry) {
    const int32_t gaussian = weights.columns[entry];
    const float* const of_splat = harmonics.data() + splat_of[static_cast<size_t>(gaussian)] * each;
    for (int64_t k = 0; k < each; ++k) {
      rows.columns.push_back(static_cast<int32_t>(gaussian * each + k));
      rows.values.push_back(weights.values[entry] * of_splat[k]);
    }
  }
}

// Calls work(begin, end) for parts of 0 to count, which are the same for any number of threads.
constexpr int64_t kPart = 256;
template <class Work>
void for_parts(int64_t count, int threads, const Work& work) {
#pragma omp parallel for num_threads(threads) schedule(dynamic)
  for (int64_t begin = 0; begin < count; begin += kPart) work(begin, std::min(begin + kPart, count));
}

// The unknowns are features' coefficients, (gaussians, coefficients).
class Problem {
 public:
  Problem(const std::vector<FeatureView>& views, const GaussianSet& set, int64_t degree,
          const KernelSettings& settings)
      : kernels_(kernel_table(settings.instruction_set)),
        threads_(settings.threads),
        each_(harmonic_coefficients(degree)) {
    by_pixel_.first.assign(1, 0);
    for (const FeatureView& view : views) add_rows(view.view, set, degree, settings, by_pixel_);
    constexpr int64_t kMost = std::numeric_limits<int32_t>::max();
    if (by_pixel_.rows() > kMost || set.size() * each_ > kMost) {
      fail({"features of splats", "less than 2^31 pixels and coefficients",
            std::to_string(std::max(by_pixel_.rows(), set.size() * each_)), "take fewer or smaller views"});
    }
    by_unknown_ = transposed(by_pixel_, set.size() * each_);
    sum_weights();
  }

  int64_t pixels() const { return by_pixel_.rows(); }
  int64_t unknowns() const { return by_unknown_.rows(); }
  int threads() const { return threads_; }
  // Whether it is the coefficient that does not depend on the direction of view.
  bool is_first(int64_t unknown) const { return unknown % each_ == 0; }

  // These compute W f and W^T p.
  void forward(const ChannelTable& f, ChannelTable& p) const { multiply(by_pixel_, f, p); }
  void back(const ChannelTable& p, ChannelTable& f) const { multiply(by_unknown_, p, f); }

  // Of the Gaussian of an unknown these return the sum of its weights, and t.
  float weight(int64_t i) const { return weights_[static_cast<size_t>(i / each_ * each_)]; }
  float total(int64_t i) const { return totals_[static_cast<size_t>(i / each_ * each_)]; }
  // Returns |W|^T |W| 1 of the unknown.
  float bound(int64_t i) const { return bounds_[static_cast<size_t>(i)]; }

 private:
  void sum_weights() {
    ChannelTable ones(unknowns(), 1), seen(pixels(), 1), sum(unknowns(), 1);
    for (int64_t i = 0; i < unknowns(); i += each_) *ones.row(i) = 1;
    forward(ones, seen);
    back(seen, sum);
    for (int64_t i = 0; i < unknowns(); ++i) totals_.push_back(*sum.row(i));
    bounds_ = totals_;
    if (each_ > 1) bound_unknowns();
    for (int64_t i = 0; i < pixels(); ++i) *seen.row(i) = 1;
    back(seen, sum);
    for (int64_t i = 0; i < unknowns(); ++i) weights_.push_back(*sum.row(i));
  }

  // Weights are positive, harmonics are not.
  void bound_unknowns() {
    std::vector<double> seen(static_cast<size_t>(pixels()));
    for (int64_t pixel = 0; pixel < pixels(); ++pixel) {
      for (int64_t k = by_pixel_.first[static_cast<size_t>(pixel)];
           k < by_pixel_.first[static_cast<size_t>(pixel) + 1]; ++k)
        seen[static_cast<size_t>(pixel)] += std::abs(by_pixel_.values[static_cast<size_t>(k)]);
    }
    for (int64_t i = 0; i < unknowns(); ++i) {
      double sum = 0;
      for (int64_t k = by_unknown_.first[static_cast<size_t>(i)];
           k < by_unknown_.first[static_cast<size_t>(i) + 1]; ++k) {
        const auto entry = static_cast<size_t>(k);
        sum += std::abs(static_cast<double>(by_unknown_.values[entry])) *
               seen[static_cast<size_t>(by_unknown_.columns[entry])];
      }
      bounds_[static_cast<size_t>(i)] = static_cast<float>(sum);
    }
  }

  void multiply(const Sparse& matrix, const ChannelTable& table, ChannelTable& sums) const {
    for_parts(matrix.rows(), threads_, [&](int64_t begin, int64_t end) {
      kernels_.sparse_rows({matrix.first.data(), matrix.columns.data(), matrix.values.data(), begin, end,
                            table.values.data(), table.stride, sums.values.data()});
    });
  }

  const KernelTable& kernels_;
  int threads_;
  int64_t each_;  // coefficients of a Gaussian
  Sparse by_pixel_, by_unknown_;
  std::vector<float> weights_, totals_, bounds_;  // (unknowns)
};

// Returns channels `first` to `first + channels` of all views' pixels.
ChannelTable pixels_of(const std::vector<FeatureView>& views, int64_t pixels, int64_t first,
                       int64_t channels) {
  ChannelTable table(pixels, channels);
  int64_t row = 0;
  for (const FeatureView& view : views) {
    const SplatImage& picture = view.picture;
    for (int64_t y = 0; y < picture.height; ++y) {
      for (int64_t x = 0; x < picture.width; ++x, ++row) {
        for (int64_t c = 0; c < channels; ++c) table.row(row)[c] = picture.row(first + c, y)[x];
      }
    }
  }
  return table;
}

void check_views(const std::vector<FeatureView>& views) {
  if (views.empty()) fail({"features of splats", "views to solve them from", "none", "give some"});
  for (const FeatureView& view : views) {
    const SplatImage& picture = view.picture;
    if (picture.channels == views.front().picture.channels && picture.width == view.view.camera.width &&
        picture.height == view.view.camera.height)
      continue;
    fail({"features of splats", "pictures of one number of channels, of their views' size", "others",
          "give each view its own picture"});
  }
}

// Some channels of the problem, each with steps of its own.
class ChannelSolve {
 public:
  ChannelSolve(const Problem& problem, ChannelTable pixels, float ridge)
      : problem_(problem),
        ridge_(ridge),
        stride_(pixels.stride),
        pixels_(std::move(pixels)),
        values_(problem.unknowns(), stride_),
        residual_(problem.unknowns(), stride_),
        direction_(problem.unknowns(), stride_),
        image_(problem.unknowns(), stride_) {
    begin_at_means();
    right_ = sums([&](int64_t i, double* sum) {
      const float weight = ridge_ * problem_.total(i), scale = inverse(i);
      const float *const residual = residual_.row(i), *const mean = values_.row(i);
      for (int64_t c = 0; c < stride_; ++c) {
        const double value = residual[c] + weight * mean[c];
        sum[c] += value * value * scale;
      }
    });
    // What the means leave; the ridge has no part in it.
    ChannelTable seen(problem_.pixels(), stride_);
    problem_.forward(values_, seen);
    for (size_t k = 0; k < pixels_.values.size(); ++k) pixels_.values[k] -= seen.values[k];
    problem_.back(pixels_, residual_);
    size_ = size_of_residual();
    turn_.assign(static_cast<size_t>(stride_), 0.0F);
    turn_direction();
  }

  // Returns the residual of the worst channel, relative to the right side.
  double residual() const {
    double worst = 0;
    for (size_t c = 0; c < size_.size(); ++c) {
      if (!(size_[c] >= 0)) return std::numeric_limits<double>::infinity();
      if (right_[c] > 0) worst = std::max(worst, std::sqrt(size_[c] / right_[c]));
    }
    return worst;
  }

  void iterate() {
    problem_.forward(direction_, pixels_);  // which are not needed any more
    problem_.back(pixels_, image_);
    const std::vector<double> curvature = sums([&](int64_t i, double* sum) {
      const float weight = ridge_ * problem_.total(i);
      float* const image = image_.row(i);
      const float* const direction = direction_.row(i);
      for (int64_t c = 0; c < stride_; ++c) {
        image[c] += weight * direction[c];
        sum[c] += static_cast<double>(direction[c]) * image[c];
      }
    });
    std::vector<float> step(static_cast<size_t>(stride_));
    for (size_t c = 0; c < step.size(); ++c)
      step[c] = curvature[c] > 0 ? static_cast<float>(size_[c] / curvature[c]) : 0.0F;
    per_row([&](int64_t i) {
      float *const value = values_.row(i), *const residual = residual_.row(i);
      const float *const direction = direction_.row(i), *const image = image_.row(i);
      for (int64_t c = 0; c < stride_; ++c) {
        value[c] += step[static_cast<size_t>(c)] * direction[c];
        residual[c] -= step[static_cast<size_t>(c)] * image[c];
      }
    });
    const std::vector<double> next = size_of_residual();
    for (size_t c = 0; c < turn_.size(); ++c)
      turn_[c] = size_[c] > 0 ? static_cast<float>(next[c] / size_[c]) : 0.0F;
    size_ = next;
    turn_direction();
  }

  const float* values(int64_t unknown) const { return values_.row(unknown); }

 private:
  // Returns the inverse of what bounds the diagonal of the normal equations' rows, ridge included.
  float inverse(int64_t i) const {
    const float bound = problem_.bound(i) + ridge_ * problem_.total(i);
    return bound > 0 ? 1 / bound : 0.0F;
  }

  // Sets values = m and residual = W^T pictures.
  void begin_at_means() {
    problem_.back(pixels_, residual_);
    per_row([&](int64_t i) {
      const float sum = problem_.is_first(i) && problem_.total(i) > 0 ? problem_.weight(i) : 0;
      for (int64_t c = 0; c < stride_ && sum > 0; ++c) values_.row(i)[c] = residual_.row(i)[c] / sum;
    });
  }

  void turn_direction() {
    per_row([&](int64_t i) {
      const float scale = inverse(i);
      float* const direction = direction_.row(i);
      const float* const residual = residual_.row(i);
      for (int64_t c = 0; c < stride_; ++c)
        direction[c] = residual[c] * scale + turn_[static_cast<size_t>(c)] * direction[c];
    });
  }

  std::vector<double> size_of_residual() const {
    return sums([&](int64_t i, double* sum) {
      const double scale = inverse(i);
      const float* const residual = residual_.row(i);
      for (int64_t c = 0; c < stride_; ++c) sum[c] += static_cast<double>(residual[c]) * residual[c] * scale;
    });
  }

  template <class Work>
  void per_row(const Work& work) const {
    for_parts(problem_.unknowns(), problem_.threads(), [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) work(i);
    });
  }

  // Returns the sum over unknowns of what row(i, sums) adds for each channel, by parts, in their order.
  template <class Row>
  std::vector<double> sums(const Row& row) const {
    const auto each = static_cast<size_t>(stride_);
    std::vector<double> parts(static_cast<size_t>((problem_.unknowns() + kPart - 1) / kPart) * each, 0.0);
    for_parts(problem_.unknowns(), problem_.threads(), [&](int64_t begin, int64_t end) {
      double* const sum = parts.data() + static_cast<size_t>(begin / kPart) * each;
      for (int64_t i = begin; i < end; ++i) row(i, sum);
    });
    std::vector<double> total(each, 0.0);
    for (size_t i = 0; i < parts.size(); ++i) total[i % each] += parts[i];
    return total;
  }

  const Problem& problem_;
  float ridge_;
  int64_t stride_;
  ChannelTable pixels_;
  ChannelTable values_, residual_, direction_, image_;
  std::vector<double> right_, size_;  // squared, by channel
  std::vector<float> turn_;
};

// Takes residuals of one part of the channels among those of the others: at each iteration the worst, and the last
// where a part was done.
void take_worst(const std::vector<double>& part, std::vector<double>& all) {
  const double last = all.empty() ? 0 : all.back();
  for (size_t i = 0; i < std::max(part.size(), all.size()); ++i) {
    if (i >= all.size()) all.push_back(last);
    all[i] = std::max(all[i], i < part.size() ? part[i] : part.back());
  }
}

}  // namespace

void FeatureSolveOptions::visit(FieldVisitor& visitor) {
  visitor.real({"tolerance", "of the normal equations' residual, relative to their right side"}, tolerance,
               {0, 1});
  visitor.integer(
      {"most_iterations", "of conjugate gradients; 0: what pictures show of each Gaussian, by weight"},
      most_iterations, {0, 100000});
  visitor.real({"ridge", "weight of the distance from each Gaussian's mean, beside its total weight"}, ridge,
               {0, 1});
  visitor.integer(
      {"feature_degree",
       "of features' spherical harmonics: 0, the same from everywhere; Splatent's published code has 2"},
      feature_degree, {0, kMostHarmonicDegree});
}

SolvedFeatures solve_features(const std::vector<FeatureView>& views, const GaussianSet& set,
                              const FeatureSolveOptions& options, const KernelSettings& settings) {
  check_views(views);
  const int64_t channels = views.front().picture.channels;
  const Problem problem(views, set, options.feature_degree, settings);
  SolvedFeatures result;
  result.features.resize(static_cast<size_t>(problem.unknowns() * channels));
  constexpr int64_t kTogether = 64;
  for (int64_t first = 0; first < channels; first += kTogether) {
    const int64_t count = std::min(kTogether, channels - first);
    ChannelSolve solve(problem, pixels_of(views, problem.pixels(), first, count),
                       static_cast<float>(options.ridge));
    std::vector<double> residuals{solve.residual()};
    while (static_cast<int64_t>(residuals.size()) <= options.most_iterations &&
           residuals.back() > options.tolerance) {
      solve.iterate();
      residuals.push_back(solve.residual());
    }
    take_worst(residuals, result.residuals);
    for (int64_t i = 0; i < problem.unknowns(); ++i)
      std::copy_n(solve.values(i), count, result.features.data() + i * channels + first);
  }
  return result;
}

}  // namespace gld
