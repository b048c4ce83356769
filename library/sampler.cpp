#include "library/sampler.h"

#include "datasets/loading/batching.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/cameras/resized_camera.h"
#include "gld/machine/stage_record.h"
#include "gld/report/provenance.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/device.h"
#include "infer/pipeline/bundle_models.h"
#include "infer/sample/planned_sampling.h"
#include "infer/sample/prepared_sampling.h"
#include "infer/sample/sampling_evidence.h"
#include "infer/sample/sampling_outputs.h"
#include "models/bundle/part_lineage.h"

#include <algorithm>
#include <chrono>
#include <exception>
#include <new>

namespace gld::sampler {
namespace {

Picture picture_of(const Image& image) {
  return {image.width, image.height, {image.rgb.begin(), image.rgb.end()}};
}

PinholeCamera camera_of(const Camera& camera) {
  PinholeCamera made;
  made.width = camera.width;
  made.height = camera.height;
  made.focal_x = camera.intrinsics(0, 0);
  made.focal_y = camera.intrinsics(1, 1);
  made.centre_x = camera.intrinsics(0, 2);
  made.centre_y = camera.intrinsics(1, 2);
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) {
      made.world_from_camera[4 * static_cast<size_t>(row) + static_cast<size_t>(column)] =
          camera.world_from_camera.matrix()(row, column);
    }
  }
  return made;
}

Camera camera_of(const PinholeCamera& camera) {
  Camera made;
  made.width = camera.width;
  made.height = camera.height;
  made.intrinsics(0, 0) = camera.focal_x;
  made.intrinsics(1, 1) = camera.focal_y;
  made.intrinsics(0, 2) = camera.centre_x;
  made.intrinsics(1, 2) = camera.centre_y;
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) {
      made.world_from_camera.matrix()(row, column) =
          camera.world_from_camera[4 * static_cast<size_t>(row) + static_cast<size_t>(column)];
    }
  }
  return made;
}

Image image_of(const Picture& picture, const std::string& name) {
  const auto bytes = static_cast<size_t>(std::max<int64_t>(0, 3 * picture.width * picture.height));
  if (picture.width < 2 || picture.height < 2 || picture.rgb.size() != bytes) {
    fail({name, "a picture of at least 2x2 pixels with 3 bytes for each",
          size_text(picture.width, picture.height) + " and " + std::to_string(picture.rgb.size()) + " bytes",
          "fill SourceView::picture"});
  }
  Image image(picture.width, picture.height);
  std::copy(picture.rgb.begin(), picture.rgb.end(), image.rgb.begin());
  return image;
}

// Sources come first, then targets, which have no picture.
Scene scene_of(const SampleRequest& request) {
  Scene scene;
  scene.name = "views of a program";
  scene.format = "library";
  for (size_t i = 0; i < request.sources.size(); ++i) {
    Frame frame;
    frame.name = "source_" + std::to_string(i);
    frame.camera = camera_of(request.sources[i].camera);
    Image image = image_of(request.sources[i].picture, frame.name);
    if (image.width != frame.camera.width || image.height != frame.camera.height) {
      fail({frame.name,
            "a picture of the camera's size, " + size_text(frame.camera.width, frame.camera.height),
            size_text(image.width, image.height), "give both the same"});
    }
    frame.load_image = [image = std::move(image)] { return image; };
    scene.frames.push_back(std::move(frame));
  }
  for (size_t i = 0; i < request.targets.size(); ++i) {
    Frame frame;
    frame.name = "target_" + std::to_string(i);
    frame.camera = camera_of(request.targets[i]);
    scene.frames.push_back(std::move(frame));
  }
  return scene;
}

// Refuses what the request says otherwise, and what writes files.
void refuse_fixed(const std::string& key) {
  static const std::vector<std::string> fixed{"model",  "scene",   "photos", "views.sources", "views.targets",
                                              "seed",   "threads", "out",    "outputs",       "overwrite",
                                              "resume", "json",    "preview"};
  if (std::find(fixed.begin(), fixed.end(), key) == fixed.end() && key.rfind("page.", 0) != 0) return;
  fail({"SampleRequest::options",
        "options that the request has no member or callback for, and that write no file", key,
        "leave it out; gld sample writes files"});
}

SampleOptions options_of(const SampleRequest& request) {
  const bool with_cameras = !request.sources.empty() || !request.targets.empty();
  if (with_cameras != request.photographs.empty() || (with_cameras && request.sources.empty()) ||
      (with_cameras && request.targets.empty())) {
    fail({"SampleRequest", "either photographs, or sources and targets",
          with_cameras ? (request.photographs.empty() ? "sources or targets alone" : "both") : "nothing",
          "fill one of the two"});
  }
  SampleOptions options;
  const auto set = [&](const std::string& key, const std::string& value) {
    apply_setting(options, key, value, "SampleRequest::options");
    options.named.push_back(key);
  };
  options.model = request.model;
  options.out = "-";  // nothing is written
  options.seed = request.seed;
  options.threads = request.threads;
  if (with_cameras) {
    options.scene = "-";
    const auto sources = static_cast<int64_t>(request.sources.size());
    for (int64_t i = 0; i < sources; ++i) options.views.sources.emplace_back(i);
    for (size_t i = 0; i < request.targets.size(); ++i) {
      options.views.targets.emplace_back(sources + static_cast<int64_t>(i));
    }
  } else {
    options.photos.files = request.photographs;
    set("views.frames", std::to_string(request.path_views));
  }
  set("outputs", "[image]");
  for (const auto& [key, value] : request.options) {
    refuse_fixed(key);
    set(key, value);
  }
  check_options(options, "SampleRequest::options");
  return options;
}

std::optional<SampleResult> sampled(const SampleRequest& request, const SampleCallbacks& callbacks) {
  const auto start = std::chrono::steady_clock::now();
  const SampleOptions options = options_of(request);
  use_threads(options.threads);
  PreparedSampling prepared =
      request.photographs.empty() ? prepare(options, scene_of(request)) : prepare(options);
  const std::vector<BundlePart> parts = require_parts(prepared, options);
  if (const std::string problem = memory_problem(prepared, options); !problem.empty())
    throw SamplerError(problem);
  StageRecords stages;
  record_device(stages, prepared.device);
  bool stopped = false;
  const auto stop = [&] { return stopped = stopped || (callbacks.cancelled && callbacks.cancelled()); };
  if (stop()) return std::nullopt;
  if (!prepared.photographs.empty()) estimate_cameras(prepared, options, stages);
  for (auto& note : mixed_parts(prepared.bundle, parts, options.allow_mixed)) {
    prepared.scene.warnings.push_back(std::move(note));
  }
  const PlannedSampling planned =
      plan_of(prepared, options, PlanTiming::kPredicted, [&] { return prepared.bundle.content_hash(); });
  load_pixels(prepared, options);
  if (stop()) return std::nullopt;
  PipelineRequest pipeline = pipeline_request(prepared, options, planned.settings);
  pipeline.stop_requested = stop;
  if (callbacks.progress) {
    pipeline.on_step = [&](const std::string& stage, const SolveProgress& solve) {
      stopped =
          stopped || !callbacks.progress({stage, solve.step, solve.steps, solve.time, solve.evaluations});
    };
  }
  if (callbacks.preview) {
    pipeline.preview_every = std::max<int64_t>(1, callbacks.preview_every);
    pipeline.on_preview = [&](const std::string& stage, const torch::Tensor& images) {
      std::vector<Picture> views;
      for (int64_t i = 0; i < images.size(0); ++i) views.push_back(picture_of(to_image(images[i])));
      callbacks.preview(stage, views);
    };
  }
  const PipelineModels models =
      bundle_models(prepared.bundle, prepared.device, planned.choice.method.precision);
  std::optional<PipelineResult> made;
  try {
    made = run_pipeline(models, pipeline, stages);
  } catch (const Interrupted&) {
    if (!stopped) throw;
    return std::nullopt;
  }
  const SamplingScene& scene = prepared.scene;
  PictureEvidence evidence = sampling_evidence(prepared, *made);
  if (scene.views.num_sources > 1)
    evidence.left_out = left_out_photographs(scene, pipeline.photographs, *made);
  SampleResult result;
  const PictureVerdict verdict = verdict_of(evidence);
  result.verdict = verdict.sentence;
  std::vector<std::string> warnings = scene.warnings;
  warnings.insert(warnings.end(), planned.choice.notes.begin(), planned.choice.notes.end());
  const auto of_generated = doubts_of_generated(prepared, *made);
  warnings.insert(warnings.end(), of_generated.begin(), of_generated.end());
  warnings.insert(warnings.end(), made->warnings.begin(), made->warnings.end());
  result.doubts = doubts_of(verdict, evidence, warnings);
  for (int64_t i = 0; i < scene.views.num_sources; ++i) {
    const auto view = static_cast<size_t>(i);
    result.sources.push_back({scene.view_names[view], camera_of(scene.views.cameras[view]),
                              picture_of(scene.source_images[view]), 1});
  }
  const auto pictures = target_pictures(scene, options, made->images, made->composed);
  const auto expected = expected_views(evidence);
  const int64_t times = picture_magnification(scene, options);
  for (size_t i = 0; i < pictures.size(); ++i) {
    const size_t view = static_cast<size_t>(scene.views.num_sources) + i;
    const Camera& camera = scene.views.cameras[view];
    SampledView shown{scene.view_names[view],
                      camera_of(resized_camera(camera, times * camera.width, times * camera.height)),
                      picture_of(pictures[i]), 0};
    if (made->composed)
      shown.from_photographs = made->composed->shown[static_cast<int64_t>(i)].mean().item<double>();
    if (!expected.empty()) shown.expected_psnr = expected[i].psnr;
    result.views.push_back(std::move(shown));
  }
  result.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return result;
}

}  // namespace

std::optional<SampleResult> sample(const SampleRequest& request, const SampleCallbacks& callbacks) {
  try {
    return sampled(request, callbacks);
  } catch (const SamplerError&) {
    throw;
  } catch (const std::bad_alloc&) {
    throw SamplerError("memory ran out; use fewer or smaller views");
  } catch (const std::exception& error) {
    throw SamplerError(error.what());
  }
}

std::string version() { return program_version(); }

}  // namespace gld::sampler
