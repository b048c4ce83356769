#include "datasets/splats/splat_fit.h"

#include "datasets/splats/matched_start.h"
#include "gld/base/error.h"
#include "gld/base/philox.h"
#include "gld/splatting/feature_solve.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace gld {
namespace {

// Returns the view of a step counted from 0.
size_t view_of_step(int64_t step, size_t views, uint64_t seed) {
  const auto round = static_cast<uint64_t>(step) / views;
  const PhiloxKey key = philox_key(seed, "splat views");
  std::vector<size_t> order(views);
  std::iota(order.begin(), order.end(), size_t{0});
  for (size_t left = views; left > 1; --left) {
    const auto random = philox4x32(
        {static_cast<uint32_t>(round), static_cast<uint32_t>(round >> 32), static_cast<uint32_t>(left), 0},
        key);
    const uint64_t wide = static_cast<uint64_t>(random[0]) << 32 | random[1];
    std::swap(order[left - 1], order[wide % left]);
  }
  return order[static_cast<size_t>(step) % views];
}

// Sets the same coefficients and zeros for those of higher degrees.
void raise_degree(GaussianSet& set, int64_t degree) {
  const auto before = static_cast<size_t>(set.harmonics_each());
  set.degree = degree;
  const auto after = static_cast<size_t>(set.harmonics_each());
  std::vector<float> harmonics(static_cast<size_t>(set.size()) * after, 0.0F);
  for (size_t i = 0; i < static_cast<size_t>(set.size()); ++i)
    std::copy_n(set.harmonics.data() + i * before, before, harmonics.data() + i * after);
  set.harmonics = std::move(harmonics);
}

}  // namespace

SplatFitOptions::SplatFitOptions() { projection.near = 0; }

void SplatFitOptions::visit(FieldVisitor& visitor) {
  visitor.integer({"steps", "steps of Adam, one view each"}, steps, {0, 1'000'000'000});
  visitor.integer({"degree", "degree of the colours' spherical harmonics at last"}, degree,
                  {0, kMostHarmonicDegree});
  visitor.integer({"degree_every", "steps after which one more degree is fitted"}, degree_every,
                  {1, 1'000'000'000});
  visitor.real({"dissimilarity", "weight of 1 - SSIM; that of the absolute difference is the rest"},
               dissimilarity, {0, 1});
  visit_choice(
      visitor,
      {"geometry_from",
       "what moves Gaussians and their shapes: rgb, the colours; latent, the latents of --features; both; "
       "fixed, nothing: they stay where depth puts them"},
      geometry_from, {"rgb", "latent", "both", "fixed"});
  visitor.group({"projection", "how Gaussians are drawn"}, projection);
  visit_choice(
      visitor,
      {"held_alpha_gradient",
       "what reaches a Gaussian where its alpha is held at 0.99: none, or published, as if it were not"},
      held_alpha_gradient, {"none", "published"});
  visitor.group({"start", "where the fit begins"}, start);
  visitor.group({"rates", "Adam's learning rates"}, rates);
  visitor.group({"density", "how many Gaussians there are"}, density);
}

void SplatFitOptions::check() const {
  if (rates.last_mean > rates.mean) {
    fail({"--rates.last-mean", "at most --rates.mean", std::to_string(rates.last_mean), "make it smaller"});
  }
  if (!moved_by_colours(geometry_from) && density.densify == Densification::kPublished) {
    fail({"--densify", "none where colours do not move the geometry, by whose gradient Gaussians are added",
          "published", "leave it out, or add --geometry-from both"});
  }
}

void check_without_latents(const SplatFitOptions& options) {
  if (!moved_by_latents(options.geometry_from)) return;
  fail({"--geometry-from", "rgb or fixed where no latents are fitted",
        options.geometry_from == SplatGeometryFrom::kBoth ? "both" : "latent",
        "name levels of a latent space (gld splat fit --features), or leave it out"});
}

SplatFit begin_splat_fit(const std::vector<SplatPicture>& pictures,
                         const std::vector<Eigen::Vector3d>& points_in_world, SplatFitOptions& options,
                         const std::string& where, const KernelSettings& settings) {
  SplatStartOptions start = options.start;
  start.from = start_of(pictures, points_in_world, start.from, where);
  const bool matches = start.from == SplatStartFrom::kMatch;
  const std::vector<SplatPicture> matched =
      matches ? with_matched_depth(pictures, points_in_world, settings) : std::vector<SplatPicture>();
  const std::vector<SplatPicture>& begun_on = matches ? matched : pictures;
  const SceneReach reach = scene_reach(begun_on, points_in_world);
  SplatFit fit;
  fit.extent = reach.extent;
  fit.start = start.from;
  fit.set = start_gaussians(begun_on, points_in_world, reach, options.density.most_gaussians, start, where);
  fit.moments = splat_moments(fit.set);
  settle_fit_options(fit, options);
  return fit;
}

void settle_fit_options(const SplatFit& fit, SplatFitOptions& options) {
  if (options.projection.near == 0) options.projection.near = kNearShare * fit.extent;
  options.density.densify = settled_densification(options, fit.start);
}

Densification settled_densification(const SplatFitOptions& options, SplatStartFrom start) {
  if (options.density.densify != Densification::kAuto) return options.density.densify;
  const bool grows = start == SplatStartFrom::kPoints && moved_by_colours(options.geometry_from);
  return grows ? Densification::kPublished : Densification::kNone;
}

void begin_features(const std::vector<FittedView>& views, const SplatFitOptions& options,
                    const KernelSettings& settings, SplatFit& fit) {
  if (!moved_by_latents(options.geometry_from)) return;
  std::vector<FeatureView> seen;
  seen.reserve(views.size());
  for (const FittedView& view : views) {
    seen.push_back(
        {view_of_splats(fit.set, splat_camera(view.latent.camera, fit.set.origin, options.projection),
                        settings),
         view.latent.picture});
  }
  fit.set.channels = views.front().latent.picture.channels;
  fit.set.features = solve_features(seen, fit.set, {}, settings).features;
  fit.moments = splat_moments(fit.set);
}

namespace {

// Returns a camera whose picture is composited backward.
SplatCamera fitted_camera(const Camera& camera, const Eigen::Vector3d& origin,
                          const SplatFitOptions& options) {
  SplatCamera fitted = splat_camera(camera, origin, options.projection);
  fitted.held_alpha_gradient = options.held_alpha_gradient;
  return fitted;
}

// Returns the mean absolute difference of a view's latent, whose gradients are added to of_set.
double add_latent_gradients(const GaussianSet& set, const LatentView& latent, const SplatFitOptions& options,
                            const KernelSettings& settings, GaussianSet& of_set) {
  const SplatView view = view_of_splats(set, fitted_camera(latent.camera, set.origin, options), settings);
  const SplatImage shown = render_features(set, view, settings).image;
  SplatImage gradient(shown.channels, shown.width, shown.height);
  const auto numbers = static_cast<double>(shown.channels * shown.width * shown.height);
  const auto share = static_cast<float>(1 / numbers);
  double sum = 0;
  for (int64_t c = 0; c < shown.channels; ++c) {
    for (int64_t y = 0; y < shown.height; ++y) {
      const float *a = shown.row(c, y), *b = latent.picture.row(c, y);
      float* const to = gradient.row(c, y);
      for (int64_t x = 0; x < shown.width; ++x) {
        sum += std::abs(a[x] - b[x]);
        to[x] = share * (static_cast<float>(a[x] > b[x]) - static_cast<float>(a[x] < b[x]));
      }
    }
  }
  render_features_backward(set, view, gradient, settings, of_set);
  return sum / numbers;
}

}  // namespace

SplatFitStep splat_fit_step(const std::vector<FittedView>& views, const SplatFitOptions& options,
                            uint64_t seed, const KernelSettings& settings, SplatFit& fit) {
  const int64_t degree = std::min(options.degree, fit.step / options.degree_every);
  if (fit.set.degree < degree) {
    for (GaussianSet* set : {&fit.set, &fit.moments.first, &fit.moments.second}) raise_degree(*set, degree);
  }
  const FittedView& shown = views[view_of_step(fit.step, views.size(), seed)];
  ++fit.step;
  const SplatView view =
      view_of_splats(fit.set, fitted_camera(shown.camera, fit.set.origin, options), settings);
  const std::vector<float> colours = view_colours(fit.set, view, settings);
  SplatFeatures features;
  features.values = colours.data();
  features.channels = 3;
  TileLists lists;
  const ImageLoss loss = image_loss(composite(view, features, settings, &lists).image, shown.target,
                                    options.dissimilarity, settings);
  ColourGradients gradients;
  render_colours_backward(fit.set, view, colours, loss.gradient,
                          moved_by_colours(options.geometry_from) ? SplatGradients::kFeaturesAndShapes
                                                                  : SplatGradients::kFeatures,
                          settings, gradients, &lists);
  SplatFitStep result;
  result.loss = loss.loss;
  if (moved_by_latents(options.geometry_from)) {
    result.latent = add_latent_gradients(fit.set, shown.latent, options, settings, gradients.of_set);
    result.loss += result.latent;
  }
  if (options.density.densify == Densification::kPublished)
    gather(view, gradients, fit.set.size(), fit.statistics);
  const double progress =
      static_cast<double>(fit.step) / static_cast<double>(std::max<int64_t>(1, options.steps));
  adam_step(options.rates, {progress, fit.extent}, gradients.of_set, fit.moments, fit.set, settings);
  result.step = fit.step;
  result.absolute = loss.absolute;
  result.similarity = loss.similarity;
  result.seen = view.size();
  result.change = control_density(options.density, {fit.step, options.steps, fit.extent, seed},
                                  fit.statistics, fit.set, fit.moments);
  result.gaussians = fit.set.size();
  return result;
}

}  // namespace gld
