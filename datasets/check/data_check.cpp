#include "datasets/check/data_check.h"

#include "datasets/check/depth_warp.h"
#include "datasets/formats/file_listing.h"
#include "datasets/images/image_probe.h"
#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/printable_text.h"
#include "gld/cameras/angles.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <system_error>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <fmt/format.h>

namespace gld {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

void widen(Span& span, double value, bool first) {
  span.low = first ? value : std::min(span.low, value);
  span.high = first ? value : std::max(span.high, value);
}

double median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

Vector3d position(const Frame& frame) { return frame.camera.world_from_camera.translation(); }

void measure_cameras(const Scene& scene, DataCheck& check) {
  Vector3d centre = Vector3d::Zero();
  std::vector<double> steps;
  for (size_t i = 0; i < scene.frames.size(); ++i) {
    const Camera& camera = scene.frames[i].camera;
    const Eigen::Matrix3d& k = camera.intrinsics;
    const bool first = i == 0;
    widen(check.width, static_cast<double>(camera.width), first);
    widen(check.height, static_cast<double>(camera.height), first);
    widen(check.focal_x, k(0, 0), first);
    widen(check.focal_y, k(1, 1), first);
    widen(check.field_of_view,
          2 * std::atan(0.5 * static_cast<double>(camera.width) / k(0, 0)) * kDegreesPerRadian, first);
    centre += position(scene.frames[i]) / static_cast<double>(scene.frames.size());
    check.largest_norm = std::max(check.largest_norm, position(scene.frames[i]).norm());
    if (!first) steps.push_back((position(scene.frames[i]) - position(scene.frames[i - 1])).norm());
  }
  for (const Frame& frame : scene.frames)
    check.extent = std::max(check.extent, (position(frame) - centre).norm());
  check.median_step = median(steps);
}

bool sees(const Camera& camera, const Vector3d& point) {
  const Vector3d in_camera = camera.camera_from_world() * point;
  if (in_camera.z() <= 0) return false;
  const Vector2d pixel = (camera.intrinsics * in_camera).hnormalized();
  return pixel.x() >= 0 && pixel.y() >= 0 && pixel.x() < static_cast<double>(camera.width) &&
         pixel.y() < static_cast<double>(camera.height);
}

// Returns the share of a's view that b sees: of points, or of a grid at one distance.
double overlap_by_points(const Camera& a, const Camera& b, const std::vector<Vector3d>& points) {
  int64_t in_a = 0;
  int64_t in_both = 0;
  for (const Vector3d& point : points) {
    if (!sees(a, point)) continue;
    ++in_a;
    in_both += sees(b, point) ? 1 : 0;
  }
  return in_a > 0 ? static_cast<double>(in_both) / static_cast<double>(in_a) : 0;
}

std::vector<Vector3d> grid_at(const Camera& camera, double distance) {
  std::vector<Vector3d> points;
  const Eigen::Matrix3d ray_from_pixel = camera.intrinsics.inverse();
  for (int y = 0; y < 12; ++y) {
    for (int x = 0; x < 12; ++x) {
      const Vector3d pixel((x + 0.5) / 12 * static_cast<double>(camera.width),
                           (y + 0.5) / 12 * static_cast<double>(camera.height), 1);
      points.push_back(camera.world_from_camera * (distance * (ray_from_pixel * pixel)));
    }
  }
  return points;
}

void measure_overlap(const Scene& scene, const DataCheckOptions& options, DataCheck& check) {
  const size_t count = scene.frames.size();
  if (count < 2) return;
  const bool depth = check.frames_with_depth == check.frames;
  const double distance = check.poses.median_depth;
  if (!depth && scene.points_in_world.empty() && distance <= 0) return;
  check.overlap_method = depth                            ? "by depth"
                         : !scene.points_in_world.empty() ? "by sparse points"
                                                          : "at the depth of matched points";
  const size_t pairs = std::min<size_t>(count - 1, static_cast<size_t>(depth ? options.most_pairs : 100));
  double sum = 0;
  for (size_t i = 0; i < pairs; ++i) {
    const Frame& a = scene.frames[i * (count - 1) / pairs];
    const Frame& b = scene.frames[i * (count - 1) / pairs + 1];
    if (depth) {
      sum += warp_depth({a.camera, a.depth()}, {b.camera, b.depth()}, 0.05).share_in_view;
    } else {
      sum += overlap_by_points(
          a.camera, b.camera,
          scene.points_in_world.empty() ? grid_at(a.camera, distance) : scene.points_in_world);
    }
  }
  check.mean_overlap = sum / static_cast<double>(pairs);
}

// Looks at all frames, without decoding them.
void look_for_cut_images(const Scene& scene, DataCheck& check) {
  constexpr int64_t kMostNamed = 3;
  int64_t cut = 0;
  for (const Frame& frame : scene.frames) {
    if (!is_image_name(frame.image_file)) continue;
    ++check.image_files;
    try {
      check_image_end(frame.image_file);
    } catch (const Error& error) {
      if (++cut <= kMostNamed) check.problems.emplace_back(error.what());
    }
  }
  if (cut > kMostNamed) {
    check.problems.push_back(fmt::format("{} more image files are broken.", cut - kMostNamed));
  }
}

// Decodes some frames evenly spread over the scene.
void load_some(const Scene& scene, const DataCheckOptions& options, DataCheck& check) {
  const size_t count = scene.frames.size();
  const size_t wanted = std::min<size_t>(count, static_cast<size_t>(options.most_images));
  bool any_depth = false;
  for (size_t i = 0; i < wanted; ++i) {
    const Frame& frame = scene.frames[i * count / wanted];
    try {
      if (frame.has_image()) {
        frame.image();
        ++check.decoded_images;
      }
      if (!frame.has_depth()) continue;
      for (float value : frame.depth().metres) {
        if (value <= 0) continue;
        widen(check.depth, value, !any_depth);
        any_depth = true;
      }
    } catch (const Error& error) {
      // A file that ends early has been named.
      const std::string file = frame.image_file.string();
      const bool named = !file.empty() &&
                         std::any_of(check.problems.begin(), check.problems.end(),
                                     [&](const std::string& problem) { return problem.rfind(file, 0) == 0; });
      if (!named) check.problems.emplace_back(error.what());
    }
  }
}

void look_for_turned_images(const Scene& scene, DataCheck& check) {
  std::map<int, int64_t> orientations;
  std::string example;
  for (const Frame& frame : scene.frames) {
    if (frame.image_file.empty() || frame.image_file.extension() == ".hdf5") continue;
    const ImageFileInfo info = probe_image_file(frame.image_file);
    if (info.orientation == 1) continue;
    ++orientations[info.orientation];
    ++check.turned_images;
    const bool applied = info.turned() && info.width != frame.camera.width;
    example = fmt::format("{} is stored as {}x{} and the camera is {}x{}, so the rotation is {}",
                          frame.image_file.filename().string(), info.width, info.height, frame.camera.width,
                          frame.camera.height, applied ? "applied" : "ignored");
  }
  for (const auto& [orientation, count] : orientations) {
    check.notes.push_back(fmt::format("{} of {} images ask for a rotation by EXIF (orientation {}): {}.",
                                      count, check.frames, orientation, example));
  }
}

// Links are followed; who did not make the folder should know where they lead.
void look_for_links(const Scene& scene, DataCheck& check) {
  if (scene.folder.empty()) return;
  std::error_code error;
  // RealEstate10K's scene is a file, whose frames may lie beside its folder.
  const bool is_folder = std::filesystem::is_directory(scene.folder, error);
  const auto scene_path = std::filesystem::absolute(scene.folder);
  const auto folder = is_folder ? scene_path : scene_path.parent_path();
  const auto real_folder = std::filesystem::canonical(folder, error);
  if (error) return;
  const auto is_below = [](const std::filesystem::path& file, const std::filesystem::path& base) {
    const auto relative = file.lexically_normal().lexically_relative(base.lexically_normal());
    return !relative.empty() && *relative.begin() != "..";
  };
  int64_t outside = 0;
  std::string first;
  for (const Frame& frame : scene.frames) {
    if (frame.image_file.empty() || !is_below(std::filesystem::absolute(frame.image_file), folder)) continue;
    const auto real = std::filesystem::canonical(frame.image_file, error);
    if (error || is_below(real, real_folder)) continue;
    if (outside++ == 0) first = frame.image_file.string() + " is " + real.string();
  }
  if (outside == 0) return;
  check.notes.push_back(printable_text(
      fmt::format("{} of {} images are links to places outside the scene's folder, which are followed: {}.",
                  outside, check.frames, first)));
}

void look_at_principal_point(const Scene& scene, DataCheck& check) {
  int64_t turned = 0;
  for (const Frame& frame : scene.frames) {
    const Camera& camera = frame.camera;
    const auto width = static_cast<double>(camera.width);
    const auto height = static_cast<double>(camera.height);
    if (std::abs(width - height) < 0.1 * width) continue;
    const Vector2d principal(camera.intrinsics(0, 2), camera.intrinsics(1, 2));
    const double to_middle = (principal - Vector2d(0.5 * width, 0.5 * height)).norm();
    const double to_turned = (principal - Vector2d(0.5 * height, 0.5 * width)).norm();
    if (to_turned < 0.05 * width && to_turned < 0.3 * to_middle) ++turned;
  }
  if (2 * turned <= check.frames) return;
  const Camera& camera = scene.frames.front().camera;
  check.problems.push_back(
      fmt::format("The intrinsics seem to belong to images turned by a quarter: "
                  "the principal point ({:.1f}, {:.1f}) is the middle of {}x{}, not of {}x{}; "
                  "rotate the images (EXIF) or the intrinsics.",
                  camera.intrinsics(0, 2), camera.intrinsics(1, 2), camera.height, camera.width, camera.width,
                  camera.height));
}

bool stands_still(const DataCheck& check) { return check.frames > 1 && check.extent < 1e-9; }

void look_at_places(const Scene& scene, const DataCheckOptions& options, DataCheck& check) {
  const int64_t outliers = std::count_if(scene.frames.begin(), scene.frames.end(), [&](const Frame& frame) {
    return position(frame).norm() > options.max_translation_norm;
  });
  if (outliers > 0) {
    check.problems.push_back(
        fmt::format("{} of {} cameras are farther from the origin than {} (max_translation_norm), "
                    "the farthest at {:.4g}; training refuses them.",
                    outliers, check.frames, options.max_translation_norm, check.largest_norm));
  }
  if (stands_still(check)) {
    check.problems.emplace_back(
        "All cameras are at the same place: without parallax there is no geometry to learn.");
  }
}

void look_at_poses(const Scene& scene, const DataCheckOptions& options, DataCheck& check) {
  if (stands_still(check)) return;
  check.poses = test_pose_meanings(scene, options.most_pairs);
  const PoseMeaning best = check.poses.best();
  if (best == PoseMeaning::kAsRead) return;
  check.problems.push_back(
      fmt::format("The poses look like {}: {:.0f} % of {} comparisons ({}) agree then, {:.0f} % as read; "
                  "convert them or choose another format.",
                  pose_meaning_text(best), 100 * check.poses.evidence[static_cast<size_t>(best)].agreement,
                  check.poses.comparisons, check.poses.method, 100 * check.poses.evidence.front().agreement));
}

}  // namespace

DataCheckOptions::DataCheckOptions() { reading.broken_frames = BrokenFrames::kSkip; }

void DataCheckOptions::visit(FieldVisitor& visitor) {
  visitor.group({"reading", "how scenes are read"}, reading);
  visit_out(visitor, out, overwrite);
  visit_json(visitor, json);
  visitor.integer({"most_scenes",
                   "of a folder of scenes, checked to their pixels; the others by cameras and image files"},
                  most_scenes, {1, 1'000'000});
  visitor.integer({"most_images", "decoded in each scene"}, most_images, {0, 1'000'000});
  visitor.integer({"most_pairs", "of neighbouring frames compared"}, most_pairs, {1, 1000});
  visitor.real({"max_translation_norm", "cameras farther from the origin are reported"}, max_translation_norm,
               {0});
}

DataCheck check_scene(const Scene& scene, const DataCheckOptions& options, CheckDepth depth) {
  DataCheck check;
  check.depth_of_check = depth;
  check.scene = scene.name;
  check.format = scene.format;
  check.frames = static_cast<int64_t>(scene.frames.size());
  for (const Frame& frame : scene.frames) {
    check.list.push_back({frame.name, frame.camera.width, frame.camera.height});
  }
  check.missing_files = scene.missing_files;
  check.broken_frames = scene.broken_frames;
  check.notes = scene.warnings;
  check.frames_with_depth = std::count_if(scene.frames.begin(), scene.frames.end(),
                                          [](const Frame& frame) { return frame.has_depth(); });
  measure_cameras(scene, check);
  look_for_cut_images(scene, check);
  if (depth == CheckDepth::kPixels) load_some(scene, options, check);
  const bool pictures = std::any_of(scene.frames.begin(), scene.frames.end(),
                                    [](const Frame& frame) { return frame.has_image(); });
  if (!pictures) {
    check.problems.emplace_back("No frame has a picture: gld sample and gld train have nothing to look at.");
  }
  look_for_turned_images(scene, check);
  look_for_links(scene, check);
  look_at_principal_point(scene, check);
  if (!check.problems.empty()) return check;  // comparing pixels of images that cannot be loaded helps nobody
  look_at_places(scene, options, check);
  if (depth == CheckDepth::kFiles) return check;
  try {
    look_at_poses(scene, options, check);
    measure_overlap(scene, options, check);
  } catch (const Error& error) {  // a frame beyond most_images that cannot be decoded
    check.problems.emplace_back(error.what());
    return check;
  }
  if (check.mean_overlap >= 0 && check.mean_overlap < 0.3 && check.poses.best() == PoseMeaning::kAsRead) {
    check.notes.push_back(
        fmt::format("Neighbouring frames share only {:.0f} % of what they see.", 100 * check.mean_overlap));
  }
  return check;
}

namespace {

// Adds what a command says that refuses broken frames.
void name_first_broken_frame(const SceneLocation& location, SceneReading reading, DataCheck& check) {
  reading.broken_frames = BrokenFrames::kRefuse;
  try {
    open_scene(location.path, reading);
  } catch (const Error& error) {
    check.problems.emplace_back(error.what());
  }
}

}  // namespace

DataCheck check_scene(const SceneLocation& location, const DataCheckOptions& options, CheckDepth depth) {
  SceneReading reading = options.reading;
  reading.part = location.part;
  try {
    DataCheck check = check_scene(open_scene(location.path, reading), options, depth);
    if (check.broken_frames > 0) name_first_broken_frame(location, reading, check);
    return check;
  } catch (const Error& error) {
    DataCheck check;
    check.depth_of_check = depth;
    check.scene = location.path.string();
    check.format = "unreadable";
    check.problems.emplace_back(error.what());
    return check;
  }
}

}  // namespace gld
