#include "bench/splatting/splat_benchmark.h"

#include "bench/support/benchmark_report.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/machine/instruction_set.h"
#include "gld/report/plot.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"

#include <algorithm>

#include <fmt/format.h>

namespace gld {
namespace {

template <class Row>
PlotSeries& series_of(PlotPanel& panel, const Row& name) {
  const auto found = std::find_if(panel.series.begin(), panel.series.end(),
                                  [&](const PlotSeries& series) { return series.name == name; });
  return found != panel.series.end()
             ? *found
             : *panel.series.insert(panel.series.end(), {name, SeriesStyle::kLine, {}});
}

Figure error_figure(const std::vector<SplatFitRow>& fits, const std::vector<SplatFeatureRow>& features) {
  Figure figure;
  figure.title = "Splats: error against time";
  PlotPanel colours, latents;
  colours.title = "colours, held-out views";
  colours.x = {"seconds", AxisScale::kLog};
  colours.y = {"PSNR [dB]", AxisScale::kLinear};
  for (const SplatFitRow& row : fits)
    series_of(colours, fmt::format("{} Gaussians", row.gaussians))
        .points.emplace_back(row.seconds, row.held_out_psnr);
  latents.title = "features, fixed geometry";
  latents.x = {"seconds", AxisScale::kLog};
  latents.y = {"distance from the optimum", AxisScale::kLog};
  for (const SplatFeatureRow& row : features)
    series_of(latents, row.method).points.emplace_back(row.seconds, row.error);
  figure.panels = {colours, latents};
  return figure;
}

}  // namespace

void SplatBenchmarkOptions::visit(FieldVisitor& visitor) {
  visit_out(visitor, out, overwrite);
  visitor.integer({"room", "number of the generated room"}, room, {0, 1'000'000'000});
  visitor.integer({"views", "its views"}, views, {2, 1000});
  visitor.integer({"gaussians", "Gaussians at most where speed is measured"}, speed.gaussians,
                  {1, 10'000'000});
  visitor.integers({"channels", "numbers of channels"}, speed.channels, {1, 4096});
  visitor.integer({"side", "pixels a side of pictures with channels"}, speed.side, {1, 4096});
  visitor.integer({"picture_side", "pixels a side of the pictures that a step in colours fits"},
                  speed.picture_side, {16, 4096});
  visitor.integer({"repeats", "measurements of each, of which the median counts"}, speed.repeats, {1, 1000});
  visitor.integer({"dense_repeats", "measurements of LibTorch's dense rendering"}, speed.dense_repeats,
                  {1, 1000});
  visitor.integers({"fit_gaussians", "Gaussians at most of the fits whose errors are measured"},
                   errors.gaussians, {1, 10'000'000});
  visitor.integers({"fit_steps", "steps after which a fit in colours is measured, rising"}, errors.steps,
                   {1, 1'000'000});
  visitor.integer({"fit_side", "pixels a side of the pictures that are fitted"}, errors.side, {16, 4096});
  visitor.integer({"held_out", "views that are compared with"}, errors.held_out, {1, 1000});
  visitor.reals({"least_alphas", "alpha from which a Gaussian reaches a pixel, in turn"}, errors.least_alphas,
                {1e-9, 0.5});
  visitor.reals({"least_transmittances", "what has to be left behind a Gaussian that is drawn, in turn"},
                errors.least_transmittances, {1e-9, 0.5});
  visitor.integer({"feature_side", "pixels a side of the pictures of features"}, errors.feature_side,
                  {16, 4096});
  visitor.integer({"feature_channels", "their channels"}, errors.channels, {1, 4096});
  visitor.integers({"iterations", "of conjugate gradients, rising"}, errors.iterations, {1, 10000});
  visitor.real({"ridge", "of the features' least squares, in each Gaussian's weight"}, errors.ridge, {0, 1});
  visitor.integers({"adam_steps", "of Adam on the same features"}, errors.adam_steps, {1, 1'000'000});
  visitor.reals({"adam_rates", "its rates at first, of which the last step has a hundredth"},
                errors.adam_rates, {1e-6, 100});
  visit_threads(visitor, threads);
}

void SplatBenchmarkOptions::check() const {
  check_out(out, "runs/bench");
  const auto rising = [](const char* name, const std::vector<int64_t>& values) {
    if (!values.empty() && std::is_sorted(values.begin(), values.end())) return;
    fail({name, "rising numbers", values.empty() ? "none" : "others", "sort them"});
  };
  rising("--fit-steps", errors.steps);
  rising("--iterations", errors.iterations);
  rising("--fit-gaussians", errors.gaussians);
  if (errors.held_out >= views) {
    fail({"--held-out", fmt::format("less than the room's {} views", views), std::to_string(errors.held_out),
          "keep fewer of them apart"});
  }
}

int run_splat_benchmark(const SplatBenchmarkOptions& options) {
  options.check();
  RunFolder folder(options.out, "bench splat", options, earlier_run(options.overwrite));
  SplatSpeedSettings speed = options.speed;
  SplatErrorSettings errors = options.errors;
  speed.threads = errors.threads = use_threads(options.threads);
  SyntheticOptions rooms;
  rooms.frames = options.views;
  rooms.width = rooms.height = std::max(speed.picture_side, errors.side);
  const Scene scene = make_synthetic_scene(rooms, options.room);
  const auto speeds = splat_speed_rows(scene, speed);
  const auto fits = splat_fit_rows(scene, errors);
  errors.repeats = speed.repeats;
  const auto bounds = splat_bound_rows(scene, errors);
  const auto features = splat_feature_rows(scene, errors);
  const std::string text = fmt::format(
      "# Splats\n"
      "\n"
      "A drawn room of {} views; {} vectors, {} threads. Milliseconds are medians of {}; beside them, in the same run, a "
      "dense rendering by LibTorch's operations, every pixel against every Gaussian, which is given projected and sorted "
      "Gaussians (median of {}). Errors are against double precision.\n"
      "\n"
      "{}\n"
      "## Colours: what a fit reaches\n"
      "\n"
      "{} x {} pixels, {} views held out.\n"
      "\n"
      "{}\n"
      "## Bounds of what is drawn\n"
      "\n"
      "The last of these fits. error: root mean square of what differs from the picture without bounds, of a picture "
      "from 0 to 1; milliseconds a picture of {} x {}.\n"
      "\n"
      "{}\n"
      "## Features, geometry fixed\n"
      "\n"
      "{} channels, {} x {} pixels, {} views; errors are distances from the optimum, relative to the pictures.\n"
      "\n"
      "{}",
      options.views, instruction_set_name(best_instruction_set()), speed.threads, speed.repeats,
      speed.dense_repeats, splat_speed_table(speeds).markdown(), errors.side, errors.side, errors.held_out,
      splat_fit_table(fits).markdown(), errors.side, errors.side, splat_bound_table(bounds).markdown(),
      errors.channels, errors.feature_side, errors.feature_side, options.views,
      splat_feature_table(features).markdown());
  BenchmarkResults results;
  results.text = text;
  results.files = {{"splat_speed.csv", splat_speed_table(speeds).csv()},
                   {"splat_fits.csv", splat_fit_table(fits).csv()},
                   {"splat_bounds.csv", splat_bound_table(bounds).csv()},
                   {"splat_features.csv", splat_feature_table(features).csv()},
                   {"splat.md", text}};
  results.figures = {{"splat", error_figure(fits, features)}};
  results.report = {{"command", "bench splat"}, {"options", to_json(options)}};
  results.notes = {{"speed", "splat_speed.csv"},   {"fits in colours", "splat_fits.csv"},
                   {"bounds", "splat_bounds.csv"}, {"features", "splat_features.csv"},
                   {"tables", "splat.md"},         {"plot", "splat.png"}};
  return finish_measured_benchmark(folder, results);
}

}  // namespace gld
