#include "gld/photogrammetry/exposure_gains.h"

#include "gld/photogrammetry/bilinear_neighbours.h"
#include "gld/photogrammetry/percentile.h"
#include "gld/photogrammetry/photograph_composition.h"
#include "gld/photogrammetry/picture_warp.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include <Eigen/Cholesky>
#include <Eigen/Core>

namespace gld {
namespace {

// Of one colour in two photographs: the median of log(first / second) over what both show, and its weight in the
// adjustment, 0 where it says nothing.
struct LogRatio {
  double value = 0;
  double weight = 0;
};

LogRatio log_ratio(const CarriedPicture& first, const std::vector<float>& second, size_t colour) {
  constexpr float kDark = 0.05F, kBright = 0.95F;  // beyond these a ratio says nothing
  constexpr size_t kFewest = 200;                  // pixels
  std::vector<float> ratios;
  for (size_t pixel = 0; pixel < first.seen.size(); ++pixel) {
    if (first.seen[pixel] == 0) continue;
    const float a = first.rgb[3 * pixel + colour], b = second[3 * pixel + colour];
    if (a > kDark && b > kDark && a < kBright && b < kBright) ratios.push_back(std::log(a / b));
  }
  if (ratios.size() < kFewest) return {};
  const float middle = median(ratios);
  for (float& ratio : ratios) ratio = std::abs(ratio - middle);
  // 1.4826 times the median distance is the deviation of a normal distribution; 1.2533 / sqrt(n) of that is the
  // median's. Neighbouring pixels err together: a sixteenth of them counts.
  const double count = static_cast<double>(ratios.size()) / 16;
  const double scatter = 1.2533 * 1.4826 * static_cast<double>(median(ratios)) / std::sqrt(count);
  constexpr double kRounding = 1e-3;
  return {static_cast<double>(middle), 1 / (scatter * scatter + kRounding * kRounding)};
}

// Returns log gains g with g_i + log a_i = g_j + log a_j for all pairs as well as their weights allow; their sum is 0.
Eigen::VectorXd adjusted_gains(const Eigen::MatrixXd& ratios, const Eigen::MatrixXd& weights) {
  const Eigen::Index count = ratios.rows();
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(count, count);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(count);
  for (Eigen::Index i = 0; i < count; ++i) {
    for (Eigen::Index j = 0; j < count; ++j) {
      const double weight = weights(i, j);
      if (weight == 0) continue;
      // g_i - g_j = -ratio_ij
      normal(i, i) += weight;
      normal(j, j) += weight;
      normal(i, j) -= weight;
      normal(j, i) -= weight;
      right(i) -= weight * ratios(i, j);
      right(j) += weight * ratios(i, j);
    }
  }
  // Photographs that share nothing with others keep their exposure; the sum is free otherwise.
  normal.diagonal().array() += 1e-6 * (1 + normal.diagonal().maxCoeff());
  Eigen::VectorXd gains = normal.ldlt().solve(right);
  gains.array() -= gains.mean();
  return gains;
}

}  // namespace

std::vector<ColourGains> exposure_gains(const std::vector<PicturedView>& sources) {
  constexpr int64_t kSide = 128;  // pixels: medians need no more
  const size_t count = sources.size();
  std::vector<ColourGains> gains(count, ColourGains{1, 1, 1});
  if (count < 2) return gains;
  std::vector<PicturedView> small;
  small.reserve(count);
  for (const PicturedView& source : sources) small.push_back(reduced_view(source, kSide));
  const auto n = static_cast<Eigen::Index>(count);
  std::array<Eigen::MatrixXd, 3> ratios, weights;
  ratios.fill(Eigen::MatrixXd::Zero(n, n));
  weights.fill(Eigen::MatrixXd::Zero(n, n));
  CarryOptions as_it_is;
  as_it_is.depth_reach = 0;  // matching colours would hide what they differ by
  for (size_t j = 0; j < count; ++j) {
    TargetDepth depth{small[j].width, small[j].height, {}, {}};
    for (int64_t row = 0; row < depth.height; ++row) {
      for (int64_t column = 0; column < depth.width; ++column) {
        const BilinearNeighbours around(
            small[j].depth.width, small[j].depth.height,
            (static_cast<double>(column) + 0.5) * static_cast<double>(small[j].depth.width) /
                    static_cast<double>(depth.width) -
                0.5,
            (static_cast<double>(row) + 0.5) * static_cast<double>(small[j].depth.height) /
                    static_cast<double>(depth.height) -
                0.5);
        const float value = small[j].depth.values[around.nearest()];
        depth.values.push_back(PlanarDepth::known(value) ? static_cast<double>(value) : 1.0);
        depth.reached.push_back(PlanarDepth::known(value) ? 1 : 0);
      }
    }
    const auto carried = carry_pictures_to(small, small[j].camera, depth, as_it_is);
    for (size_t i = 0; i < count; ++i) {
      if (i == j) continue;
      for (size_t c = 0; c < 3; ++c) {
        const LogRatio ratio = log_ratio(carried[i], small[j].rgb, c);
        ratios[c](static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)) = ratio.value;
        weights[c](static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)) = ratio.weight;
      }
    }
  }
  constexpr double kNoDifference = 0.01;
  for (size_t c = 0; c < 3; ++c) {
    const Eigen::VectorXd adjusted = adjusted_gains(ratios[c], weights[c]);
    if (adjusted.cwiseAbs().maxCoeff() < kNoDifference) continue;
    for (size_t i = 0; i < count; ++i)
      gains[i][c] = static_cast<float>(std::exp(adjusted(static_cast<Eigen::Index>(i))));
  }
  return gains;
}

std::vector<PicturedView> evened_photographs(const std::vector<PicturedView>& sources,
                                             const std::vector<ColourGains>& gains, const Camera& target) {
  std::vector<PicturedView> even = sources;
  // The target's neighbours in time and space are the best guess of its brightness.
  ColourGains aim{0, 0, 0};
  double nearness = 0;
  for (size_t i = 0; i < sources.size(); ++i) {
    const double apart =
        (sources[i].camera.world_from_camera.translation() - target.world_from_camera.translation())
            .squaredNorm();
    const double weight = 1 / std::max(apart, 1e-12);
    nearness += weight;
    for (size_t c = 0; c < 3; ++c)
      aim[c] += static_cast<float>(weight * std::log(static_cast<double>(gains[i][c])));
  }
  for (size_t i = 0; i < sources.size(); ++i) {
    for (size_t c = 0; c < 3; ++c) {
      const float factor = gains[i][c] * std::exp(-aim[c] / static_cast<float>(nearness));
      if (factor == 1.0F) continue;
      for (size_t p = c; p < even[i].rgb.size(); p += 3) even[i].rgb[p] *= factor;
    }
  }
  return even;
}

}  // namespace gld
