#include "bench/photogrammetry/stereo_benchmark.h"

#include "bench/support/benchmark_report.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/interrupt.h"
#include "gld/machine/timing.h"
#include "gld/photogrammetry/plane_sweep.h"
#include "gld/photogrammetry/semi_global_matching.h"
#include "gld/photogrammetry/stereo_picture.h"
#include "gld/report/benchmark_results.h"
#include "gld/report/run_folder.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <fmt/format.h>

namespace gld {
namespace {

constexpr double kWallDistance = 4;
// A thread takes so many rows at a time, as in plane_sweep_stereo.cpp.
constexpr int64_t kRowsAPart = 56;

float paint(const Eigen::Vector3d& place, double colour) {
  const double wave = std::sin(31 * place.x() + 17 * place.y() + colour) +
                      std::sin(43 * place.y() - 13 * place.x()) +
                      std::sin(7.3 * place.x() + 71 * place.y() + 2 * colour);
  return static_cast<float>(0.5 + 0.16 * wave);
}

// Returns views side by side of a painted wall, with its depth.
std::vector<PicturedView> painted_wall(int64_t count, int64_t side) {
  const Eigen::Vector3d normal = Eigen::Vector3d(0.25, -0.2, 1).normalized();
  std::vector<PicturedView> views;
  for (int64_t i = 0; i < count; ++i) {
    PicturedView view;
    view.width = view.height = view.depth.width = view.depth.height = side;
    view.camera.width = view.camera.height = side;
    const auto pixels = static_cast<double>(side);
    view.camera.intrinsics << pixels, 0, pixels / 2, 0, pixels, pixels / 2, 0, 0, 1;
    view.camera.world_from_camera.translation() =
        Eigen::Vector3d(0.3 * static_cast<double>(i), 0.1 * static_cast<double>(i % 3), 0);
    const Eigen::Matrix3d rays = view.camera.intrinsics.inverse();
    const Eigen::Vector3d centre = view.camera.world_from_camera.translation();
    for (int64_t y = 0; y < side; ++y) {
      for (int64_t x = 0; x < side; ++x) {
        const Eigen::Vector3d ray =
            rays * Eigen::Vector3d(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5, 1);
        const double depth = (kWallDistance - normal.dot(centre)) / normal.dot(ray);
        view.depth.values.push_back(static_cast<float>(depth));
        for (const double colour : {0.0, 0.4, 0.8}) view.rgb.push_back(paint(centre + depth * ray, colour));
      }
    }
    views.push_back(std::move(view));
  }
  return views;
}

// Returns the bytes a second that copying reads and writes together, far beyond the caches.
double copy_peak() {
  const std::vector<char> from(size_t{64} << 20, 1);
  std::vector<char> to(from.size());
  const double seconds = fastest_seconds_of([&] { std::memcpy(to.data(), from.data(), from.size()); });
  return 2 * static_cast<double>(from.size()) / seconds;
}

StereoBenchmarkRow row_of(const std::string& stage, int64_t threads, const std::vector<double>& seconds,
                          double planes) {
  StereoBenchmarkRow row;
  row.stage = stage;
  row.threads = threads;
  const Spread spread = spread_of(seconds);
  row.seconds = spread.median;
  row.seconds_low = spread.low;
  row.seconds_high = spread.high;
  row.seconds_a_plane = spread.median / planes;
  return row;
}

// One view's planes, as the second pass has them.
struct OneView {
  std::vector<StereoPicture> pictures;
  std::unique_ptr<ReferenceWindows> windows;
  PlaneSweep sweep;
  std::unique_ptr<CostVolume> volume;

  OneView(const std::vector<PicturedView>& views, const StereoOptions& options) {
    const auto compared = std::min<size_t>(views.size() - 1, static_cast<size_t>(options.photographs));
    for (size_t i = 0; i <= compared; ++i)
      pictures.push_back(stereo_picture(views[i], options.largest_side, options.window / 2));
    windows = std::make_unique<ReferenceWindows>(pictures[0], options.window / 2);
    sweep.reference = &pictures[0];
    sweep.windows = windows.get();
    for (size_t i = 1; i <= compared; ++i) sweep.photographs.push_back(&pictures[i]);
    sweep.planes = {options.planes, 0.5 / kWallDistance,
                    1.5 / kWallDistance / static_cast<double>(options.planes)};
    volume = std::make_unique<CostVolume>(pictures[0].width, pictures[0].height, options.planes);
  }
};

}  // namespace

void StereoBenchmarkOptions::visit(FieldVisitor& visitor) {
  visit_out(visitor, out, overwrite);
  visitor.integer({"photograph_count", "photographs of a painted wall"}, photograph_count, {2, 64});
  visitor.integer({"side", "pixels a side of each"}, side, {32, 4096});
  visitor.integer({"repeats", "measurements of each, of which the median counts"}, repeats, {1, 1000});
  visit_threads(visitor, threads);
  visitor.group({"stereo", "how depth is found"}, stereo);
}

void StereoBenchmarkOptions::check() const {
  check_out(out, "runs/bench");
  stereo.check();
}

std::vector<StereoBenchmarkRow> stereo_benchmark_rows(const StereoBenchmarkOptions& options,
                                                      PeakMeter& meter) {
  const auto views = painted_wall(options.photograph_count, options.side);
  KernelSettings settings;
  settings.threads = static_cast<int>(threads_to_use(options.threads));
  const KernelTable& kernels = kernel_table(settings.instruction_set);
  const OneView one(views, options.stereo);
  std::vector<PicturedView> without_prior = views;
  for (PicturedView& view : without_prior) view.depth = {};
  std::vector<double> sweep, matching, whole;
  const int64_t height = one.pictures[0].height, parts = (height + kRowsAPart - 1) / kRowsAPart;
  const auto planes = static_cast<double>(options.stereo.planes);
  const double cells = planes * static_cast<double>(one.pictures[0].width * height);
  const double samples = cells * static_cast<double>(one.sweep.photographs.size());
  StereoScene scene;
  // The first round warms up memory and clock.
  for (int64_t repeat = -1; repeat < options.repeats; ++repeat) {
    meter.measure(settings.threads);
    const double sweep_seconds = seconds_of([&] {
#pragma omp parallel for num_threads(settings.threads) schedule(dynamic)
      for (int64_t part = 0; part < parts; ++part) {
        sweep_rows(one.sweep, kernels, part * kRowsAPart, std::min((part + 1) * kRowsAPart, height),
                   *one.volume);
      }
    });
    const double matching_seconds =
        seconds_of([&] { match_semi_globally(*one.volume, one.pictures[0], {}, 3, kernels); });
    const double whole_seconds =
        seconds_of([&] { scene = stereo_depth(without_prior, {}, options.stereo, settings); });
    stop_if_interrupted(fmt::format("{} of {} repeats", std::max<int64_t>(0, repeat), options.repeats));
    if (repeat < 0) continue;
    sweep.push_back(sweep_seconds);
    matching.push_back(matching_seconds);
    whole.push_back(whole_seconds);
  }
  std::vector<StereoBenchmarkRow> rows;
  rows.push_back(row_of("sweep", settings.threads, sweep, planes));
  rows.back().gigabytes = 1e-9 * samples * sweep_bytes() / rows.back().seconds;
  const double operations = samples * sweep_operations(options.stereo.window / 2);
  rows.back().gigaoperations = 1e-9 * operations / rows.back().seconds;
  rows.back().fraction_of_peak = operations / rows.back().seconds / meter.peak(settings.threads);
  meter.reached("sweep", operations, rows.back().seconds_low, settings.threads);
  rows.push_back(row_of("matching", 1, matching, planes));
  rows.back().gigabytes = 1e-9 * cells * semi_global_traffic() / rows.back().seconds;
  rows.back().gigaoperations = 1e-9 * cells * semi_global_operations() / rows.back().seconds;
  rows.push_back(
      row_of("whole", settings.threads, whole, planes * static_cast<double>(options.photograph_count)));
  double error = 0, confident = 0, pixels = 0;
  for (size_t view = 0; view < views.size(); ++view) {
    const StereoDepth& found = scene.views[view];
    const PlanarDepth& known = views[view].depth;
    for (int64_t y = 0; y < found.depth.height; ++y) {
      for (int64_t x = 0; x < found.depth.width; ++x) {
        pixels += 1;
        if (found.confidence.at(x, y) < kConfidentStereo) continue;
        const int64_t row = (2 * y + 1) * known.height / (2 * found.depth.height);
        const int64_t column = (2 * x + 1) * known.width / (2 * found.depth.width);
        const double truth = known.values[static_cast<size_t>(row * known.width + column)];
        error += std::abs(found.depth.values[static_cast<size_t>(y * found.depth.width + x)] - truth) / truth;
        confident += 1;
      }
    }
  }
  rows.back().mean_error = confident > 0 ? error / confident : 0;
  rows.back().confident_share = confident / pixels;
  return rows;
}

Table stereo_benchmark_table(const std::vector<StereoBenchmarkRow>& rows) {
  Table table({"stage", "threads", "seconds", "seconds_low", "seconds_high", "seconds_a_plane", "gigabytes",
               "gigaoperations", "fraction_of_peak", "mean_error", "confident_share"});
  for (const auto& row : rows) {
    table.add_row({row.stage, row.threads, row.seconds, row.seconds_low, row.seconds_high,
                   row.seconds_a_plane, row.gigabytes, row.gigaoperations, row.fraction_of_peak,
                   row.mean_error, row.confident_share});
  }
  return table;
}

int run_stereo_benchmark(const StereoBenchmarkOptions& options) {
  RunFolder folder(options.out, "bench stereo", options, earlier_run(options.overwrite));
  const int threads = static_cast<int>(threads_to_use(options.threads));
  PeakMeter meter;
  const double copy = copy_peak();
  const Table table = stereo_benchmark_table(stereo_benchmark_rows(options, meter));
  const double multiply_add = meter.peak(threads);
  const std::string text = fmt::format(
      "# Depth that photographs agree on\n"
      "\n"
      "{} photographs of {} x {}, matched at {} pixels a side, {} planes; {} vectors; with {} threads the "
      "multiply-add peak is {:.0f} GFLOP/s, and one thread copies memory at {:.1f} GB/s.\n"
      "\n"
      "{}",
      options.photograph_count, options.side, options.side,
      std::min(options.side, options.stereo.largest_side), options.stereo.planes,
      instruction_set_name(best_instruction_set()), threads, multiply_add * 1e-9, copy * 1e-9,
      table.markdown());
  BenchmarkResults results;
  results.text = text;
  results.files = {{"stereo.csv", table.csv()}, {"stereo.md", text}};
  results.report = {{"command", "bench stereo"},
                    {"options", to_json(options)},
                    {"multiply_add_peak", multiply_add},
                    {"copy_peak", copy}};
  results.notes = {{"table", "stereo.md"}};
  return finish_measured_benchmark(folder, results, meter.problems());
}

}  // namespace gld
