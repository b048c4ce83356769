#include "bench/splatting/splat_errors.h"

#include "datasets/splats/scene_fit.h"
#include "datasets/splats/splat_picture.h"
#include "gld/base/interrupt.h"
#include "gld/kernels/adam_kernel.h"
#include "gld/machine/timing.h"
#include "gld/splatting/feature_solve.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>

#include <Eigen/LU>
#include <fmt/format.h>

namespace gld {
namespace {

// Far beyond what any of the compared fits reaches.
constexpr double kSolved = 1e-7;
constexpr int64_t kMostIterations = 400;

double mean_of(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

// The picture is the sin of a direction of the world's, one a channel: what a latent that is the same from everywhere
// looks like.
SplatImage picture_of_places(const SplatPicture& picture, int64_t channels, double extent) {
  std::mt19937 engine(7);
  std::normal_distribution<double> normal;
  SplatImage image(channels, picture.camera.width, picture.camera.height);
  const Eigen::Matrix3d rays = picture.camera.intrinsics.inverse();
  for (int64_t c = 0; c < channels; ++c) {
    // One after the other: the order in which a call's arguments are drawn is the compiler's own.
    Eigen::Vector3d wave;
    for (const int axis : {2, 1, 0}) wave[axis] = normal(engine) * 6 / extent;
    const double phase = normal(engine);
    for (int64_t y = 0; y < image.height; ++y) {
      for (int64_t x = 0; x < image.width; ++x) {
        const double depth = picture.depth.at(x, y);
        const Eigen::Vector3d place =
            picture.camera.world_from_camera *
            (rays * Eigen::Vector3d(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5, 1) * depth);
        image.row(c, y)[x] = static_cast<float>(std::sin(wave.dot(place) + phase));
      }
    }
  }
  return image;
}

struct FeatureProblem {
  GaussianSet set;
  std::vector<FeatureView> views;
  int64_t channels = 0;

  SplatFeatures features(const std::vector<float>& values) const {
    SplatFeatures result;
    result.values = values.data();
    result.channels = channels;
    result.by_index = true;
    return result;
  }
};

FeatureProblem feature_problem(const Scene& scene, const SplatErrorSettings& settings, int64_t gaussians,
                               const KernelSettings& kernels) {
  const SplatFitViews views = load_fit_views(scene, fit_size(scene, settings.feature_side), 0, kernels);
  const SceneReach reach = scene_reach(views.pictures, scene.points_in_world);
  SplatStartOptions start;
  start.from = SplatStartFrom::kDepth;
  const GaussianSet set =
      start_gaussians(views.pictures, scene.points_in_world, reach, gaussians, start, scene.name);
  ProjectionOptions projection;
  projection.near = kNearShare * reach.extent;
  FeatureProblem problem;
  problem.set = set;
  problem.channels = settings.channels;
  for (const SplatPicture& picture : views.pictures) {
    problem.views.push_back(
        {view_of_splats(set, splat_camera(picture.camera, set.origin, projection), kernels),
         picture_of_places(picture, settings.channels, reach.extent)});
  }
  return problem;
}

std::vector<SplatImage> pictures_of(const FeatureProblem& problem, const std::vector<float>& values,
                                    const KernelSettings& kernels) {
  std::vector<SplatImage> pictures;
  for (const FeatureView& view : problem.views)
    pictures.push_back(composite(view.view, problem.features(values), kernels).image);
  return pictures;
}

double error_of(const FeatureProblem& problem, const std::vector<float>& values,
                const std::vector<SplatImage>& expected, const KernelSettings& kernels) {
  const std::vector<SplatImage> found = pictures_of(problem, values, kernels);
  double difference = 0, size = 0;
  for (size_t v = 0; v < found.size(); ++v) {
    for (size_t i = 0; i < found[v].values.size(); ++i) {
      const double apart = static_cast<double>(found[v].values[i]) - expected[v].values[i];
      const double picture = problem.views[v].picture.values[i];
      difference += apart * apart;
      size += picture * picture;
    }
  }
  return std::sqrt(difference / size);
}

// It runs Adam on features alone from where conjugate gradients begin, one view a step, with the rate falling to a
// hundredth. It knows of no ridge: with many steps it ends elsewhere.
std::vector<float> fit_by_adam(const FeatureProblem& problem, int64_t steps, double rate,
                               const KernelSettings& kernels) {
  constexpr double kFirst = 0.9, kSecond = 0.999;
  FeatureSolveOptions start;
  start.most_iterations = 0;
  std::vector<float> values = solve_features(problem.views, problem.set, start, kernels).features;
  std::vector<float> gradients(values.size()), first(values.size(), 0.0F), second(values.size(), 0.0F);
  for (int64_t step = 0; step < steps; ++step) {
    const FeatureView& view = problem.views[static_cast<size_t>(step) % problem.views.size()];
    const SplatFeatures features = problem.features(values);
    SplatImage residual = composite(view.view, features, kernels).image;
    for (size_t i = 0; i < residual.values.size(); ++i) residual.values[i] -= view.picture.values[i];
    const CompositingGradients found =
        composite_backward(view.view, features, residual, SplatGradients::kFeatures, kernels);
    std::fill(gradients.begin(), gradients.end(), 0.0F);
    for (int64_t i = 0; i < view.view.size(); ++i) {
      std::copy_n(found.features.data() + i * problem.channels, problem.channels,
                  gradients.data() + view.view.splats[static_cast<size_t>(i)].index * problem.channels);
    }
    const double progress = static_cast<double>(step) / static_cast<double>(steps);
    AdamStep adam;
    adam.first_beta = static_cast<float>(kFirst);
    adam.second_beta = static_cast<float>(kSecond);
    adam.step_size = static_cast<float>(rate * std::pow(0.01, progress) /
                                        (1 - std::pow(kFirst, static_cast<double>(step + 1))));
    adam.inverse_correction =
        static_cast<float>(1 / std::sqrt(1 - std::pow(kSecond, static_cast<double>(step + 1))));
    adam.epsilon = 1e-15F;
    const AdamArrays arrays{values.data(), gradients.data(), first.data(), second.data(), nullptr};
    constexpr int64_t kPart = 1 << 14;
    const auto count = static_cast<int64_t>(values.size());
#pragma omp parallel for num_threads(kernels.threads) schedule(static)
    for (int64_t begin = 0; begin < count; begin += kPart)
      adam_update(arrays, adam, begin, std::min(begin + kPart, count));
  }
  return values;
}

KernelSettings kernels_of(const SplatErrorSettings& settings) {
  KernelSettings kernels;
  kernels.threads = settings.threads;
  return kernels;
}

SplatFitViews views_of(const Scene& scene, const SplatErrorSettings& settings) {
  return load_fit_views(scene, fit_size(scene, settings.side), settings.held_out, kernels_of(settings));
}

// A fit in colours before its first step, with at most so many Gaussians.
struct BegunFit {
  SplatFitOptions options;
  SplatFit fit;
};
BegunFit begun_fit(const Scene& scene, const SplatFitViews& views, int64_t most_gaussians,
                   const SplatErrorSettings& settings) {
  BegunFit begun;
  begun.options.density.most_gaussians = most_gaussians;
  begun.options.steps = settings.steps.back();
  begun.fit =
      begin_splat_fit(views.pictures, scene.points_in_world, begun.options, scene.name, kernels_of(settings));
  return begun;
}

}  // namespace

std::vector<SplatFitRow> splat_fit_rows(const Scene& scene, const SplatErrorSettings& settings) {
  const KernelSettings kernels = kernels_of(settings);
  const SplatFitViews views = views_of(scene, settings);
  std::vector<SplatFitRow> rows;
  for (const int64_t most : settings.gaussians) {
    BegunFit begun = begun_fit(scene, views, most, settings);
    const SplatFitOptions& options = begun.options;
    SplatFit& fit = begun.fit;
    double seconds = 0;
    for (const int64_t steps : settings.steps) {
      seconds += seconds_of([&] {
        while (fit.step < steps) splat_fit_step(views.fitted, options, 0, kernels, fit);
      });
      stop_if_interrupted(fmt::format("{} rows", rows.size()));
      rows.push_back({fit.set.size(), steps, seconds,
                      mean_of(view_decibels(views.fitted, fit.set, options.projection, kernels)),
                      mean_of(view_decibels(views.held_out, fit.set, options.projection, kernels))});
    }
  }
  return rows;
}

Table splat_fit_table(const std::vector<SplatFitRow>& rows) {
  Table table({"gaussians", "steps", "seconds", "fitted_psnr", "held_out_psnr"});
  for (const SplatFitRow& row : rows)
    table.add_row({row.gaussians, row.steps, row.seconds, row.fitted_psnr, row.held_out_psnr});
  return table;
}

namespace {

// Neither bound is met by a number that a picture shows.
constexpr double kNoBound = 1e-9;

std::vector<SplatImage> drawn(const SplatFit& fit, const std::vector<FittedView>& views,
                              const ProjectionOptions& projection, const KernelSettings& kernels) {
  std::vector<SplatImage> pictures;
  pictures.reserve(views.size());
  for (const FittedView& view : views)
    pictures.push_back(splat_picture(fit.set, view.camera, projection, kernels).image);
  return pictures;
}

double difference_of(const std::vector<SplatImage>& a, const std::vector<SplatImage>& b) {
  double squares = 0, numbers = 0;
  for (size_t view = 0; view < a.size(); ++view) {
    for (size_t i = 0; i < a[view].values.size(); ++i)
      squares += std::pow(static_cast<double>(a[view].values[i]) - b[view].values[i], 2);
    numbers += static_cast<double>(a[view].channels * a[view].width * a[view].height);
  }
  return std::sqrt(squares / numbers);
}

SplatBoundRow bound_row(const SplatFit& fit, const std::vector<FittedView>& views,
                        const ProjectionOptions& projection, const std::vector<SplatImage>& unbounded,
                        int64_t repeats, const KernelSettings& kernels) {
  std::vector<double> seconds;
  std::vector<SplatImage> pictures;
  for (int64_t i = 0; i < repeats; ++i)
    seconds.push_back(seconds_of([&] { pictures = drawn(fit, views, projection, kernels); }));
  std::sort(seconds.begin(), seconds.end());
  SplatBoundRow row;
  row.least_alpha = projection.least_alpha;
  row.least_transmittance = projection.least_transmittance;
  row.milliseconds = 1e3 * seconds[seconds.size() / 2] / static_cast<double>(views.size());
  row.error = difference_of(pictures, unbounded);
  row.held_out_psnr = mean_of(view_decibels(views, fit.set, projection, kernels));
  return row;
}

}  // namespace

std::vector<SplatBoundRow> splat_bound_rows(const Scene& scene, const SplatErrorSettings& settings) {
  const KernelSettings kernels = kernels_of(settings);
  const SplatFitViews views = views_of(scene, settings);
  BegunFit begun = begun_fit(scene, views, settings.gaussians.back(), settings);
  const SplatFitOptions& options = begun.options;
  SplatFit& fit = begun.fit;
  while (fit.step < options.steps) splat_fit_step(views.fitted, options, 0, kernels, fit);
  ProjectionOptions exact = options.projection;
  exact.least_alpha = exact.least_transmittance = kNoBound;
  const std::vector<SplatImage> unbounded = drawn(fit, views.held_out, exact, kernels);
  std::vector<SplatBoundRow> rows;
  const auto add = [&](const ProjectionOptions& projection) {
    rows.push_back(bound_row(fit, views.held_out, projection, unbounded, settings.repeats, kernels));
    stop_if_interrupted(fmt::format("{} rows", rows.size()));
  };
  for (const double least_alpha : settings.least_alphas) {
    ProjectionOptions projection = options.projection;
    projection.least_alpha = least_alpha;
    add(projection);
  }
  for (const double least : settings.least_transmittances) {
    ProjectionOptions projection = options.projection;
    projection.least_transmittance = least;
    if (least != ProjectionOptions().least_transmittance) add(projection);
  }
  return rows;
}

Table splat_bound_table(const std::vector<SplatBoundRow>& rows) {
  Table table({"least_alpha", "least_transmittance", "milliseconds", "error", "held_out_psnr"});
  for (const SplatBoundRow& row : rows)
    table.add_row({row.least_alpha, row.least_transmittance, row.milliseconds, row.error, row.held_out_psnr});
  return table;
}

std::vector<SplatFeatureRow> splat_feature_rows(const Scene& scene, const SplatErrorSettings& settings) {
  const KernelSettings kernels = kernels_of(settings);
  const FeatureProblem problem = feature_problem(scene, settings, settings.gaussians.back(), kernels);
  FeatureSolveOptions solve;
  solve.ridge = settings.ridge;
  solve.tolerance = kSolved;
  solve.most_iterations = kMostIterations;
  const std::vector<SplatImage> expected =
      pictures_of(problem, solve_features(problem.views, problem.set, solve, kernels).features, kernels);
  std::vector<SplatFeatureRow> rows;
  for (const int64_t iterations : settings.iterations) {
    solve.tolerance = FeatureSolveOptions().tolerance;
    solve.most_iterations = iterations;
    SolvedFeatures solved;
    const double seconds =
        seconds_of([&] { solved = solve_features(problem.views, problem.set, solve, kernels); });
    stop_if_interrupted(fmt::format("{} rows", rows.size()));
    rows.push_back({"conjugate_gradients", problem.set.size(), solved.iterations(), seconds,
                    error_of(problem, solved.features, expected, kernels), solved.residuals.back()});
    if (solved.residuals.back() <= solve.tolerance) break;
  }
  for (const double rate : settings.adam_rates) {
    for (const int64_t steps : settings.adam_steps) {
      std::vector<float> values;
      const double seconds = seconds_of([&] { values = fit_by_adam(problem, steps, rate, kernels); });
      stop_if_interrupted(fmt::format("{} rows", rows.size()));
      rows.push_back({fmt::format("adam_{:g}", rate), problem.set.size(), steps, seconds,
                      error_of(problem, values, expected, kernels), 0});
    }
  }
  return rows;
}

Table splat_feature_table(const std::vector<SplatFeatureRow>& rows) {
  Table table({"method", "gaussians", "steps", "seconds", "error", "residual"});
  for (const SplatFeatureRow& row : rows) {
    table.add_row({row.method, row.gaussians, row.steps, row.seconds, row.error,
                   row.residual > 0 ? TableCell(row.residual) : TableCell(std::string())});
  }
  return table;
}

}  // namespace gld
