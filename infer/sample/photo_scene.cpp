#include "infer/sample/photo_scene.h"

#include "datasets/formats/cameras_json.h"
#include "datasets/formats/depth_files.h"
#include "datasets/formats/file_listing.h"
#include "datasets/images/image_file.h"
#include "datasets/images/image_probe.h"
#include "datasets/registration/colmap_registration.h"
#include "datasets/registration/feature_registration.h"
#include "datasets/registration/registered_lenses.h"
#include "datasets/scenes/resize_crop.h"
#include "datasets/video/video_frames.h"
#include "gld/base/error.h"
#include "gld/cameras/resized_camera.h"
#include "gld/machine/block_memory.h"
#include "gld/report/shell_word.h"
#include "infer/export/image_export.h"
#include "infer/forecast/sampling_plan.h"
#include "infer/pipeline/geometry_of_pictures.h"
#include "infer/request/scene_request.h"
#include "models/scene_geometry/source_warp.h"

#include <algorithm>
#include <exception>
#include <filesystem>
#include <map>
#include <set>
#include <tuple>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

// Returns the folders in a folder that hold photographs.
std::vector<std::filesystem::path> folders_of_photographs(const std::filesystem::path& folder) {
  std::vector<std::filesystem::path> folders;
  if (!std::filesystem::is_directory(folder)) return folders;
  for (const auto& inner : list_folders(folder)) {
    if (!list_images(inner).empty()) folders.push_back(inner);
  }
  return folders;
}

std::vector<std::filesystem::path> photograph_files(const PhotoSelection& selection,
                                                    const std::filesystem::path& frames_folder) {
  std::vector<std::filesystem::path> files;
  for (const std::string& photo : selection.files) {
    const std::filesystem::path path = photo;
    if (std::filesystem::is_regular_file(path) && is_video_name(path)) {
      const auto frames = sharpest_frames(path, selection.frames, frames_folder);
      files.insert(files.end(), frames.begin(), frames.end());
      continue;
    }
    if (std::filesystem::is_regular_file(path)) {
      files.push_back(path);
      continue;
    }
    const auto listed = list_images(path);
    if (listed.empty()) {
      const bool is_there = std::filesystem::exists(path);
      if (const auto folders = folders_of_photographs(path); !folders.empty()) {
        fail({photo, "a photograph, or a folder of them",
              fmt::format("{} of photographs in it, and no photograph itself",
                          folders.size() == 1 ? "a folder" : std::to_string(folders.size()) + " folders"),
              "give the photographs of one place, for example --photos " +
                  shell_word(folders.front().string())});
      }
      fail({photo, "a photograph, or a folder of them", is_there ? "none" : "nothing",
            is_there ? "put JPEG, HEIC, PNG, WebP or TIFF files there" : "check the name"});
    }
    files.insert(files.end(), listed.begin(), listed.end());
  }
  return files;
}

// Numbers photographs by their lens.
class LensNumbers {
 public:
  explicit LensNumbers(PhotoLens lens) : lens_(lens) {}
  int64_t of(const Photograph& photograph) {
    if (lens_ == PhotoLens::kShared) return 0;
    if (lens_ == PhotoLens::kOwn) return next_++;
    // A camera held upright turns its pictures. One that zooms between two pictures is as good as two lenses.
    const std::tuple kind(std::min(photograph.width, photograph.height),
                          std::max(photograph.width, photograph.height), photograph.focal_length);
    const auto [entry, is_new] = by_kind_.try_emplace(kind, next_);
    if (is_new) ++next_;
    return entry->second;
  }

 private:
  PhotoLens lens_;
  int64_t next_ = 0;
  std::map<std::tuple<int64_t, int64_t, double>, int64_t> by_kind_;
};

std::vector<std::string> names_of(const Scene& scene) {
  std::vector<std::string> names;
  for (const Frame& frame : scene.frames) names.push_back(frame.name);
  return names;
}

// Features are taken where they find all cameras without a doubt: on the photographs of
// tests/shared/shared_registration_test.cpp they are as right as COLMAP, of small pictures from near places more so,
// and some five times as fast. Else it is whichever of the two finds more, of those that the selection allows; without
// one the model's rays are left, or an Error of the last way.
void register_photographs(PhotoScene& made, const PhotoSceneRequest& request) {
  const PhotoCameraWay asked = request.selection.cameras;
  const bool automatic = asked == PhotoCameraWay::kAutomatic;
  const std::string where = automatic ? "--photos" : "--photo-cameras";
  std::exception_ptr by_features;
  if (asked != PhotoCameraWay::kColmap) {
    FeatureRegistrationOptions options;
    options.threads = request.threads;
    try {
      made.registration = register_by_features(made.photographs, options, where);
    } catch (const Error& error) {
      if (!automatic) throw;
      by_features = std::current_exception();
      made.passed_over.push_back(std::string("features found no cameras: ") + error.what());
    }
    const bool whole = made.registration && made.registration->doubts.empty() &&
                       made.registration->registered() == static_cast<int64_t>(made.photographs.size());
    if (!automatic || whole) return;
  }
  ColmapRegistrationOptions options;
  options.program = found_colmap();
  options.keeps_failures = !automatic;
  options.threads = request.threads;
  if (!options.program.empty()) {
    try {
      Registration found = register_by_colmap(made.photographs, options, where);
      const int64_t registered = made.registration ? made.registration->registered() : 0;
      if (!automatic || (found.registered() > registered && found.doubts.empty())) {
        if (registered > 0) {
          made.passed_over.push_back(fmt::format("features found cameras of {} photographs, COLMAP of {}",
                                                 registered, found.registered()));
        }
        made.registration = std::move(found);
      }
    } catch (const Error& error) {
      if (!automatic) throw;
      made.passed_over.push_back(std::string("COLMAP found no cameras: ") + error.what());
    }
  } else if (!automatic) {
    fail({where, "the program colmap on the PATH", "none",
          "install it (on Debian: apt install colmap), or take --photo-cameras features"});
  }
  if (!made.registration && !request.geometry) std::rethrow_exception(by_features);
}

// Returns what a photograph of that size is kept at.
ImageSize kept_size(int64_t width, int64_t height, const PhotoSceneRequest& request) {
  const ImageSize& size = request.size;
  const int64_t times =
      std::max<int64_t>(1, std::min({request.largest_side / std::max(size.width, size.height),
                                     width / size.width, height / size.height}));
  return {times * size.width, times * size.height};
}

// Makes a frame for each photograph that registered, with distortion undone.
void take_registered(PhotoScene& made, const PhotoSceneRequest& request) {
  std::vector<Frame> frames;
  for (size_t i = 0; i < made.photographs.size(); ++i) {
    const RegisteredPhotograph& found = made.registration->photographs[i];
    if (!found.registered) continue;
    const IdealPhotograph ideal =
        ideal_photograph(found, read_image(made.photographs[i].file, ImageOrientation::kUpright));
    const ResizeCrop plan = plan_resize_crop(ideal.camera.width, ideal.camera.height,
                                             kept_size(ideal.camera.width, ideal.camera.height, request));
    Frame frame = made.scene.frames[i];
    frame.camera = resize_crop(ideal.camera, plan);
    made.images.push_back(resize_crop(ideal.image, plan));
    frame.load_image = [image = made.images.back()] { return image; };
    frames.push_back(std::move(frame));
  }
  made.scene.frames = std::move(frames);
  made.scene.points_in_world = made.registration->points_in_world;
  made.median_depth = 1;  // the unit of a registration
  made.text = registration_text(*made.registration, made.photographs);
  made.scene.warnings = registration_warnings(*made.registration, made.photographs);
}

void take_seen(PhotoScene& made, const PhotoSceneRequest& request, StageRecords& stages) {
  std::vector<PhotographLens> lenses;
  torch::Tensor photographs;
  std::vector<Image> small;
  GeometryOutput seen;
  stages.run(kPhotoCamerasStage, [&] {
    // One photograph at a time: as taken, they may be a hundred times as large as what the model sees.
    for (const UnregisteredPhotograph& photograph : made.photographs) {
      const Image original = read_image(photograph.file, ImageOrientation::kUpright);
      const ResizeCrop plan = plan_resize_crop(original.width, original.height, request.size);
      small.push_back(resize_crop(original, plan));
      const ImageSize kept = kept_size(original.width, original.height, request);
      made.images.push_back(resize_crop(original, magnified(plan, kept.width / request.size.width)));
      const double taken_pixels =
          static_cast<double>(plan.window_width) / static_cast<double>(plan.resized_width);
      lenses.push_back({photograph.lens,
                        static_cast<double>(std::max(original.width, original.height)) / taken_pixels,
                        exif_focal_length(made.photographs, photograph.lens), taken_pixels});
    }
    photographs = stacked(small);
    seen = geometry_of_pictures(request.geometry(), photographs, GeometryMaps::kDepthAndRays, request.device);
    require_finite_geometry(seen, "the geometry of the photographs");
  });
  stages.run("fitting cameras", [&] { made.seen = photo_cameras(seen, photographs, lenses); });
  for (size_t i = 0; i < made.scene.frames.size(); ++i) {
    made.scene.frames[i].camera =
        resized_camera(made.seen->cameras[i], made.images[i].width, made.images[i].height);
    made.scene.frames[i].load_image = [image = made.images[i]] { return image; };
  }
  made.median_depth = made.seen->median_depth;
  if (made.photographs.size() == 1) {
    made.depth = SourceDepth();
    made.depth->views = depth_in_unit(seen, 1, 1);
    made.depth->from = "geometry head";
  }
  made.text = photo_cameras_text(*made.seen, names_of(made.scene));
  for (const std::string& sentence : made.passed_over) made.scene.warnings.push_back(sentence);
  for (const std::string& doubt : made.seen->doubts()) {
    made.scene.warnings.push_back("the cameras estimated from the photographs are not sure: " + doubt);
  }
}

}  // namespace

std::vector<Photograph> list_photographs(const PhotoSelection& selection,
                                         const std::filesystem::path& frames_folder) {
  std::vector<Photograph> photographs;
  std::set<std::string> names;
  for (const auto& file : photograph_files(selection, frames_folder)) {
    Photograph photograph;
    photograph.name = file.stem().string();
    photograph.file = file;
    if (!names.insert(photograph.name).second) {
      fail({"--photos", "photographs of different names", "'" + photograph.name + "' twice",
            "rename one of them"});
    }
    const ImageFileInfo header = probe_image_file(file);
    photograph.width = header.turned() ? header.height : header.width;
    photograph.height = header.turned() ? header.width : header.height;
    photograph.focal_length = header.focal_length;
    photographs.push_back(std::move(photograph));
  }
  return photographs;
}

Scene scene_before_cameras(const std::vector<Photograph>& photographs) {
  Scene scene;
  scene.name = "photographs";
  scene.format = "photos";
  for (const Photograph& photograph : photographs) {
    Frame frame;
    frame.name = photograph.name;
    frame.image_file = photograph.file;
    frame.camera.width = photograph.width;
    frame.camera.height = photograph.height;
    const auto width = static_cast<double>(photograph.width), height = static_cast<double>(photograph.height);
    frame.camera.intrinsics(0, 0) = frame.camera.intrinsics(1, 1) = std::max(width, height);
    frame.camera.intrinsics(0, 2) = width / 2;
    frame.camera.intrinsics(1, 2) = height / 2;
    frame.camera.world_from_camera.translation().x() = static_cast<double>(scene.frames.size());
    scene.frames.push_back(std::move(frame));
  }
  return scene;
}

bool only_rays(const PhotoSelection& selection, size_t photographs) {
  return selection.cameras == PhotoCameraWay::kRays ||
         (selection.cameras == PhotoCameraWay::kAutomatic && photographs < 2);
}

PhotoScene photo_scene(const std::vector<Photograph>& taken, const PhotoSceneRequest& request,
                       StageRecords& stages) {
  PhotoScene made;
  LensNumbers numbers(request.selection.lens);
  for (const Photograph& photograph : taken) {
    made.photographs.push_back({photograph.name, photograph.file, photograph.width, photograph.height,
                                numbers.of(photograph), photograph.focal_length});
  }
  if (!only_rays(request.selection, taken.size())) {
    stages.run("registering photographs", [&] { register_photographs(made, request); });
    trim_heap();  // of pyramids of pictures, which are larger than a small model
  }
  made.scene = scene_before_cameras(taken);
  if (made.registration) {
    take_registered(made, request);
  } else {
    take_seen(made, request, stages);
  }
  std::string passed_over;
  for (const std::string& sentence : made.passed_over) passed_over += sentence + "\n";
  made.text = passed_over + made.text;
  return made;
}

void write_photo_scene(RunFolder& run, const PhotoScene& photos, const Provenance& provenance) {
  const auto folder = run.subfolder("photo_scene");
  CameraList list;
  for (size_t i = 0; i < photos.images.size(); ++i) {
    CameraRecord record;
    record.name = photos.scene.frames[i].name;
    record.camera = photos.scene.frames[i].camera;
    record.image = record.name + ".png";
    export_image(folder / record.image, photos.images[i], provenance);
    list.records.push_back(record);
  }
  const auto& points = photos.scene.points_in_world;
  if (!points.empty()) {
    list.points = "points.npy";
    write_points_npy(folder / list.points, points);
  }
  write_cameras_json(folder / "cameras.json", list);
  run.note("photographs with cameras", "photo_scene");
}

nlohmann::ordered_json photo_scene_json(const PhotoScene& photos) {
  nlohmann::ordered_json json{{"from", "rays"}};
  if (photos.registration) {
    json = registration_json(*photos.registration, photos.photographs);
  } else {
    json.update(photo_cameras_json(*photos.seen, names_of(photos.scene)));
  }
  json["passed_over"] = photos.passed_over;
  return json;
}

}  // namespace gld
