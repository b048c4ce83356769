#include "gld/splatting/feature_solve.h"

#include "gld/base/error.h"

#include <algorithm>
#include <cmath>

namespace gld {
namespace {

struct Problem {
  const std::vector<FeatureView>& views;
  int64_t gaussians;
  int64_t channels;
  const KernelSettings& settings;

  // W^T picture, added to sum (gaussians, channels).
  void add_transposed(const FeatureView& view, const SplatImage& picture, int64_t picture_channels,
                      std::vector<float>& sum) const {
    SplatFeatures features;
    features.channels = picture_channels;
    const CompositingGradients gradients =
        composite_backward(view.view, features, picture, SplatGradients::kFeatures, settings);
    for (int64_t i = 0; i < view.view.size(); ++i) {
      const int64_t index = view.view.splats[static_cast<size_t>(i)].index;
      for (int64_t c = 0; c < picture_channels; ++c)
        sum[static_cast<size_t>(index * picture_channels + c)] +=
            gradients.features[static_cast<size_t>(i * picture_channels + c)];
    }
  }

  // W^T W f over all views.
  std::vector<float> normal_product(const std::vector<float>& f, int64_t of_channels) const {
    std::vector<float> sum(f.size(), 0.0F);
    SplatFeatures features;
    features.values = f.data();
    features.channels = of_channels;
    features.by_index = true;
    for (const FeatureView& view : views)
      add_transposed(view, composite(view.view, features, settings).image, of_channels, sum);
    return sum;
  }
};

// sum over Gaussians of a b scale, by channel.
std::vector<double> products(const std::vector<float>& a, const std::vector<float>& b,
                             const std::vector<float>* scale, int64_t channels) {
  std::vector<double> sum(static_cast<size_t>(channels), 0.0);
  for (size_t i = 0; i < a.size(); ++i) {
    const size_t c = i % static_cast<size_t>(channels);
    const double factor = scale == nullptr ? 1 : (*scale)[i / static_cast<size_t>(channels)];
    sum[c] += static_cast<double>(a[i]) * b[i] * factor;
  }
  return sum;
}

}  // namespace

void FeatureSolveOptions::visit(FieldVisitor& visitor) {
  visitor.real({"tolerance", "of the normal equations' residual, relative to the first"}, tolerance, {0, 1});
  visitor.integer({"most_iterations", "of conjugate gradients"}, most_iterations, {1, 100000});
  visitor.real({"ridge", "weight of small features beside each Gaussian's total weight"}, ridge, {0, 1});
}

SolvedFeatures solve_features(const std::vector<FeatureView>& views, int64_t gaussians,
                              const FeatureSolveOptions& options, const KernelSettings& settings) {
  if (views.empty()) fail({"features of splats", "views to solve them from", "none", "give some"});
  const Problem problem{views, gaussians, views.front().picture.channels, settings};
  const auto channels = static_cast<size_t>(problem.channels);
  SolvedFeatures result;
  result.features.assign(static_cast<size_t>(gaussians) * channels, 0.0F);
  const std::vector<float> total =
      problem.normal_product(std::vector<float>(static_cast<size_t>(gaussians), 1.0F), 1);
  std::vector<float> inverse(total.size());
  for (size_t i = 0; i < total.size(); ++i)
    inverse[i] = total[i] > 0 ? static_cast<float>(1 / (total[i] * (1 + options.ridge))) : 0.0F;
  std::vector<float> residual(result.features.size(), 0.0F);
  for (const FeatureView& view : views)
    problem.add_transposed(view, view.picture, problem.channels, residual);
  std::vector<float> direction(residual.size());
  for (size_t i = 0; i < residual.size(); ++i) direction[i] = residual[i] * inverse[i / channels];
  std::vector<double> size = products(residual, residual, &inverse, problem.channels);
  const std::vector<double> first = size;
  for (int64_t iteration = 0; iteration < options.most_iterations; ++iteration) {
    std::vector<float> image = problem.normal_product(direction, problem.channels);
    for (size_t i = 0; i < image.size(); ++i)
      image[i] += static_cast<float>(options.ridge) * total[i / channels] * direction[i];
    const std::vector<double> curvature = products(direction, image, nullptr, problem.channels);
    std::vector<float> step(channels);
    for (size_t c = 0; c < channels; ++c)
      step[c] = curvature[c] > 0 ? static_cast<float>(size[c] / curvature[c]) : 0.0F;
    for (size_t i = 0; i < residual.size(); ++i) {
      result.features[i] += step[i % channels] * direction[i];
      residual[i] -= step[i % channels] * image[i];
    }
    const std::vector<double> next = products(residual, residual, &inverse, problem.channels);
    double worst = 0;
    std::vector<float> turn(channels);
    for (size_t c = 0; c < channels; ++c) {
      turn[c] = size[c] > 0 ? static_cast<float>(next[c] / size[c]) : 0.0F;
      if (first[c] > 0) worst = std::max(worst, std::sqrt(next[c] / first[c]));
    }
    for (size_t i = 0; i < direction.size(); ++i)
      direction[i] = residual[i] * inverse[i / channels] + turn[i % channels] * direction[i];
    size = next;
    result.residuals.push_back(worst);
    if (worst <= options.tolerance) break;
  }
  return result;
}

}  // namespace gld
