#include "infer/method/sample_options.h"

#include "datasets/video/video_frames.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/dashed_name.h"
#include "gld/base/error.h"
#include "infer/method/plan_errors.h"

#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {
namespace {

// Returns whether the field is one of those that make up a SamplingMethod.
bool decides_the_method(const std::string& key) {
  return key.rfind("solver.", 0) == 0 || key.rfind("approximate.", 0) == 0 || key == "refine" ||
         key == "guidance.guidance_interval";
}

// Returns the first field of the method that the command line names or a file changes; it is empty for none.
std::string method_field_asked_for(const SampleOptions& options) {
  for (const auto& key : options.named) {
    if (decides_the_method(key)) return key;
  }
  const auto defaults = describe_options(SampleOptions()), values = describe_options(options);
  for (size_t i = 0; i < values.size(); ++i) {
    if (decides_the_method(values[i].key) && values[i].default_value != defaults[i].default_value) {
      return values[i].key;
    }
  }
  return "";
}

bool begins_with(const std::string& key, const std::string& group) { return key.rfind(group, 0) == 0; }

// Returns "--orbit-center" for "views.orbit_center", and the whole key where the command has an option of that name
// outside groups: "--tolerance" is another one than "--solver.tolerance".
std::string flag_of(const std::string& key) {
  const std::string last = key.substr(key.find('.') + 1);
  for (const auto& option : describe_options(SampleOptions())) {
    if (option.key == last) return "--" + dashed_name(key);
  }
  return "--" + dashed_name(last);
}

// When something looks at an option: all whose key begins so need `given`.
struct Use {
  std::string key;
  bool given = false;
  std::string what;  // must be given
};

std::vector<Use> uses_of_options(const SampleOptions& options) {
  const SolverOptions& solver = options.solver;
  const ScheduleKind schedule = solver.schedule.schedule;
  const bool logsnr_or_karras = schedule == ScheduleKind::kLogSnr || schedule == ScheduleKind::kKarras;
  const bool geometry = options.requested().needs_geometry();
  const bool guided = options.guidance.guidance_scale != 1;
  const std::string adaptive = "an adaptive --solver", stochastic = "a stochastic --solver",
                    guidance = "a --guidance-scale other than 1", grids = "--schedule logsnr or karras";
  return {
      {"solver.schedule_file", schedule == ScheduleKind::kFile, "--schedule file"},
      {"solver.shift", schedule == ScheduleKind::kPublished || schedule == ScheduleKind::kShifted,
       "--schedule published or shifted"},
      {"solver.last_time", schedule == ScheduleKind::kPublished, "--schedule published"},
      {"solver.first_time", logsnr_or_karras, grids},
      {"solver.final_time", logsnr_or_karras, grids},
      {"solver.tolerance", is_adaptive(solver.solver), adaptive},
      {"solver.evaluations", !is_adaptive(solver.solver), "a --solver of fixed steps"},
      {"solver.max_evaluations", is_adaptive(solver.solver), adaptive},
      {"solver.diffusion", is_stochastic(solver.solver), stochastic},  // and diffusion_strength
      {"solver.noise_seed", is_stochastic(solver.solver), stochastic},
      {"guidance.guidance_interval", guided, guidance},
      {"guidance.guidance_branches", guided, guidance},
      {"guidance.guidance_batch_memory", guided, guidance},
      {"points.", options.requested().points, "points among --outputs"},
      {"page.", options.requested().page, "page among --outputs"},
      {"preview", options.requested().image, "image among --outputs"},
      {"splats.", options.requested().splats, "splats among --outputs"},
      {"scale_from", geometry, "depth, rays or points among --outputs"},
      {"geometry_cameras", !options.geometry_model.empty(), "--geometry-model, which is told the cameras"},
      {"geometry_model", geometry || !options.photos.files.empty(), "depth, rays or points among --outputs"},
  };
}

// Refuses what the command line asks for and nothing would look at.
void refuse_without_effect(const SampleOptions& options) {
  const auto uses = uses_of_options(options);
  for (const auto& key : options.named) {
    for (const Use& use : uses) {
      if (use.given || !begins_with(key, use.key)) continue;
      fail({flag_of(key), use.what + ", without which nothing looks at it", "none",
            "add it, or leave " + flag_of(key) + " out"});
    }
    if ((key == "photo_lens" || key == "photo_cameras" || key == "photo_frames") &&
        options.photos.files.empty()) {
      fail({flag_of(key), "--photos, which it is an option of", "--scene", "leave out one of the two"});
    }
    if (key == "photo_frames" &&
        std::none_of(options.photos.files.begin(), options.photos.files.end(), is_video_name)) {
      fail({flag_of(key), "a video among --photos", "none", "add one, or leave " + flag_of(key) + " out"});
    }
    const bool of_a_path =
        begins_with(key, "views.") && key != "views.sources" && key != "views.targets" && key != "views.path";
    // Photographs without targets get a path, which these may shape.
    const bool has_path =
        !options.views.path.path.empty() || (!options.photos.files.empty() && options.views.targets.empty());
    if (!has_path && of_a_path) {
      fail({flag_of(key), "--path, which it is an option of", "--targets", "leave out one of the two"});
    }
  }
  if (!options.views.path.path.empty()) refuse_orbit_options_of(options, options.views.path.path);
}

void refuse_two_methods(const SampleOptions& options) {
  const bool quality = options.quality != SamplingQuality::kOptions;
  if (!quality && options.tolerance == 0) return;
  const std::string chosen = quality ? "--quality" : "--tolerance";
  const std::string other = quality && options.tolerance > 0 ? "tolerance" : method_field_asked_for(options);
  if (other.empty()) return;
  fail({chosen, "no other option beside it that decides how to sample", "'" + other + "'",
        "leave out one of the two"});
}

}  // namespace

void refuse_orbit_options_of(const SampleOptions& options, const std::string& path) {
  if (path == "orbit") return;
  for (const auto& key : options.named) {
    if (!begins_with(key, "views.orbit_")) continue;
    fail({flag_of(key), "--path orbit, which it is an option of", "--path " + path,
          "leave out one of the two"});
  }
}

SplatOutputOptions::SplatOutputOptions() {
  // These take about a minute for 20 views of 256x256 on two cores.
  constexpr int64_t kSteps = 1000;
  fit.steps = kSteps;
  // So that all degrees have their turn.
  fit.degree_every = kSteps / 4;
}

void SplatOutputOptions::visit(FieldVisitor& visitor) {
  visit_side(visitor, side);
  fit.visit(visitor);
}

void SplatOutputOptions::check() const {
  fit.check();
  check_without_latents(fit);
  if (fit.start.from == SplatStartFrom::kPoints) {
    fail({"--splats.start.from", "auto, depth or match: a run has no sparse points", "points",
          "leave it out, or fit the scene itself with gld splat fit --scene"});
  }
}

SceneFitOptions SplatOutputOptions::scene_fit(int64_t seed) const {
  SceneFitOptions options;
  options.side = side;
  options.seed = seed;
  options.fit = fit;
  return options;
}

SampleOptions::SampleOptions() {
  reading.broken_frames = BrokenFrames::kSkip;  // a frame that nobody chose does not stand in the way
  solver.schedule.shift = 0;                    // the model's
}

void SampleOptions::visit(FieldVisitor& visitor) {
  visitor.text({"model", "model bundle: a folder with model.yaml"}, model);
  visit_scene(visitor, scene);
  visitor.texts(
      {"photos",
       "instead of a scene: photographs without cameras, files or folders, or a video; --photo-cameras says what finds "
       "them"},
      photos.files);
  visitor.integer(
      {"photo_frames", "how many pictures of a video among --photos: the sharpest of as many stretches"},
      photos.frames, {1, 64});
  visit_choice(
      visitor,
      {"photo_lens",
       "which photographs have one lens: those of one size (upright or turned), all (shared), or none "
       "(own)"},
      photos.lens, {"by_size", "shared", "own"});
  visit_choice(
      visitor,
      {"photo_cameras",
       "what finds the cameras of photographs: the program colmap, features that they share, the rays that "
       "the model sees, or the first of these that can"},
      photos.cameras, {"automatic", "colmap", "features", "rays"});
  visitor.group({"reading", "how the scene is read"}, reading);
  visitor.group({"views", "which views"}, views);
  visitor.text(
      {"size",
       "WIDTHxHEIGHT in pixels, auto, or photographs: pictures as large as these; auto: the trained size of the "
       "nearest aspect, which the model sees for photographs too"},
      size);
  visitor.group({"photograph_use", "what is made of the photographs beside showing them to the model"},
                photograph_use);
  visitor.texts(
      {"outputs",
       "what to make, of image, depth, rays, points, latents, splats and page (splats are 3D Gaussians, with "
       "image and depth; page shows all of them)"},
      outputs);
  visitor.text({"geometry_model",
                "bundle that takes depth, rays and points off the generated images; empty: the model's own"},
               geometry_model);
  visit_choice(
      visitor,
      {"geometry_cameras",
       "cameras of the views for --geometry-model: found, it finds them itself, or given, where it has "
       "an encoder for them"},
      geometry_cameras, {"found", "given"});
  visit_seed(visitor, seed, "the noise, and of splats the order of views");
  visit_choice(
      visitor,
      {"quality",
       "published, exact or fast: how to sample, in the place of the solver, guidance and approximate "
       "options"},
      quality, sampling_quality_names());
  visitor.real({"tolerance",
                "instead of them: the largest relative error of the latents, "
                "for which the cheapest measured way is taken; 0: "
                "none (an adaptive solver's is --solver.tolerance)"},
               tolerance, {0, 10});
  visitor.group({"solver", "how the flow is integrated"}, solver);
  visitor.group({"guidance", "classifier-free guidance"}, guidance);
  visitor.group({"approximate", "work left out with an error"}, approximate);
  visitor.boolean(
      {"refine",
       "repair what the flows made in one call a target view, beside the source views' exact latents; for "
       "models with a refiner of samples"},
      refine);
  visitor.texts({"scale_from",
                 "what may tell the scale of depth: camera_poses (the predicted against the given ones), "
                 "photographs (which match at the right scale), sparse_points (of a reconstruction), "
                 "source_depth (measured in source views), usual_unit (what the model guesses, of a single "
                 "source)"},
                scale_from);
  visitor.group({"points", "how the point cloud is made"}, points);
  visitor.group({"page", "what report.html holds"}, page);
  visitor.group({"splats", "how 3D Gaussians are fitted to sources and generated views"}, splats);
  visitor.texts({"no_skip", "exact savings to switch off, so that they can be measured: " +
                                fmt::format("{}", fmt::join(exact_saving_names(), ", "))},
                no_skip);
  visit_precision(visitor, precision);
  visit_device(visitor, device);
  visit_threads(visitor, threads);
  visitor.real({"memory_limit", "gigabytes that sampling may take; 0: what is free"}, memory_limit,
               {0, 1'000'000});
  visitor.boolean({"allow_mixed", "take parts that were not trained on each other"}, allow_mixed);
  visitor.integer(
      {"preview",
       "evaluations of a flow between two pictures preview.png of what it would end with; their decoder "
       "stays in memory beside the flow's model; 0: none"},
      preview, {0, 1'000'000});
  visit_out(visitor, out, overwrite);
  visitor.boolean(
      {"resume", "go on with an interrupted run of the same options, from the levels it has made"}, resume);
  visit_json(visitor, json);
}

void SampleOptions::check() const {
  if (scene.empty() && photos.files.empty()) {
    fail({"--scene", "a folder of images with cameras", "nothing",
          "add for example --scene my_photos, or --photos my_photos where there are no cameras"});
  }
  if (!scene.empty() && !photos.files.empty()) {
    fail({"--scene, --photos", "one of the two", "both", "leave out --photos where the scene has cameras"});
  }
  if (memory_limit > 0 && device != "cpu") {
    fail({"--memory-limit", "--device cpu, of whose memory it is", device, "leave one of the two out"});
  }
  check_out(out, "runs/sample");
  requested();
  savings();
  for (const auto& kind : scale_from) {
    const auto& known = scale_evidence_names();
    if (std::find(known.begin(), known.end(), kind) != known.end()) continue;
    const auto near = nearest_name(kind, known);
    fail({"--scale-from", fmt::format("{}", fmt::join(known, ", ")), "'" + kind + "'",
          near.empty() ? "choose among them" : "did you mean '" + near + "'?"});
  }
  refuse_two_methods(*this);
  refuse_without_effect(*this);
  if (resume && overwrite) {
    fail({"--resume, --overwrite", "one of the two", "both",
          "--resume goes on with the run, --overwrite removes it"});
  }
  if (precision != PrecisionChoice::kAutomatic) check_precision_on(device, precision_of(precision));
  if (tolerance > 0 && precision != PrecisionChoice::kAutomatic &&
      !errors_hold_on(device, precision_of(precision))) {
    fail({"--tolerance",
          "--precision float32 on the device " + device + ", where no error of another one was measured",
          compute_precision_name(precision_of(precision)), "leave one of the two out"});
  }
  if (quality == SamplingQuality::kExact && precision != PrecisionChoice::kFloat32) {
    fail({"--quality exact", "--precision float32, which is part of it", "another one",
          "choose --quality fast, or solver options"});
  }
}

ExactSavings SampleOptions::savings() const {
  ExactSavings savings;
  for (const auto& name : no_skip) disable_exact_saving(savings, name);
  return savings;
}

RequestedOutputs SampleOptions::requested() const {
  RequestedOutputs requested;
  struct Output {
    const char* name;
    bool RequestedOutputs::*member;
  };
  const std::vector<Output> known{
      {"image", &RequestedOutputs::image},     {"depth", &RequestedOutputs::depth},
      {"rays", &RequestedOutputs::rays},       {"points", &RequestedOutputs::points},
      {"latents", &RequestedOutputs::latents}, {"splats", &RequestedOutputs::splats},
      {"page", &RequestedOutputs::page}};
  std::vector<std::string> names;
  names.reserve(std::size(known));
  for (const auto& output : known) names.emplace_back(output.name);
  for (const auto& name : outputs) {
    bool found = false;
    for (const auto& output : known) {
      if (name != output.name) continue;
      if (requested.*(output.member)) {
        fail({"--outputs", "every output once", "'" + name + "' twice", "leave out one of the two"});
      }
      requested.*(output.member) = true;
      found = true;
    }
    if (!found) {
      const auto near = nearest_name(name, names);
      fail({"--outputs", "image, depth, rays, points, latents, splats or page", "'" + name + "'",
            near.empty() ? "choose among them" : "did you mean '" + near + "'?"});
    }
  }
  if (outputs.empty()) fail({"--outputs", "at least one output", "none", "add for example --outputs image"});
  if (outputs == std::vector<std::string>{"page"}) {
    fail({"--outputs", "beside page an output that it can show", "none",
          "add for example --outputs image,page"});
  }
  if (requested.splats) requested.image = requested.depth = true;
  requested.geometry_of_images = !geometry_model.empty();
  return requested;
}

SamplingMethod SampleOptions::method() const {
  const ComputePrecision asked =
      precision == PrecisionChoice::kAutomatic ? ComputePrecision::kFloat32 : precision_of(precision);
  if (quality == SamplingQuality::kOptions) {
    SamplingMethod method = method_of_options(solver, guidance, approximate, asked);
    method.refine = refine;
    return method;
  }
  SamplingMethod method = quality_method(quality);
  method.precision = asked;
  return method;
}

}  // namespace gld
