#include "infer/sample/prepared_sampling.h"

#include "datasets/formats/scene_reader.h"
#include "datasets/video/video_frames.h"
#include "gld/base/error.h"
#include "gld/tensors/device.h"
#include "gld/tensors/torch_version.h"
#include "infer/forecast/memory_refusal.h"
#include "infer/pipeline/bundle_models.h"
#include "infer/request/scene_request.h"
#include "models/bundle/trained_views.h"

#include <algorithm>
#include <filesystem>
#include <memory>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {
namespace {

// Of drawn rooms, two views of a scene of 8 have 0.06 dB less in what is generated than in a scene of the 4 that the
// small model was trained on, and as good pictures; in a scene of 24 they have 0.5 dB less
// (docs/measured/views_beyond_training).
constexpr int64_t kTimesTrainedViews = 2;

// Returns where many more views, or pictures of another size, are asked for than the model was trained on, a sentence
// each.
std::vector<std::string> unlike_training(const SamplingScene& scene, const ModelBundle& model) {
  const BundleOptions& bundle = model.options();
  const int64_t views = trained_views(model);
  std::vector<std::string> notes;
  const auto sizes = bundle.image_sizes();
  const bool trained = std::any_of(sizes.begin(), sizes.end(), [&](const ImageSize& size) {
    return size.width == scene.size.width && size.height == scene.size.height;
  });
  if (!trained) {
    notes.push_back(fmt::format("The model was trained on images of {}, these are {}x{}.",
                                fmt::join(bundle.trained_sizes, ", "), scene.size.width, scene.size.height));
  }
  if (views > 0 && scene.views.size() > kTimesTrainedViews * views) {
    notes.push_back(fmt::format("The model was trained on scenes of {} view{}, this one has {}.", views,
                                views == 1 ? "" : "s", scene.views.size()));
  }
  return notes;
}

void check_lifting(const SampleOptions& options, const ModelBundle& geometry_model) {
  const auto& head = geometry_model.options().geometry_head;
  if (!options.requested().points || options.points.lifting != PointLifting::kPointMaps || !head.exists() ||
      head.architecture().predicts_points()) {
    return;
  }
  fail({"--points.lifting", "cameras or rays of a model whose head predicts no points",
        "point_maps of " + geometry_model.options().name,
        "choose another, or --geometry-model DIR with a head that does (VGGT's)"});
}

// Only rays tell where depth and points belong. flag is what chose the model.
void check_rays(const SampleOptions& options, const ModelBundle& geometry_model, const char* flag) {
  if (!options.requested().needs_geometry() || geometry_model.options().geometry_head.predicts_rays()) return;
  fail({flag, "image or latents of a model without a camera head",
        "depth, rays or points of " + geometry_model.folder().string() +
            ", whose VGGT heads have none for cameras",
        "add --outputs image, or --geometry-model DIR with a model that sees cameras"});
}

// Known cameras can be told to a backbone that has an encoder for them.
void check_known_cameras(const SampleOptions& options, const ModelBundle& geometry_model) {
  if (options.geometry_cameras == GeometryCameras::kFound ||
      geometry_model.options().backbone.architecture().takes_cameras())
    return;
  fail({"--geometry-cameras given", "a --geometry-model whose backbone has an encoder for cameras",
        geometry_model.folder().string() + ", whose backbone of kind " +
            geometry_model.options().backbone.architecture().kind() + " has none",
        "leave the option out, or convert DA3's published file, which holds one, into a new folder"});
}

// Returns where depth, rays and points come from.
std::optional<ModelBundle> geometry_model_of(const SampleOptions& options, const ModelBundle& bundle) {
  if (!options.geometry_model.empty()) {
    auto geometry_model = ModelBundle::open(options.geometry_model);
    require_geometry_head(geometry_model);
    check_lifting(options, geometry_model);
    check_rays(options, geometry_model, "--geometry-model");
    check_known_cameras(options, geometry_model);
    return geometry_model;
  }
  check_lifting(options, bundle);
  const bool head = bundle.options().geometry_head.exists();
  if (head) check_rays(options, bundle, "--outputs");
  if (options.requested().needs_geometry() && !bundle.options().has_geometry()) {
    fail(
        {"--outputs",
         head ? "image or latents of a model that does not generate all levels, which its geometry head takes"
              : "image or latents of a model without a geometry head",
         "depth, rays or points of " + options.model,
         "add --outputs image, or --geometry-model DIR to have a geometry model look at the generated images"});
  }
  return std::nullopt;
}

bool sees_cameras(const ModelBundle& bundle) {
  return bundle.options().geometry_head.exists() && bundle.options().geometry_head.predicts_rays();
}

void check_photo_model(const ModelBundle& bundle) {
  if (!bundle.options().geometry_head.exists()) {
    fail({"--photos", "a model with a geometry head, which sees the cameras", bundle.folder().string(),
          "add --geometry-model DIR with one that has, or let COLMAP find the cameras"});
  }
  if (!bundle.options().geometry_head.predicts_rays()) {
    fail({"--photos", "a model that sees cameras",
          bundle.folder().string() + ", whose VGGT heads have none for cameras",
          "add --geometry-model DIR with one that has, or let COLMAP find the cameras"});
  }
}

// Of photographs all are sources, and the targets lie between them, unless the options say otherwise. One alone is
// orbited no farther than a guess of its depth bears.
void complete_for_photographs(ViewSelection& selection, int64_t photographs) {
  if (selection.sources.empty()) {
    for (int64_t i = 0; i < photographs; ++i) selection.sources.emplace_back(i);
  }
  if (selection.targets.empty() && selection.path.path.empty()) {
    selection.path.path = photographs > 1 ? "spline" : "orbit";
  }
  if (photographs == 1 && selection.path.orbit_degrees == 0)
    selection.path.orbit_degrees = kOrbitDegreesOfOnePhotograph;
}

// Returns whether the model that sees the camera of a single photograph says its depth too: not where photographs alone
// are asked.
bool keeps_seen_depth(const SampleOptions& options) {
  return options.photograph_use.source_depth != PhotographOptions::DepthChoice::kStereo;
}

// Numbers of photographs become numbers of those that have a camera. Throws Error where one that was chosen has none.
void follow_registered(std::vector<FrameChoice>& chosen, const PreparedSampling& prepared, const char* flag) {
  const auto& frames = prepared.found.frames;
  for (FrameChoice& choice : chosen) {
    const int64_t number = choice.number;
    if (!choice.name.empty() || number < 0 || number >= static_cast<int64_t>(prepared.photographs.size()))
      continue;
    const std::string& name = prepared.photographs[static_cast<size_t>(number)].name;
    const auto frame = std::find_if(frames.begin(), frames.end(),
                                    [&](const Frame& candidate) { return candidate.name == name; });
    if (frame == frames.end()) {
      fail({flag, "photographs whose cameras were found",
            fmt::format("{} ({}), which was left out", number, name),
            "leave it out, or add photographs between it and the others"});
    }
    choice = FrameChoice(frame - frames.begin());
  }
}

void leave_out_unregistered(PreparedSampling& prepared, const SampleOptions& options) {
  if (prepared.found.frames.size() == prepared.photographs.size()) return;
  if (options.views.sources.empty()) {
    prepared.selection.sources.clear();
    for (size_t i = 0; i < prepared.found.frames.size(); ++i) {
      prepared.selection.sources.emplace_back(static_cast<int64_t>(i));
    }
  } else {
    follow_registered(prepared.selection.sources, prepared, "--sources");
  }
  follow_registered(prepared.selection.targets, prepared, "--targets");
}

// Chooses the views with the cameras that are known now, and notes what is unusual about them.
void choose_views(PreparedSampling& prepared, const ImageSize& size) {
  prepared.scene = sampling_views(prepared.found, prepared.selection, size);
  if (!prepared.cameras_known()) {
    prepared.scene.path_note =
        "gld sample estimates the cameras of the photographs; what is said here takes their number and sizes";
    prepared.scene.warnings.clear();
  }
  prepared.unlike_training = unlike_training(prepared.scene, prepared.bundle);
}

void choose_size_and_views(PreparedSampling& prepared, const SampleOptions& options) {
  const ImageSize size = choose_size(options.size, prepared.found, prepared.bundle.options().image_sizes(),
                                     prepared.bundle.options().backbone.patch_side());
  prepared.selection = options.views;
  if (prepared.photographs.empty()) {
    options.views.require_complete();
  } else {
    complete_for_photographs(prepared.selection, static_cast<int64_t>(prepared.photographs.size()));
    const std::string& path = prepared.selection.path.path;
    if (!path.empty()) refuse_orbit_options_of(options, path);
  }
  choose_views(prepared, size);
}

}  // namespace

PreparedSampling::PreparedSampling(const SampleOptions& options)
    : device(device_from_text(options.device)), bundle(ModelBundle::open(options.model)) {}

PreparedSampling prepare(const SampleOptions& options) {
  PreparedSampling prepared(options);
  prepared.geometry_model = geometry_model_of(options, prepared.bundle);
  if (options.photos.files.empty()) {
    prepared.found = open_scene(options.scene, options.reading);
  } else {
    const auto& files = options.photos.files;
    if (std::any_of(files.begin(), files.end(), is_video_name)) {
      prepared.frames = std::make_shared<const WorkFolder>("frames");
    }
    prepared.photographs =
        list_photographs(options.photos, prepared.frames ? prepared.frames->path() : std::filesystem::path());
    if (only_rays(options.photos, prepared.photographs.size())) check_photo_model(prepared.camera_model());
    prepared.found = scene_before_cameras(prepared.photographs);
  }
  choose_size_and_views(prepared, options);
  return prepared;
}

PreparedSampling prepare(const SampleOptions& options, Scene scene) {
  PreparedSampling prepared(options);
  prepared.geometry_model = geometry_model_of(options, prepared.bundle);
  prepared.found = std::move(scene);
  choose_size_and_views(prepared, options);
  return prepared;
}

void estimate_cameras(PreparedSampling& prepared, const SampleOptions& options, StageRecords& stages) {
  const ImageSize size = prepared.scene.size;
  PhotoSceneRequest request;
  request.selection = options.photos;
  request.size = size;
  request.largest_side = largest_photograph_side(options.size);
  if (sees_cameras(prepared.camera_model())) {
    request.geometry = [&] { return bundle_models(prepared.camera_model(), prepared.device); };
  }
  request.device = prepared.device;
  request.threads = static_cast<int>(thread_count());
  prepared.photos = photo_scene(prepared.photographs, request, stages);
  prepared.found = prepared.photos->scene;
  leave_out_unregistered(prepared, options);
  // One photograph's axis meets no other, and few meet surely: the depth that was seen says how far what they look at
  // is.
  CameraPathOptions& path = prepared.selection.path;
  if (path.path == "orbit" && path.orbit_center.empty() && path.orbit_distance == 0) {
    path.orbit_distance = prepared.photos->median_depth;
  }
  choose_views(prepared, size);
}

PlanRequest plan_request(const PreparedSampling& prepared, const SampleOptions& options) {
  PlanRequest request;
  const ImageSize& size = prepared.scene.size;
  request.grid =
      prepared.bundle.options().backbone.grid_of(prepared.scene.views.size(), size.height, size.width);
  request.num_sources = prepared.scene.views.num_sources;
  request.single_source_unit_known =
      prepared.bundle.options().unit_of_single_source(prepared.scene.views, prepared.scene.metric) > 0;
  request.outputs = options.requested();
  request.photographs_used = photograph_use_of(options.photograph_use, prepared.bundle);
  if (prepared.geometry_model) {
    request.geometry_model = std::make_shared<const BundleOptions>(prepared.geometry_model->options());
  }
  if (only_rays(options.photos, prepared.photographs.size())) {
    request.photographs = static_cast<int64_t>(prepared.photographs.size());
    request.source_depth_given = request.photographs == 1 && keeps_seen_depth(options);
  }
  for (const Photograph& photograph : prepared.photographs) {
    request.photograph_pixels = std::max(request.photograph_pixels, photograph.width * photograph.height);
  }
  request.preview_every = options.preview;
  request.flow.refine = options.refine;
  request.photograph_magnification = photograph_magnification(prepared.found, prepared.selection,
                                                              largest_photograph_side(options.size), size);
  if (options.size == kPhotographSize) request.picture_magnification = request.photograph_magnification;
  if (options.requested().splats) request.splats = options.splats.scene_fit(options.seed);
  for (const BundlePart& part : needed_parts(prepared.bundle.options(), request.stage_request()))
    request.converted_bytes[bundle_part_name(part)] = prepared.bundle.converted_bytes(part);
  return request;
}

std::vector<BundlePart> require_parts(const PreparedSampling& prepared, const SampleOptions& options) {
  const BundleOptions& bundle = prepared.bundle.options();
  if (options.refine) require_sample_refiner(bundle);
  const StageRequest stages = plan_request(prepared, options).stage_request();
  auto parts = needed_parts(bundle, stages);
  const std::vector<BundlePart> seeing{BundlePart::backbone(), BundlePart::geometry_head()};
  if (prepared.geometry_model) {
    // Its backbone and head look at the generated images; this bundle's head is asked for the sources' depth alone.
    const auto head = std::find(parts.begin(), parts.end(), BundlePart::geometry_head());
    if (head != parts.end() && !uses_source_depth(bundle.level_set(), stages)) parts.erase(head);
    prepared.geometry_model->require(seeing);
  }
  prepared.bundle.require(parts);
  if (!prepared.photographs.empty() && sees_cameras(prepared.camera_model())) {
    prepared.camera_model().require(seeing);
  }
  return parts;
}

void load_pixels(PreparedSampling& prepared, const SampleOptions& options) {
  SamplingScene loaded = load_sampling_scene(prepared.found, prepared.selection, prepared.scene.size);
  const auto& kinds = options.scale_from;
  if (std::find(kinds.begin(), kinds.end(), "source_depth") != kinds.end()) {
    load_source_depths(prepared.found, prepared.selection, loaded);
    const auto& depths = loaded.source_depths;
    if (std::all_of(depths.begin(), depths.end(), [](const DepthMap& depth) { return depth.empty(); })) {
      fail({"--scale-from source_depth", "a source view with measured depth", "none",
            "leave it out, or choose sources that have depth"});
    }
  }
  load_source_photographs(prepared.found, prepared.selection, largest_photograph_side(options.size), loaded);
  if (options.size == kPhotographSize) load_large_true_images(prepared.found, prepared.selection, loaded);
  if (prepared.photos && keeps_seen_depth(options)) loaded.seen_depth = prepared.photos->depth;
  loaded.warnings = std::move(prepared.scene.warnings);  // which are more
  prepared.scene = std::move(loaded);
}

std::string memory_problem(const PreparedSampling& prepared, const SampleOptions& options) {
  if (!prepared.device.is_cpu()) return "";
  PlanRequest request = plan_request(prepared, options);
  request.flow = flow_settings(options.method(), options.guidance, prepared.bundle.options());
  constexpr double kGigabyte = 1e9;
  const auto limit = options.memory_limit > 0 ? static_cast<int64_t>(options.memory_limit * kGigabyte)
                                              : available_memory_bytes();
  if (limit <= 0) return "";  // the system does not tell
  return memory_refusal(prepared.bundle.options(), request, limit);
}

}  // namespace gld
