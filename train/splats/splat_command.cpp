#include "train/splats/splat_command.h"

#include "datasets/formats/cameras_json.h"
#include "datasets/images/image_file.h"
#include "datasets/scenes/resize_crop.h"
#include "datasets/splats/splat_picture.h"
#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/base/option_differences.h"
#include "gld/machine/timing.h"
#include "gld/report/progress.h"
#include "gld/report/provenance.h"
#include "gld/report/report_text.h"
#include "gld/report/run_folder.h"
#include "gld/report/table.h"
#include "gld/splatting/splat_ply.h"
#include "train/splats/splat_checkpoint.h"

#include <algorithm>
#include <cmath>
#include <iostream>
#include <numeric>

#include <fmt/format.h>
#include <sys/resource.h>

namespace gld {
namespace {

// Of all threads of this process, in user mode.
double processor_seconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_utime.tv_sec) + 1e-6 * static_cast<double>(usage.ru_utime.tv_usec);
}

double mean_of(const std::vector<double>& values) {
  return values.empty()
             ? 0
             : std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

void write_steps(const RunFolder& run, const Table& table) {
  write_file_atomically(run.path() / "steps.csv", table.csv());
}

}  // namespace

void SplatCommandOptions::visit(FieldVisitor& visitor) {
  visit_scene(visitor, scene);
  visitor.text({"run", "in its place, a run folder of gld sample: its sources and its generated views"}, run);
  visit_out(visitor, out, overwrite);
  visitor.boolean({"resume", "go on with a run of the same options that was stopped or killed"}, resume);
  visitor.integer({"checkpoint_every",
                   "steps between two checkpoints, from which --resume goes on; 0: only when it is stopped"},
                  checkpoint_every, {0, 1'000'000'000});
  visitor.integer({"side", "pixels of a picture's longer side at most"}, side, {16, 8192});
  visitor.integer({"held_out", "views that are not fitted but compared with, evenly spread over the scene"},
                  held_out, {0, 100000});
  visitor.integer({"validate_every", "steps between two comparisons with them; 0: at the end only"},
                  validate_every, {0, 1'000'000'000});
  visit_seed(visitor, seed, "the order of views and what density control draws");
  visit_threads(visitor, threads);
  visitor.group({"reading", "how the scene is read"}, reading);
  visitor.group({"fit", "how Gaussians are fitted"}, fit);
}

void SplatCommandOptions::check() const {
  check_out(out, "runs/splats");
  if (scene.empty() == run.empty()) {
    fail({"gld splat fit", "--scene or --run", scene.empty() ? "neither" : "both", "name one of them"});
  }
  if (resume && overwrite) {
    fail({"--resume, --overwrite", "one of the two", "both",
          "--resume goes on with the run, --overwrite removes it"});
  }
  fit.check();
}

SplatFitViews load_fit_views(const Scene& scene, int64_t side, int64_t held_out,
                             const KernelSettings& settings) {
  std::vector<const Frame*> frames;
  for (const Frame& frame : scene.frames) {
    if (frame.has_image()) frames.push_back(&frame);
  }
  const auto count = static_cast<int64_t>(frames.size());
  if (count - held_out < 1) {
    fail({"--held-out", fmt::format("less than the scene's {} views with a picture", count),
          fmt::format("{}", held_out), "keep fewer of them apart"});
  }
  const Camera& first = frames.front()->camera;
  const double shrink =
      std::min(1.0, static_cast<double>(side) / static_cast<double>(std::max(first.width, first.height)));
  const ImageSize size{std::max<int64_t>(1, std::lround(shrink * static_cast<double>(first.width))),
                       std::max<int64_t>(1, std::lround(shrink * static_cast<double>(first.height)))};
  SplatFitViews views;
  int64_t next_held_out = 0;
  for (int64_t i = 0; i < count; ++i) {
    const Frame& frame = *frames[static_cast<size_t>(i)];
    const SizedFrame sized = load_sized(frame, size, FrameParts::kImageAndDepth);
    FittedView view{frame.name, sized.camera,
                    loss_target(splat_image_of(sized.image), sized.validity.valid, settings)};
    // The k-th of n stands in the middle of the k-th of n equal parts.
    if (next_held_out < held_out && i == (2 * next_held_out + 1) * count / (2 * held_out)) {
      ++next_held_out;
      views.held_out.push_back(std::move(view));
      continue;
    }
    views.pictures.push_back({sized.camera, sized.image, sized.depth});
    views.fitted.push_back(std::move(view));
  }
  return views;
}

std::vector<double> view_decibels(const std::vector<FittedView>& views, const GaussianSet& set,
                                  const ProjectionOptions& projection, const KernelSettings& settings) {
  std::vector<double> values;
  values.reserve(views.size());
  for (const FittedView& view : views) {
    values.push_back(decibels(
        mean_squared_error(splat_picture(set, view.camera, projection, settings).image, view.target)));
  }
  return values;
}

void run_splat_fit(const SplatCommandOptions& options) {
  options.check();
  const EarlierRun earlier = options.resume ? EarlierRun::kContinue : earlier_run(options.overwrite);
  check_run_folder(options.out, "splat fit", earlier);
  const std::filesystem::path checkpoint_file = std::filesystem::path(options.out) / kSplatCheckpointFile;
  const bool resumes = options.resume && std::filesystem::exists(checkpoint_file);
  if (options.resume) {
    refuse_other_options(options.out, options, {"checkpoint_every"});
    // A run's checkpoint goes when its report is there.
    if (!resumes && std::filesystem::exists(std::filesystem::path(options.out) / "report.json")) {
      fail({options.out, "a run that was stopped or killed", "one that is finished",
            "choose another --out, or add --overwrite in the place of --resume"});
    }
  }
  const bool of_run = !options.run.empty();
  const std::string& where = of_run ? options.run : options.scene;
  KernelSettings settings;
  settings.threads = static_cast<int>(threads_to_use(options.threads));
  const Scene scene = open_scene(where, options.reading);
  SplatFitViews views = load_fit_views(scene, options.side, options.held_out, settings);
  SplatFitOptions fit_options = options.fit;
  SplatCheckpoint state;
  SplatFit& fit = state.fit;
  std::vector<const FittedView*> all_views;
  for (const auto* some : {&views.fitted, &views.held_out}) {
    for (const FittedView& view : *some) all_views.push_back(&view);
  }
  const std::string views_hash = fit_views_hash(all_views);
  Table table({"step", "loss", "absolute", "ssim", "gaussians", "seen", "seconds", "processor_seconds",
               "held_out_psnr"});
  const double processor_here = processor_seconds();
  if (resumes) {
    state = read_splat_checkpoint(checkpoint_file);
    if (fit_options.projection.near == 0) fit_options.projection.near = kNearShare * fit.extent;
    if (state.views != views_hash) {
      fail({checkpoint_file.string(), "the pictures and cameras that the run began with",
            "others in " + where, "put those back, or begin anew with --overwrite"});
    }
  } else {
    state.views = views_hash;
    state.seconds =
        seconds_of([&] { fit = begin_splat_fit(views.pictures, scene.points_in_world, fit_options, where); });
    state.started_with = fit.set.size();
  }
  double seconds = state.seconds;
  const double processor_before = state.processor_seconds;
  for (const auto& row : state.rows) table.add_row(row);
  views.pictures.clear();
  RunFolder run(options.out, "splat fit", options, earlier);
  print_warnings(scene.warnings);
  const auto processor_so_far = [&] { return processor_before + processor_seconds() - processor_here; };
  const auto write_checkpoint = [&] {
    state.seconds = seconds;
    state.processor_seconds = processor_so_far();
    state.rows = table.rows();
    write_splat_checkpoint(checkpoint_file, state);
  };
  Progress progress("splats", fit_options.steps);
  while (fit.step < fit_options.steps && !interrupt_requested()) {
    SplatFitStep step;
    seconds += seconds_of([&] {
      step = splat_fit_step(views.fitted, fit_options, static_cast<uint64_t>(options.seed), settings, fit);
    });
    const bool validates = options.validate_every > 0 && step.step % options.validate_every == 0;
    constexpr int64_t kRowEvery = 10;
    if (step.step % kRowEvery == 0 || validates || step.step == fit_options.steps) {
      TableCell held_out = std::string();
      const double processor = processor_so_far();
      if (validates && !views.held_out.empty())
        held_out = mean_of(view_decibels(views.held_out, fit.set, fit_options.projection, settings));
      table.add_row({step.step, step.loss, step.absolute, step.similarity, step.gaussians, step.seen, seconds,
                     processor, held_out});
    }
    if (options.checkpoint_every > 0 && step.step % options.checkpoint_every == 0) write_checkpoint();
    progress.update(step.step, fmt::format("loss {:.4f}, {} Gaussians", step.loss, step.gaussians));
  }
  progress.finish();
  if (fit.step < fit_options.steps) write_checkpoint();
  const double processor = processor_so_far();
  const Provenance provenance = make_provenance("splat fit", options);
  write_splat_ply(run.path() / kSplatFile, fit.set, provenance_items(provenance));
  CameraList list;
  list.metric = scene.metric;
  for (const FittedView& view : views.fitted) {
    CameraRecord record;
    record.name = view.name;
    record.role = "source";
    record.camera = view.camera;
    list.records.push_back(record);
  }
  const std::vector<double> held_out =
      view_decibels(views.held_out, fit.set, fit_options.projection, settings);
  nlohmann::ordered_json of_views = nlohmann::ordered_json::object();
  for (size_t i = 0; i < views.held_out.size(); ++i) {
    const FittedView& view = views.held_out[i];
    CameraRecord record;
    record.name = view.name;
    record.role = "target";
    record.camera = view.camera;
    list.records.push_back(record);
    of_views[view.name] = held_out[i];
    write_png(run.subfolder("held_out") / (view.name + ".png"),
              image_of(splat_picture(fit.set, view.camera, fit_options.projection, settings).image));
  }
  write_cameras_json(run.path() / "cameras.json", list);
  write_steps(run, table);
  nlohmann::ordered_json report;
  report["scene"] = scene.name;
  report["views"] = {{"fitted", views.fitted.size()}, {"held_out", views.held_out.size()}};
  report["size"] = {views.fitted.front().camera.width, views.fitted.front().camera.height};
  report["steps"] = fit.step;
  report["gaussians"] = {{"at_first", state.started_with}, {"at_last", fit.set.size()}};
  report["extent"] = fit.extent;
  report["near"] = fit_options.projection.near;
  report["seconds"] = seconds;
  report["processor_seconds"] = processor;
  report["threads"] = settings.threads;
  report["fitted_psnr"] = mean_of(view_decibels(views.fitted, fit.set, fit_options.projection, settings));
  if (!held_out.empty()) {
    report["held_out_psnr"] = mean_of(held_out);
    report["held_out_psnr_of_views"] = of_views;
  }
  run.write_report(report);
  stop_if_interrupted(fmt::format("{} of {} steps are done; the Gaussians so far are in {}, --resume goes on",
                                  fit.step, fit_options.steps, (run.path() / kSplatFile).string()));
  std::error_code gone;
  std::filesystem::remove(checkpoint_file, gone);
  std::cout << fmt::format(
      "{} Gaussians after {} steps in {} ({:.1f} s of processors); fitted views {:.2f} dB", fit.set.size(),
      fit.step, duration_text(seconds), processor, report["fitted_psnr"].get<double>());
  if (!held_out.empty()) std::cout << fmt::format(", held-out views {:.2f} dB", mean_of(held_out));
  std::cout << "\n";
  run.note("Gaussians", kSplatFile);
  run.note("cameras", "cameras.json");
  if (!held_out.empty()) run.note("held-out views", "held_out/");
  run.note("steps", "steps.csv");
  run.note("report", "report.json");
  std::cout << run.closing_box();
}

}  // namespace gld
