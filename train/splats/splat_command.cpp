#include "train/splats/splat_command.h"

#include "datasets/formats/cameras_json.h"
#include "datasets/images/image_file.h"
#include "datasets/splats/splat_picture.h"
#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/base/option_differences.h"
#include "gld/machine/stage_record.h"
#include "gld/machine/timing.h"
#include "gld/report/distinct_names.h"
#include "gld/report/progress.h"
#include "gld/report/report_text.h"
#include "gld/report/run_folder.h"
#include "gld/report/table.h"
#include "train/splats/splat_checkpoint.h"

#include <iostream>
#include <numeric>
#include <utility>

#include <fmt/format.h>
#include <sys/resource.h>

namespace gld {
namespace {

// Returns the seconds of all threads of this process, in user mode.
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

// Refuses what is refused before anything is read, and returns whether there is a checkpoint to go on from.
bool goes_on(const SplatCommandOptions& options, EarlierRun earlier) {
  check_run_folder(options.out, "splat fit", earlier);
  if (!options.resume) return false;
  const std::filesystem::path out = options.out;
  refuse_other_options(options.out, options, SplatCommandOptions(), {"checkpoint_every"});
  // A run's checkpoint goes when its report is there.
  const bool has_checkpoint = std::filesystem::exists(out / kSplatCheckpointFile);
  if (!has_checkpoint && std::filesystem::exists(out / "report.json")) {
    fail({options.out, "a run that was stopped or killed", "one that is finished",
          "choose another --out, or add --overwrite in the place of --resume"});
  }
  return has_checkpoint;
}

// A fit on its way: what is fitted, how, and where it stands.
class FitInSteps {
 public:
  FitInSteps(const SplatCommandOptions& options, const Scene& scene, const SplatFitLatents& latents,
             bool resumes)
      : options_(options),
        fit_options_(options.fit),
        more_follows_(latents.after != nullptr),
        checkpoint_file_(std::filesystem::path(options.out) / kSplatCheckpointFile),
        table_({"step", "loss", "absolute", "ssim", "latent", "gaussians", "seen", "seconds",
                "processor_seconds", "held_out_psnr"}) {
    settings_.threads = static_cast<int>(threads_to_use(options.threads));
    const ImageSize size = fit_size(scene, options.side);
    work_ = scene_fit_work(scene, size, options.held_out, fit_options_);
    require_memory_for_fit(work_, fit_options_, available_memory_bytes(), options.where());
    // This comes before the fit has memory of its own: it makes one beside it.
    if (fit_options_.steps > 0) whole_seconds_ = splat_fit_seconds(work_, fit_options_, settings_.threads);
    views_ = load_fit_views(scene, size, options.held_out, settings_);
    if (moved_by_latents(options.fit.geometry_from)) latents.before(scene, views_);
    processor_at_first_ = processor_seconds();
    if (resumes) {
      resume();
    } else {
      begin(scene);
    }
    views_.pictures.clear();
    processor_before_ = state_.processor_seconds;
    for (const auto& row : state_.rows) table_.add_row(row);
  }

  // Returns seconds and memory, before the first step; of latents, nothing.
  std::string forecast() const {
    constexpr double kMegabyte = 1e6;
    const double steps = static_cast<double>(fit_options_.steps - state_.fit.step),
                 share = steps / static_cast<double>(std::max<int64_t>(1, fit_options_.steps));
    return fmt::format("about {} for {} steps, and {:.0f} MB for pictures and Gaussians",
                       duration_text(share * whole_seconds_), fit_options_.steps - state_.fit.step,
                       static_cast<double>(splat_fit_bytes(work_, fit_options_)) / kMegabyte);
  }

  // Runs until all steps are done or Ctrl-C is pressed; then there is a checkpoint.
  void run() {
    Progress progress({"splats", fit_options_.steps, state_.fit.step, options_.out});
    while (!finished() && !interrupt_requested()) {
      SplatFitStep step;
      state_.seconds += seconds_of([&] {
        step = splat_fit_step(views_.fitted, fit_options_, static_cast<uint64_t>(options_.seed), settings_,
                              state_.fit);
      });
      add_row(step);
      if (options_.checkpoint_every > 0 && step.step % options_.checkpoint_every == 0) write_checkpoint();
      progress.update(step.step, fmt::format("loss {:.4f}, {} Gaussians", step.loss, step.gaussians));
    }
    progress.finish();
    // Where latents are solved for afterwards, stopping that does not cost the fit.
    if (!finished() || more_follows_) write_checkpoint();
  }

  bool finished() const { return state_.fit.step >= fit_options_.steps; }
  void remove_checkpoint() const {
    std::error_code gone;
    std::filesystem::remove(checkpoint_file_, gone);
  }
  const GaussianSet& set() const { return state_.fit.set; }
  const SplatFitViews& views() const { return views_; }
  const SplatCheckpoint& state() const { return state_; }
  const ProjectionOptions& projection() const { return fit_options_.projection; }
  const KernelSettings& settings() const { return settings_; }
  const Table& table() const { return table_; }
  double processor() const { return processor_before_ + processor_seconds() - processor_at_first_; }
  std::vector<double> decibels_of(const std::vector<FittedView>& views) const {
    return view_decibels(views, set(), projection(), settings_);
  }

 private:
  void begin(const Scene& scene) {
    if (work_.start == SplatStartFrom::kMatch)
      std::cout << fmt::format("matching {} pictures, where Gaussians are to begin\n", work_.views)
                << std::flush;
    state_.views = fit_views_hash(all_views(views_));
    state_.seconds = seconds_of([&] {
      state_.fit =
          begin_splat_fit(views_.pictures, scene.points_in_world, fit_options_, options_.where(), settings_);
      begin_features(views_.fitted, fit_options_, settings_, state_.fit);
    });
    state_.started_with = set().size();
  }

  void resume() {
    state_ = read_splat_checkpoint(checkpoint_file_);
    settle_fit_options(state_.fit, fit_options_);
    if (state_.views != fit_views_hash(all_views(views_))) {
      fail({checkpoint_file_.string(), "the pictures and cameras that the run began with",
            "others in " + options_.where(), "put those back, or begin anew with --overwrite"});
    }
  }

  void add_row(const SplatFitStep& step) {
    const bool validates = options_.validate_every > 0 && step.step % options_.validate_every == 0;
    constexpr int64_t kRowEvery = 10;
    if (step.step % kRowEvery != 0 && !validates && !finished()) return;
    TableCell held_out = std::string();
    const double processor_so_far = processor();
    if (validates && !views_.held_out.empty()) held_out = mean_of(decibels_of(views_.held_out));
    table_.add_row({step.step, step.loss, step.absolute, step.similarity, step.latent, step.gaussians,
                    step.seen, state_.seconds, processor_so_far, held_out});
  }

  void write_checkpoint() {
    state_.processor_seconds = processor();
    state_.rows = table_.rows();
    write_splat_checkpoint(checkpoint_file_, state_);
  }

  const SplatCommandOptions& options_;
  SplatFitOptions fit_options_;  // with the near plane
  bool more_follows_;
  std::filesystem::path checkpoint_file_;
  KernelSettings settings_;
  SplatWork work_;
  double whole_seconds_ = 0;  // that all steps may take
  SplatFitViews views_;
  SplatCheckpoint state_;
  Table table_;
  double processor_at_first_ = 0, processor_before_ = 0;
};

void write_cameras(const RunFolder& run, const SplatFitViews& views, bool metric) {
  CameraList list;
  list.metric = metric;
  const auto add = [&](const FittedView& view, const char* role) {
    CameraRecord record;
    record.name = view.name;
    record.role = role;
    record.camera = view.camera;
    list.records.push_back(record);
  };
  for (const FittedView& view : views.fitted) add(view, "source");
  for (const FittedView& view : views.held_out) add(view, "target");
  write_cameras_json(run.path() / "cameras.json", list);
}

void write_held_out(const RunFolder& run, const FitInSteps& fit) {
  DistinctNames names;
  for (const FittedView& view : fit.views().held_out) {
    write_png(run.subfolder("held_out") / (names.of(view.name) + ".png"),
              image_of(splat_picture(fit.set(), view.camera, fit.projection(), fit.settings()).image));
  }
}

nlohmann::ordered_json fit_report(const FitInSteps& fit, const std::string& scene_name) {
  const SplatFitViews& views = fit.views();
  nlohmann::ordered_json report;
  report["scene"] = scene_name;
  report["views"] = {{"fitted", views.fitted.size()}, {"held_out", views.held_out.size()}};
  report["size"] = {views.fitted.front().camera.width, views.fitted.front().camera.height};
  report["steps"] = fit.state().fit.step;
  report["gaussians"] = {{"at_first", fit.state().started_with}, {"at_last", fit.set().size()}};
  report["start"] = splat_start_names().at(static_cast<size_t>(fit.state().fit.start));
  report["extent"] = fit.state().fit.extent;
  report["near"] = fit.projection().near;
  report["seconds"] = fit.state().seconds;
  report["processor_seconds"] = fit.processor();
  report["threads"] = fit.settings().threads;
  report["fitted_psnr"] = mean_of(fit.decibels_of(views.fitted));
  const std::vector<double> held_out = fit.decibels_of(views.held_out);
  if (held_out.empty()) return report;
  report["held_out_psnr"] = mean_of(held_out);
  for (size_t i = 0; i < held_out.size(); ++i)
    report["held_out_psnr_of_views"][views.held_out[i].name] = held_out[i];
  return report;
}

std::string closing_line(const nlohmann::ordered_json& report) {
  std::string text = fmt::format(
      "{} Gaussians after {} steps in {} ({:.1f} s of processors); {:.2f} dB on the views that were fitted",
      report["gaussians"]["at_last"].get<int64_t>(), report["steps"].get<int64_t>(),
      duration_text(report["seconds"].get<double>()), report["processor_seconds"].get<double>(),
      report["fitted_psnr"].get<double>());
  if (report.contains("held_out_psnr"))
    text += fmt::format(", held-out views {:.2f} dB", report["held_out_psnr"].get<double>());
  return text + "\n";
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
  visitor.integer({"validate_every", "steps between two comparisons with them; 0: at the end only"},
                  validate_every, {0, 1'000'000'000});
  visit_threads(visitor, threads);
  visitor.group({"reading", "how the scene is read"}, reading);
  SceneFitOptions::visit(visitor);
  visitor.texts(
      {"features",
       "levels of a latent space whose latents are fitted to the finished Gaussians: numbers, or all; none: no"},
      features);
  visitor.text({"model", "the model bundle whose backbone encodes them"}, model);
  visitor.group({"solve", "how features are solved for"}, solve);
}

bool SplatCommandOptions::has_features() const {
  return !features.empty() && features != std::vector<std::string>{"none"};
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
  if (!has_features()) check_without_latents(fit);
}

void run_splat_fit(const SplatCommandOptions& options, const SplatFitLatents& latents) {
  options.check();
  const EarlierRun earlier = options.resume ? EarlierRun::kContinue : earlier_run(options.overwrite);
  const bool resumes = goes_on(options, earlier);
  const Scene scene = open_scene(options.where(), options.reading);
  FitInSteps fit(options, scene, latents, resumes);
  RunFolder run(options.out, "splat fit", options, earlier);
  print_warnings(scene.warnings);
  if (!fit.finished()) std::cout << fit.forecast() << "\n" << std::flush;
  fit.run();
  write_fitted_splats(run.path() / kSplatFile, fit.set(), scene.name, options);
  write_cameras(run, fit.views(), scene.metric);
  write_held_out(run, fit);
  write_file_atomically(run.path() / "steps.csv", fit.table().csv());
  nlohmann::ordered_json report = fit_report(fit, scene.name);
  if (latents.after && fit.finished())
    latents.after({fit.set(), fit.projection(), scene, fit.settings(), run, report});
  run.write_report(report);
  if (!fit.finished()) {
    stop_if_interrupted(
        fmt::format("{} of {} steps are done; the Gaussians so far are in {}, --resume goes on",
                    fit.state().fit.step, options.fit.steps, (run.path() / kSplatFile).string()));
  }
  fit.remove_checkpoint();
  std::cout << closing_line(report);
  run.note("Gaussians", kSplatFile);
  run.note("cameras", "cameras.json");
  if (!fit.views().held_out.empty()) run.note("held-out views", "held_out/");
  run.note("steps", "steps.csv");
  run.note("report", "report.json");
  std::cout << run.closing_box();
}

}  // namespace gld
