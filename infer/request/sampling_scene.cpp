#include "infer/request/sampling_scene.h"

#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/cameras/camera_checks.h"
#include "infer/export/image_export.h"
#include "models/bundle/bundle_options.h"

#include <algorithm>
#include <charconv>
#include <set>

#include <fmt/format.h>

namespace gld {
namespace {

const Frame& frame_of(const Scene& scene, int64_t number, const char* flag) {
  const auto count = static_cast<int64_t>(scene.frames.size());
  if (number < 0 || number >= count) {
    fail({flag,
          fmt::format("frame numbers from 0 to {}, which is what scene '{}' has", count - 1, scene.name),
          std::to_string(number), "choose among its frames"});
  }
  return scene.frames[static_cast<size_t>(number)];
}

void add_target_frames(const Scene& scene, const ViewSelection& selection, const ImageSize& size,
                       SamplingScene& sampling) {
  for (const int64_t number : selection.targets) {
    const Frame& frame = frame_of(scene, number, "--targets");
    const auto plan = plan_resize_crop(frame.camera.width, frame.camera.height, size);
    sampling.views.cameras.push_back(resize_crop(frame.camera, plan));
    sampling.view_names.push_back(frame.name);
  }
}

// Returns the median depth of the scene's sparse points in front of the first source view; 0 where it has none.
double typical_depth(const Scene& scene, const Camera& camera) {
  std::vector<double> depths;
  const Eigen::Isometry3d camera_from_world = camera.camera_from_world();
  for (const auto& point_in_world : scene.points_in_world) {
    const double depth = (camera_from_world * point_in_world).z();
    if (depth > 0) depths.push_back(depth);
  }
  if (depths.empty()) return 0;
  const auto middle = depths.begin() + static_cast<std::ptrdiff_t>(depths.size() / 2);
  std::nth_element(depths.begin(), middle, depths.end());
  return *middle;
}

void add_target_path(const Scene& scene, const ViewSelection& selection, SamplingScene& sampling) {
  const auto sources = sampling.views.cameras;
  PathSurroundings surroundings;
  for (const Frame& frame : scene.frames) surroundings.cameras.push_back(frame.camera);
  surroundings.typical_depth = typical_depth(scene, sources.front());
  CameraPath path = make_camera_path(selection.path, sources, surroundings);
  sampling.path_note = path.note;
  sampling.warnings.insert(sampling.warnings.end(), path.warnings.begin(), path.warnings.end());
  const std::vector<Camera>& cameras = path.cameras;
  for (size_t i = 0; i < cameras.size(); ++i) {
    // A file's cameras may have another size; those of an orbit or spline have it already.
    const auto plan = plan_resize_crop(cameras[i].width, cameras[i].height, sampling.size);
    sampling.views.cameras.push_back(resize_crop(cameras[i], plan));
    // These views have no name but that of their picture.
    const auto view = static_cast<int64_t>(sampling.view_names.size());
    sampling.view_names.push_back(
        view_name(view, sampling.views.num_sources + static_cast<int64_t>(cameras.size())));
  }
}

void visit_frames(FieldVisitor& visitor, const Field& field, std::vector<FrameChoice>& frames) {
  std::vector<std::string> texts;
  texts.reserve(frames.size());
  for (const auto& frame : frames) texts.push_back(frame.text());
  visitor.texts(field, texts);
  frames.clear();
  for (const auto& text : texts) {
    if (text.empty()) {
      fail({"--" + field.name, "frame numbers or names", "nothing between two commas", "remove one of them"});
    }
    int64_t number = 0;
    const auto end = text.data() + text.size();
    const auto parsed = std::from_chars(text.data(), end, number);
    // "007" is a name.
    if (parsed.ec == std::errc() && parsed.ptr == end && number >= 0 && std::to_string(number) == text) {
      frames.emplace_back(number);
    } else {
      frames.emplace_back(text);
    }
  }
}

void refuse_repeated(const ViewSelection& selection) {
  std::set<std::string> sources, targets;
  for (const auto& source : selection.sources) {
    if (sources.insert(source.text()).second) continue;
    fail(
        {"--sources", "each source view once", "frame " + source.text() + " twice", "remove the repetition"});
  }
  for (const auto& target : selection.targets) {
    if (sources.count(target.text()) > 0) {
      fail({"--targets", "frames that are not sources", "frame " + target.text() + ", which is a source",
            "leave it out of one of the two"});
    }
    if (targets.insert(target.text()).second) continue;
    fail(
        {"--targets", "each target view once", "frame " + target.text() + " twice", "remove the repetition"});
  }
}

void look_up(std::vector<FrameChoice>& frames, const Scene& scene, const char* flag) {
  for (auto& choice : frames) {
    if (choice.name.empty()) continue;
    const auto named = std::find_if(scene.frames.begin(), scene.frames.end(),
                                    [&](const Frame& frame) { return frame.name == choice.name; });
    if (named != scene.frames.end()) {
      choice = FrameChoice(named - scene.frames.begin());
      continue;
    }
    std::vector<std::string> names;
    for (const auto& frame : scene.frames) names.push_back(frame.name);
    const auto near = nearest_name(choice.name, names);
    fail({flag, "frames of scene '" + scene.name + "'", "'" + choice.name + "', which is none",
          near.empty() ? "gld check-data lists them" : "did you mean '" + near + "'?"});
  }
}

}  // namespace

ViewSelection looked_up(const ViewSelection& selection, const Scene& scene) {
  ViewSelection found = selection;
  look_up(found.sources, scene, "--sources");
  look_up(found.targets, scene, "--targets");
  refuse_repeated(found);
  return found;
}

ViewSelection::ViewSelection() { path.path.clear(); }

void ViewSelection::visit(FieldVisitor& visitor) {
  visit_frames(visitor, {"sources", "source views: frame numbers of the scene, from 0, or names"}, sources);
  visit_frames(visitor,
               {"targets", "target views: frame numbers or names; their images only serve to compare with"},
               targets);
  path.visit(visitor);
}

void ViewSelection::check() const {
  path.check();
  refuse_repeated(*this);
  if (!targets.empty() && !path.path.empty()) {
    fail({"--targets, --path", "either target frames or a path", "both",
          "add for example --targets 1,2, or --path orbit"});
  }
}

void ViewSelection::require_complete() const {
  if (sources.empty()) {
    fail({"--sources", "at least one source view", "none", "add for example --sources 0,3"});
  }
  if (targets.empty() && path.path.empty()) {
    fail({"--targets, --path", "either target frames or a path", "neither",
          "add for example --targets 1,2, or --path orbit"});
  }
}

SamplingScene sampling_views(const Scene& scene, const ViewSelection& asked, const ImageSize& size) {
  const ViewSelection selection = looked_up(asked, scene);
  SamplingScene sampling;
  sampling.name = scene.name;
  sampling.metric = scene.metric;
  sampling.size = size;
  sampling.warnings = scene.warnings;
  sampling.points_in_world = scene.points_in_world;
  for (const int64_t number : selection.sources) {
    const Frame& frame = frame_of(scene, number, "--sources");
    sampling.views.cameras.push_back(
        resize_crop(frame.camera, plan_resize_crop(frame.camera.width, frame.camera.height, size)));
    sampling.view_names.push_back(frame.name);
  }
  sampling.views.num_sources = sampling.views.size();
  if (selection.path.path.empty()) {
    add_target_frames(scene, selection, size, sampling);
  } else {
    add_target_path(scene, selection, sampling);
  }
  const auto camera_warnings = check_cameras(sampling.views, scene.name);
  sampling.warnings.insert(sampling.warnings.end(), camera_warnings.begin(), camera_warnings.end());
  return sampling;
}

SamplingScene load_sampling_scene(const Scene& scene, const ViewSelection& asked, const ImageSize& size) {
  const ViewSelection selection = looked_up(asked, scene);
  SamplingScene sampling = sampling_views(scene, selection, size);
  for (const int64_t number : selection.sources) {
    sampling.source_images.push_back(
        load_sized(frame_of(scene, number, "--sources"), size, FrameParts::kImage).image);
  }
  sampling.true_images.resize(static_cast<size_t>(sampling.views.num_targets()));
  sampling.true_depths.resize(sampling.true_images.size());
  if (!selection.path.path.empty()) return sampling;
  for (size_t i = 0; i < selection.targets.size(); ++i) {
    const Frame& frame = frame_of(scene, selection.targets[i], "--targets");
    const auto plan = plan_resize_crop(frame.camera.width, frame.camera.height, size);
    if (frame.has_image()) sampling.true_images[i] = resize_crop(frame.image(), plan);
    if (frame.has_depth()) sampling.true_depths[i] = resize_crop(frame.depth(), plan);
  }
  return sampling;
}

void load_source_depths(const Scene& scene, const ViewSelection& asked, SamplingScene& sampling) {
  const ViewSelection selection = looked_up(asked, scene);
  sampling.source_depths.clear();
  for (const int64_t number : selection.sources) {
    const Frame& frame = frame_of(scene, number, "--sources");
    sampling.source_depths.emplace_back();
    if (!frame.has_depth()) continue;
    sampling.source_depths.back() =
        resize_crop(frame.depth(), plan_resize_crop(frame.camera.width, frame.camera.height, sampling.size));
  }
}

int64_t largest_photograph_side(const std::string& size) {
  return size == kPhotographSize ? kLargestPhotographSide : kMatchedPhotographSide;
}

int64_t photograph_magnification(const Scene& scene, const ViewSelection& asked, int64_t largest_side,
                                 const ImageSize& size) {
  const ViewSelection selection = looked_up(asked, scene);
  int64_t times = std::max<int64_t>(1, largest_side / std::max(size.width, size.height));
  for (const int64_t number : selection.sources) {
    const Camera& camera = frame_of(scene, number, "--sources").camera;
    times = std::min({times, camera.width / size.width, camera.height / size.height});
  }
  return std::max<int64_t>(times, 1);
}

void load_source_photographs(const Scene& scene, const ViewSelection& asked, int64_t largest_side,
                             SamplingScene& sampling) {
  const ViewSelection selection = looked_up(asked, scene);
  const ImageSize& size = sampling.size;
  const int64_t times = photograph_magnification(scene, selection, largest_side, size);
  sampling.photographs.points_in_world = sampling.points_in_world;
  sampling.photographs.views.clear();
  const ImageSize large{times * size.width, times * size.height};
  for (const int64_t number : selection.sources) {
    const SizedFrame frame = load_magnified(frame_of(scene, number, "--sources"), size, times);
    PicturedView view;
    view.camera = frame.camera;
    view.width = large.width;
    view.height = large.height;
    view.rgb.reserve(frame.image.rgb.size());
    for (const uint8_t value : frame.image.rgb) view.rgb.push_back(static_cast<float>(value) / 255.0F);
    sampling.photographs.views.push_back(std::move(view));
  }
}

void load_large_true_images(const Scene& scene, const ViewSelection& asked, SamplingScene& sampling) {
  const ViewSelection selection = looked_up(asked, scene);
  const int64_t times = sampling.photographs.views.at(0).width / sampling.size.width;
  sampling.large_true_images.clear();
  sampling.large_true_images.resize(sampling.true_images.size());
  if (!selection.path.path.empty()) return;
  for (size_t i = 0; i < selection.targets.size(); ++i) {
    const Frame& frame = frame_of(scene, selection.targets[i], "--targets");
    if (!frame.has_image()) continue;
    sampling.large_true_images[i] = load_magnified(frame, sampling.size, times).image;
  }
}

ImageSize choose_size(const std::string& text, const Scene& scene,
                      const std::vector<ImageSize>& trained_sizes, int64_t patch_size) {
  ImageSize size;
  if (text == "auto" || text == kPhotographSize) {
    const Camera& camera = scene.frames.front().camera;
    size = nearest_trained_size(camera.width, camera.height, trained_sizes);
  } else {
    size = image_size_from_text(text, "--size");
  }
  if (size.width % patch_size != 0 || size.height % patch_size != 0) {
    fail({"--size", fmt::format("sides that are multiples of the patch size {}", patch_size),
          fmt::format("{}x{}", size.width, size.height),
          fmt::format("take {}x{}", std::max<int64_t>(1, size.width / patch_size) * patch_size,
                      std::max<int64_t>(1, size.height / patch_size) * patch_size)});
  }
  return size;
}

}  // namespace gld
