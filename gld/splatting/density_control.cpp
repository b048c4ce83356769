#include "gld/splatting/density_control.h"

#include "gld/base/philox.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/Geometry>

namespace gld {
namespace {

// Sides of the halves of a Gaussian that is split are this much smaller, as published (0.8 times 2 halves).
constexpr double kSplitShrink = 1.6;
constexpr double kResetOpacity = 0.01;

double opacity_of(float logit) { return 1 / (1 + std::exp(-static_cast<double>(logit))); }

double largest_scale(const GaussianSet& set, int64_t i) {
  const float* scales = set.log_scales.data() + 3 * i;
  return std::exp(static_cast<double>(std::max({scales[0], scales[1], scales[2]})));
}

void append_new(GaussianSet& set, SplatMoments& moments, const GaussianSet& from, int64_t i) {
  append_gaussian(set, from, i);
  const GaussianSet zero = zero_gaussians_like(set, 1);
  append_gaussian(moments.first, zero, 0);
  append_gaussian(moments.second, zero, 0);
}

// Gaussian i is replaced by two, at places drawn from it; it is removed by the caller.
void split(GaussianSet& set, SplatMoments& moments, int64_t i, const PhiloxKey& key, uint64_t index) {
  GaussianSet one = zero_gaussians_like(set, 0);
  append_gaussian(one, set, i);
  const Eigen::Quaterniond rotation =
      Eigen::Quaterniond(one.rotations[0], one.rotations[1], one.rotations[2], one.rotations[3]).normalized();
  std::array<float, 8> normal{};
  fill_normal({key, index, 0}, normal.data(), static_cast<int64_t>(normal.size()));
  const GaussianSet parent = one;
  for (size_t half = 0; half < 2; ++half) {
    Eigen::Vector3d along;
    for (size_t k = 0; k < 3; ++k) {
      along[static_cast<Eigen::Index>(k)] =
          std::exp(static_cast<double>(parent.log_scales[k])) * normal[4 * half + k];
      one.log_scales[k] = parent.log_scales[k] - static_cast<float>(std::log(kSplitShrink));
    }
    const Eigen::Vector3d moved = rotation * along;
    for (size_t k = 0; k < 3; ++k)
      one.means[k] = parent.means[k] + static_cast<float>(moved[static_cast<Eigen::Index>(k)]);
    append_new(set, moments, one, 0);
  }
}

}  // namespace

void DensityOptions::visit(FieldVisitor& visitor) {
  visit_choice(
      visitor,
      {"densify",
       "whether Gaussians are added and removed during the fit: none; published, as 3DGS does; auto, so where "
       "it begins on sparse points and colours move it"},
      densify, {"none", "published", "auto"});
  visitor.integer({"most_gaussians", "no more than these, from the start on"}, most_gaussians,
                  {1, 50'000'000});
  visitor.real({"gradient", "mean gradient of a place in a picture 2 wide above which Gaussians are added"},
               gradient, {0, 1e6});
  visitor.real({"dense_scale", "Gaussians above it are split, others copied, in the scene's extent"},
               dense_scale, {0, 1e6});
  visitor.real({"faintest", "opacity below which a Gaussian is removed"}, faintest, {0, 1});
  visitor.real({"largest_scale", "scale above which one is removed after a reset, in the scene's extent"},
               largest_scale, {0, 1e6});
  visitor.integer({"first_step", "first step at which Gaussians are added"}, first_step, {1, 1'000'000'000});
  visitor.integer({"last_step", "last such step; the fit's last `every` steps have none"}, last_step,
                  {0, 1'000'000'000});
  visitor.integer({"every", "steps between two changes"}, every, {1, 1'000'000'000});
  visitor.integer({"reset_every", "steps between two resets of opacities"}, reset_every, {1, 1'000'000'000});
}

void gather(const SplatView& view, const ColourGradients& gradients, int64_t gaussians,
            DensityStatistics& statistics) {
  statistics.gradient_sums.resize(static_cast<size_t>(gaussians), 0.0F);
  statistics.seen.resize(static_cast<size_t>(gaussians), 0);
  const double half_width = 0.5 * static_cast<double>(view.camera.width),
               half_height = 0.5 * static_cast<double>(view.camera.height);
  for (int64_t i = 0; i < view.size(); ++i) {
    const auto index = static_cast<size_t>(view.splats[static_cast<size_t>(i)].index);
    const float* of_mean = gradients.of_means_in_picture.data() + 2 * i;
    statistics.gradient_sums[index] +=
        static_cast<float>(std::hypot(half_width * of_mean[0], half_height * of_mean[1]));
    ++statistics.seen[index];
  }
}

int64_t last_density_step(const DensityOptions& options, int64_t steps) {
  return std::min(options.last_step, steps - options.every);
}

DensityChange control_density(const DensityOptions& options, const DensityStep& step,
                              DensityStatistics& statistics, GaussianSet& set, SplatMoments& moments) {
  DensityChange change;
  if (options.densify != Densification::kPublished || step.step > last_density_step(options, step.steps))
    return change;
  if (step.step >= options.first_step && step.step % options.every == 0) {
    const int64_t count = set.size();
    statistics.gradient_sums.resize(static_cast<size_t>(count), 0.0F);
    statistics.seen.resize(static_cast<size_t>(count), 0);
    const auto mean_gradient = [&](int64_t i) {
      const auto at = static_cast<size_t>(i);
      return statistics.seen[at] > 0 ? statistics.gradient_sums[at] / static_cast<float>(statistics.seen[at])
                                     : 0.0F;
    };
    std::vector<int64_t> wanted;
    for (int64_t i = 0; i < count; ++i) {
      if (mean_gradient(i) >= options.gradient) wanted.push_back(i);
    }
    const auto room = static_cast<size_t>(std::max<int64_t>(0, options.most_gaussians - count));
    if (wanted.size() > room) {
      std::stable_sort(wanted.begin(), wanted.end(),
                       [&](int64_t a, int64_t b) { return mean_gradient(a) > mean_gradient(b); });
      wanted.resize(room);
      std::sort(wanted.begin(), wanted.end());
    }
    std::vector<uint8_t> keep(static_cast<size_t>(count), 1);
    const PhiloxKey key = philox_key(step.seed, "split " + std::to_string(step.step));
    for (const int64_t i : wanted) {
      if (largest_scale(set, i) > options.dense_scale * step.extent) {
        split(set, moments, i, key, static_cast<uint64_t>(i));
        keep[static_cast<size_t>(i)] = 0;
        ++change.split;
      } else {
        GaussianSet one = zero_gaussians_like(set, 0);
        append_gaussian(one, set, i);
        append_new(set, moments, one, 0);
        ++change.copied;
      }
    }
    keep.resize(static_cast<size_t>(set.size()), 1);
    const bool prune_large = step.step > options.reset_every;
    for (int64_t i = 0; i < set.size(); ++i) {
      auto& kept = keep[static_cast<size_t>(i)];
      if (kept == 0) continue;
      const bool faint = opacity_of(set.logit_opacities[static_cast<size_t>(i)]) < options.faintest;
      const bool large = prune_large && largest_scale(set, i) > options.largest_scale * step.extent;
      if (!faint && !large) continue;
      kept = 0;
      ++change.removed;
    }
    set = kept_gaussians(set, keep);
    moments.first = kept_gaussians(moments.first, keep);
    moments.second = kept_gaussians(moments.second, keep);
    statistics = {};
  }
  if (step.step % options.reset_every == 0 && step.step + options.reset_every <= step.steps) {
    const auto highest = static_cast<float>(std::log(kResetOpacity / (1 - kResetOpacity)));
    for (float& logit : set.logit_opacities) logit = std::min(logit, highest);
    std::fill(moments.first.logit_opacities.begin(), moments.first.logit_opacities.end(), 0.0F);
    std::fill(moments.second.logit_opacities.begin(), moments.second.logit_opacities.end(), 0.0F);
    change.reset = true;
  }
  return change;
}

}  // namespace gld
