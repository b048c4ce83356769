#include "bench/splatting/splat_speed.h"

#include "bench/splatting/dense_rendering.h"
#include "datasets/splats/scene_fit.h"
#include "gld/base/interrupt.h"
#include "gld/machine/timing.h"
#include "gld/splatting/naive_splatting.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <random>

#include <fmt/format.h>

namespace gld {
namespace {

struct Started {
  SplatFitViews views;
  SplatFitOptions options;
  SplatFit fit;
};

Started start(const Scene& scene, int64_t side, int64_t gaussians, const KernelSettings& settings) {
  Started result;
  result.views = load_fit_views(scene, fit_size(scene, side), 0, settings);
  result.options.density.most_gaussians = gaussians;
  result.fit =
      begin_splat_fit(result.views.pictures, scene.points_in_world, result.options, scene.name, settings);
  return result;
}

SplatCamera fullest_camera(const Started& started, const KernelSettings& settings) {
  SplatCamera best;
  int64_t most = -1;
  for (const FittedView& view : started.views.fitted) {
    const SplatCamera camera = splat_camera(view.camera, started.fit.set.origin, started.options.projection);
    const int64_t seen = view_of_splats(started.fit.set, camera, settings).size();
    if (seen <= most) continue;
    most = seen;
    best = camera;
  }
  return best;
}

std::vector<float> random_numbers(size_t count, unsigned seed) {
  std::mt19937 engine(seed);
  std::uniform_real_distribution<float> uniform(-1, 1);
  std::vector<float> values(count);
  for (float& value : values) value = uniform(engine);
  return values;
}

SplatImage random_picture(int64_t channels, int64_t side, unsigned seed) {
  SplatImage picture(channels, side, side);
  const auto values = random_numbers(static_cast<size_t>(channels * side * side), seed);
  for (int64_t row = 0; row < channels * side; ++row)
    std::copy_n(values.data() + row * side, side, picture.row(row / side, row % side));
  return picture;
}

torch::Tensor tensor_of(const SplatImage& picture) {
  return torch::tensor(picture.values, torch::kFloat32)
      .reshape({picture.channels, picture.height, picture.stride})
      .slice(2, 0, picture.width)
      .contiguous();
}

double relative_error(const torch::Tensor& found, const torch::Tensor& expected) {
  return ((found.to(torch::kFloat64) - expected).norm() / expected.norm()).item<double>();
}

struct Naive {
  torch::Tensor picture, of_features;
};
Naive naive(const GaussianSet& set, const SplatView& view, const SplatFeatures& features,
            const SplatImage& of_image) {
  NaiveScene scene;
  scene.channels = features.channels;
  scene.width = view.camera.width;
  scene.height = view.camera.height;
  for (const VisibleSplat& splat : view.splats) {
    ProjectedGaussian projected;
    project_gaussian(gaussian_shape(set, splat.index), view.camera, projected);
    scene.splats.push_back(naive_splat(projected));
    // A wall across the view has many Gaussians of one float depth: equal ones stay in the order of the view.
    scene.splats.back().depth = splat.depth;
    const float* from = features.values + splat.index * features.channels;
    scene.features.insert(scene.features.end(), from, from + features.channels);
  }
  const torch::Tensor gradient = tensor_of(of_image).to(torch::kFloat64);
  const std::vector<double> seeds(gradient.data_ptr<double>(),
                                  gradient.data_ptr<double>() + gradient.numel());
  return {torch::tensor(render_naively(scene).values, torch::kFloat64)
              .reshape({scene.channels, scene.height, scene.width}),
          torch::tensor(render_naively_backward(scene, seeds).features, torch::kFloat64)
              .reshape({view.size(), scene.channels})};
}

class Measurement {
 public:
  Measurement(const SplatSpeedSettings& settings, int64_t side, int64_t channels, int64_t seen)
      : settings_(settings), side_(side), channels_(channels), seen_(seen) {}

  // The first call warms up memory and clock.
  SplatSpeedRow row(const std::string& pass, const std::function<void()>& action) const {
    std::vector<double> milliseconds;
    for (int64_t repeat = -1; repeat < settings_.repeats; ++repeat) {
      const double seconds = seconds_of(action);
      stop_if_interrupted(fmt::format("{} at {} x {}", pass, side_, side_));
      if (repeat >= 0) milliseconds.push_back(1e3 * seconds);
    }
    SplatSpeedRow row;
    row.pass = pass;
    row.side = side_;
    row.channels = channels_;
    row.seen = seen_;
    row.threads = settings_.threads;
    const Spread spread = spread_of(milliseconds);
    row.milliseconds = spread.median;
    row.milliseconds_low = spread.low;
    row.milliseconds_high = spread.high;
    return row;
  }

 private:
  const SplatSpeedSettings& settings_;
  int64_t side_, channels_, seen_;
};

struct DenseSeconds {
  std::vector<double> forward, backward;
  DenseRendering last;
};
DenseSeconds measure_dense(const DenseSplats& splats, const torch::Tensor& of_picture, int64_t repeats) {
  DenseSeconds seconds;
  for (int64_t repeat = 0; repeat < repeats; ++repeat) {
    seconds.forward.push_back(render_densely(splats, {}).forward_seconds);
    seconds.last = render_densely(splats, of_picture);
    seconds.backward.push_back(seconds.last.backward_seconds);
    stop_if_interrupted("the dense rendering");
  }
  return seconds;
}

void give_dense(SplatSpeedRow& row, double seconds) {
  row.dense_milliseconds = 1e3 * seconds;
  row.times = row.dense_milliseconds / row.milliseconds;
}

void add_channel_rows(const Started& started, const SplatSpeedSettings& settings, int64_t channels,
                      const KernelSettings& kernels, std::vector<SplatSpeedRow>& rows) {
  const GaussianSet& set = started.fit.set;
  const SplatCamera camera = fullest_camera(started, kernels);
  const std::vector<float> values = random_numbers(static_cast<size_t>(set.size() * channels), 1);
  SplatFeatures features;
  features.values = values.data();
  features.channels = channels;
  features.by_index = true;
  const SplatImage of_image = random_picture(channels, settings.side, 2);
  SplatView view;
  CompositedView picture;
  CompositingGradients gradients;
  view = view_of_splats(set, camera, kernels);
  const Measurement measure(settings, settings.side, channels, view.size());
  const SplatSpeedRow lists = measure.row("lists", [&] { view = view_of_splats(set, camera, kernels); });
  SplatSpeedRow forward = measure.row("forward", [&] {
    view = view_of_splats(set, camera, kernels);
    picture = composite(view, features, kernels);
  });
  SplatSpeedRow backward = measure.row("backward", [&] {
    gradients = composite_backward(view, features, of_image, SplatGradients::kFeaturesAndShapes, kernels);
  });
  const SplatSpeedRow of_features = measure.row("backward_features", [&] {
    composite_backward(view, features, of_image, SplatGradients::kFeatures, kernels);
  });
  const DenseSeconds dense =
      measure_dense(dense_splats(set, view, features), tensor_of(of_image), settings.dense_repeats);
  give_dense(forward, spread_of(dense.forward).median);
  give_dense(backward, spread_of(dense.backward).median);
  const Naive exact = naive(set, view, features, of_image);
  forward.error = relative_error(tensor_of(picture.image), exact.picture);
  forward.dense_error = relative_error(dense.last.picture, exact.picture);
  backward.error = relative_error(
      torch::tensor(gradients.features, torch::kFloat32).reshape({view.size(), channels}), exact.of_features);
  backward.dense_error = relative_error(dense.last.of_features, exact.of_features);
  rows.insert(rows.end(), {lists, forward, backward, of_features});
}

void add_step_row(const Scene& scene, const SplatSpeedSettings& settings, const KernelSettings& kernels,
                  std::vector<SplatSpeedRow>& rows) {
  Started started = start(scene, settings.picture_side, settings.gaussians, kernels);
  started.options.degree = 0;
  const SplatCamera camera = fullest_camera(started, kernels);
  const SplatView view = view_of_splats(started.fit.set, camera, kernels);
  const std::vector<float> colours = view_colours(started.fit.set, view, kernels);
  SplatFeatures features;
  features.values = colours.data();
  features.channels = 3;
  const DenseSeconds dense =
      measure_dense(dense_splats(started.fit.set, view, features),
                    tensor_of(random_picture(3, settings.picture_side, 3)), settings.dense_repeats);
  SplatSpeedRow row = Measurement(settings, settings.picture_side, 3, view.size()).row("step", [&] {
    splat_fit_step(started.views.fitted, started.options, 0, kernels, started.fit);
  });
  give_dense(row, spread_of(dense.forward).median + spread_of(dense.backward).median);
  rows.push_back(row);
}

}  // namespace

std::vector<SplatSpeedRow> splat_speed_rows(const Scene& scene, const SplatSpeedSettings& settings) {
  KernelSettings kernels;
  kernels.threads = settings.threads;
  std::vector<SplatSpeedRow> rows;
  // As many Gaussians as asked for need pictures with more pixels than those that are drawn.
  Started started = start(scene, settings.picture_side, settings.gaussians, kernels);
  started.views = load_fit_views(scene, fit_size(scene, settings.side), 0, kernels);
  for (const int64_t channels : settings.channels)
    add_channel_rows(started, settings, channels, kernels, rows);
  add_step_row(scene, settings, kernels, rows);
  return rows;
}

Table splat_speed_table(const std::vector<SplatSpeedRow>& rows) {
  Table table({"pass", "side", "channels", "seen", "threads", "milliseconds", "milliseconds_low",
               "milliseconds_high", "dense_milliseconds", "times", "error", "dense_error"});
  const auto or_nothing = [](double value) {
    return value > 0 ? TableCell(value) : TableCell(std::string());
  };
  for (const SplatSpeedRow& row : rows) {
    table.add_row({row.pass, row.side, row.channels, row.seen, row.threads, row.milliseconds,
                   row.milliseconds_low, row.milliseconds_high, or_nothing(row.dense_milliseconds),
                   or_nothing(row.times), or_nothing(row.error), or_nothing(row.dense_error)});
  }
  return table;
}

}  // namespace gld
