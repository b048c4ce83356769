#include "gld/splatting/naive_splatting.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace gld {
namespace {

constexpr double kDensest = 0.99;

std::vector<size_t> front_to_back(const NaiveScene& scene) {
  std::vector<size_t> order(scene.splats.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t a, size_t b) { return scene.splats[a].depth < scene.splats[b].depth; });
  return order;
}

struct Seen {
  size_t splat;
  double dx, dy, alpha, before;  // before: what the ones in front let through
  double value;                  // of alpha, before it is held
};

double relative_distance(double value, double jump) { return std::abs(value - jump) / jump; }

// Finds the Gaussians of a pixel, and returns what is left behind them.
double look_through(const NaiveScene& scene, const std::vector<size_t>& order, int64_t x, int64_t y,
                    std::vector<Seen>& seen, double& to_jump) {
  seen.clear();
  double left = 1;
  to_jump = 1;
  for (const size_t i : order) {
    const NaiveSplat& splat = scene.splats[i];
    Seen one;
    one.splat = i;
    one.dx = static_cast<double>(x) + 0.5 - splat.mean[0];
    one.dy = static_cast<double>(y) + 0.5 - splat.mean[1];
    const double q = (splat.covariance[2] * one.dx * one.dx - 2 * splat.covariance[1] * one.dx * one.dy +
                      splat.covariance[0] * one.dy * one.dy) /
                     splat.determinant;
    const double value = splat.opacity * std::exp(-0.5 * q);
    to_jump = std::min(
        {to_jump, relative_distance(value, scene.options.least_alpha), relative_distance(value, kDensest)});
    if (value < scene.options.least_alpha) continue;
    one.alpha = std::min(kDensest, value);
    one.value = value;
    one.before = left;
    to_jump = std::min(to_jump, relative_distance(left * (1 - one.alpha), scene.options.least_transmittance));
    if (left * (1 - one.alpha) < scene.options.least_transmittance) break;
    left *= 1 - one.alpha;
    seen.push_back(one);
  }
  return left;
}

}  // namespace

NaiveSplat naive_splat(const ProjectedGaussian& projected) {
  NaiveSplat splat;
  splat.depth = projected.x_in_camera[2];
  splat.mean[0] = projected.mean[0];
  splat.mean[1] = projected.mean[1];
  std::copy(projected.covariance, projected.covariance + 3, splat.covariance);
  splat.determinant = projected.determinant;
  splat.opacity = projected.opacity;
  return splat;
}

NaiveImage render_naively(const NaiveScene& scene) {
  const auto order = front_to_back(scene);
  const int64_t pixels = scene.width * scene.height;
  NaiveImage image;
  image.values.assign(static_cast<size_t>(scene.channels * pixels), 0.0);
  image.transmittance.resize(static_cast<size_t>(pixels));
  image.to_jump.resize(static_cast<size_t>(pixels));
  std::vector<Seen> seen;
  for (int64_t pixel = 0; pixel < pixels; ++pixel) {
    const auto at = static_cast<size_t>(pixel);
    const double left =
        look_through(scene, order, pixel % scene.width, pixel / scene.width, seen, image.to_jump[at]);
    image.transmittance[at] = left;
    for (int64_t c = 0; c < scene.channels; ++c) {
      double sum = scene.background.empty() ? 0 : left * scene.background[static_cast<size_t>(c)];
      for (const Seen& one : seen) {
        sum += one.alpha * one.before *
               scene.features[one.splat * static_cast<size_t>(scene.channels) + static_cast<size_t>(c)];
      }
      image.values[static_cast<size_t>(c * pixels) + at] = sum;
    }
  }
  return image;
}

NaiveGradients render_naively_backward(const NaiveScene& scene, const std::vector<double>& of_image) {
  const auto order = front_to_back(scene);
  const int64_t pixels = scene.width * scene.height;
  const auto channels = static_cast<size_t>(scene.channels);
  NaiveGradients gradients;
  gradients.splats.resize(scene.splats.size());
  gradients.features.assign(scene.features.size(), 0.0);
  std::vector<Seen> seen;
  for (int64_t pixel = 0; pixel < pixels; ++pixel) {
    double to_jump;
    const double left = look_through(scene, order, pixel % scene.width, pixel / scene.width, seen, to_jump);
    const auto gradient = [&](size_t c) {
      return of_image[c * static_cast<size_t>(pixels) + static_cast<size_t>(pixel)];
    };
    double behind = 0;
    for (size_t c = 0; c < channels && !scene.background.empty(); ++c)
      behind += left * scene.background[c] * gradient(c);
    for (size_t k = seen.size(); k-- > 0;) {
      const Seen& one = seen[k];
      const NaiveSplat& splat = scene.splats[one.splat];
      double q = 0;
      for (size_t c = 0; c < channels; ++c) {
        q += scene.features[one.splat * channels + c] * gradient(c);
        gradients.features[one.splat * channels + c] += one.alpha * one.before * gradient(c);
      }
      const double of_alpha = one.before * q - behind / (1 - one.alpha);
      behind += one.alpha * one.before * q;
      if (one.value >= kDensest && scene.held_alpha_gradient == HeldAlphaGradient::kNone) continue;
      const double a = one.value * of_alpha;
      NaiveSplat& sum = gradients.splats[one.splat];
      sum.opacity += a;
      // S2^-1 d
      const double px = (splat.covariance[2] * one.dx - splat.covariance[1] * one.dy) / splat.determinant,
                   py = (splat.covariance[0] * one.dy - splat.covariance[1] * one.dx) / splat.determinant;
      sum.mean[0] += a * px;
      sum.mean[1] += a * py;
      sum.covariance[0] += 0.5 * a * px * px;
      sum.covariance[1] += 0.5 * a * px * py;
      sum.covariance[2] += 0.5 * a * py * py;
    }
  }
  return gradients;
}

}  // namespace gld
