#include "datasets/formats/nerfstudio_reader.h"

#include "datasets/formats/depth_files.h"
#include "datasets/formats/file_listing.h"
#include "datasets/formats/frame_pixels.h"
#include "datasets/formats/json_file.h"
#include "datasets/scenes/frame_checks.h"
#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>

#include <Eigen/LU>
#include <fmt/format.h>

namespace gld {
namespace {

using nlohmann::json;

std::filesystem::path transforms_file(const std::filesystem::path& path) {
  for (const auto& file : {path, path / "transforms.json", path / "transforms_train.json",
                           path / "nerfstudio" / "transforms.json"}) {
    if (file.extension() == ".json" && is_file(file)) return file;
  }
  return {};
}

// Per-frame values win over shared ones.
class Settings {
 public:
  Settings(const json& shared, const json& frame, std::string where)
      : shared_(shared), frame_(frame), where_(std::move(where)) {}
  bool has(const std::string& key) const { return frame_.contains(key) || shared_.contains(key); }
  double number(const std::string& key) const { return json_number(owner(key), key, where_); }
  double number_or(const std::string& key, double otherwise) const {
    return has(key) ? number(key) : otherwise;
  }
  int64_t integer_or(const std::string& key, int64_t otherwise) const {
    return has(key) ? json_integer(owner(key), key, where_) : otherwise;
  }
  std::string text_or(const std::string& key, const std::string& otherwise) const {
    return has(key) ? json_text(owner(key), key, where_) : otherwise;
  }
  // instant-ngp's way of choosing a lens.
  bool is_set(const std::string& key) const {
    return has(key) && owner(key).at(key).is_boolean() && owner(key).at(key).get<bool>();
  }
  const std::string& where() const { return where_; }

 private:
  const json& owner(const std::string& key) const { return frame_.contains(key) ? frame_ : shared_; }
  const json& shared_;
  const json& frame_;
  std::string where_;
};

LensDistortion lens_of(const Settings& settings) {
  const std::string model =
      settings.text_or("camera_model", settings.is_set("is_fisheye") ? "OPENCV_FISHEYE" : "OPENCV");
  LensDistortion lens;
  lens.k1 = settings.number_or("k1", 0);
  lens.k2 = settings.number_or("k2", 0);
  lens.k3 = settings.number_or("k3", 0);
  lens.k4 = settings.number_or("k4", 0);
  lens.p1 = settings.number_or("p1", 0);
  lens.p2 = settings.number_or("p2", 0);
  if (model == "OPENCV_FISHEYE") {
    lens.model = LensModel::kFisheye;
    return lens;
  }
  if (model != "OPENCV" && model != "PINHOLE" && model != "SIMPLE_PINHOLE") {
    fail({settings.where(), "camera_model OPENCV, OPENCV_FISHEYE, PINHOLE or SIMPLE_PINHOLE", model,
          "undistort the images first"});
  }
  if (lens.k4 != 0) {
    // nerfstudio takes it as the fourth radial term, OpenCV as the first of a denominator.
    fail({settings.where(), "k4 = 0 for camera_model " + model, std::to_string(lens.k4),
          "use OPENCV_FISHEYE or undistort the images first"});
  }
  lens.model = LensModel::kRadialTangential;
  return lens;
}

double focal_from_angle(double angle, int64_t pixels) {
  return 0.5 * static_cast<double>(pixels) / std::tan(0.5 * angle);
}

void set_intrinsics(FrameRecord& record, const Settings& settings) {
  record.camera_width = settings.integer_or("w", 0);
  record.camera_height = settings.integer_or("h", 0);
  if (record.camera_width == 0 || record.camera_height == 0) {
    const FittedImage stored = fit_image(record.image_file, 0, 0);
    record.camera_width = stored.width;
    record.camera_height = stored.height;
  }
  double fx = 0;
  if (settings.has("fl_x")) {
    fx = settings.number("fl_x");
  } else if (settings.has("camera_angle_x")) {
    fx = focal_from_angle(settings.number("camera_angle_x"), record.camera_width);
  } else {
    fail({settings.where(), "fl_x or camera_angle_x", "neither", "add the focal length"});
  }
  double fy = fx;
  if (settings.has("fl_y")) {
    fy = settings.number("fl_y");
  } else if (settings.has("camera_angle_y")) {
    fy = focal_from_angle(settings.number("camera_angle_y"), record.camera_height);
  }
  record.intrinsics =
      intrinsic_matrix(fx, fy, settings.number_or("cx", 0.5 * static_cast<double>(record.camera_width)),
                       settings.number_or("cy", 0.5 * static_cast<double>(record.camera_height)));
}

// Returns where a listed file really is, or empty. The suffix may be missing (Blender), the folder replaced by images_N
// (DL3DV).
std::filesystem::path find_listed(const std::filesystem::path& folder, const std::string& listed,
                                  const std::filesystem::path& image_folder, const std::string& where) {
  auto file = inside(folder, listed, where);
  if (image_folder.empty()) {
    if (is_file(file)) return file;
    if (!is_image_name(file)) return find_image(file.parent_path(), file.filename().string());
    return {};
  }
  auto moved = image_folder / file.filename();
  if (is_file(moved)) return moved;
  return find_image(image_folder, file.stem().string());
}

// Returns the folder to take images from in place of the listed one; empty when the listed one is used.
std::filesystem::path replacement_folder(const std::filesystem::path& folder, const json& frames,
                                         const std::string& asked_for, const std::string& where) {
  if (!asked_for.empty()) return find_image_folder(folder, asked_for);
  for (size_t i = 0; i < frames.size(); ++i) {
    const json& frame = frames[i];
    if (!frame.is_object() || !frame.contains("file_path") || !frame["file_path"].is_string()) continue;
    const std::string frame_where = where + " frame " + std::to_string(i);
    if (!find_listed(folder, frame["file_path"].get<std::string>(), {}, frame_where).empty()) return {};
  }
  return find_image_folder(folder, {});
}

// listed_world_from_world as applied_transform and applied_scale give it.
struct AppliedTransform {
  Eigen::Matrix4d world_from_listed = Eigen::Matrix4d::Identity();
  double scale = 1;
};

AppliedTransform applied_transform(const json& file, const std::string& where) {
  AppliedTransform applied;
  if (file.contains("applied_transform")) {
    const Eigen::Matrix4d transform = json_pose(file["applied_transform"], where + " applied_transform");
    if (!transform.allFinite() || std::abs(transform.determinant()) < 1e-9) {
      fail({where, "an applied_transform that can be inverted", "a singular one", "correct or remove it"});
    }
    applied.world_from_listed = transform.inverse();
  }
  applied.scale = json_number_or(file, "applied_scale", 1, where);
  if (!(applied.scale > 0) || !std::isfinite(applied.scale)) {
    fail({where, "a positive applied_scale", std::to_string(applied.scale), "correct or remove it"});
  }
  return applied;
}

Eigen::Isometry3d pose_of_matrix(const json& rows, const AppliedTransform& applied,
                                 const std::string& where) {
  Eigen::Matrix4d listed = json_pose(rows, where + " transform_matrix");
  listed.topRightCorner<3, 1>() /= applied.scale;
  return opencv_from_opengl_pose(checked_pose(applied.world_from_listed * listed, where));
}

// Depth is in the unit that poses have without applied_scale: nerfstudio multiplies both by it. unit: what the file
// says that a step is; without a word a .npy is in that unit, and a PNG in thousandths of it.
std::function<DepthMap()> depth_loader(const std::filesystem::path& file, std::optional<double> unit) {
  return [file, unit] {
    if (file.extension() != ".npy") return read_depth_png(file, unit.value_or(1e-3));
    DepthMap depth = read_depth_npy(file);
    if (unit) {
      for (float& value : depth.metres) value = static_cast<float>(value * *unit);
    }
    return depth;
  };
}

// Returns the numbers of the frames in the order of their files' names, in which frames are counted; those without one
// keep their place.
std::vector<size_t> in_order_of_names(const json& frames) {
  std::vector<std::string> names;
  for (const json& frame : frames) {
    const auto listed = frame.is_object() ? frame.find("file_path") : frame.end();
    names.push_back(
        frame.is_object() && listed != frame.end() && listed->is_string() ? listed->get<std::string>() : "");
  }
  std::vector<size_t> order(names.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t a, size_t b) { return natural_less(names[a], names[b]); });
  return order;
}

}  // namespace

bool NerfstudioReader::recognises(const std::filesystem::path& path) const {
  const auto file = transforms_file(path);
  if (file.empty()) return false;
  try {
    const json content = read_json_file(file);
    return content.is_object() && content.contains("frames") && content["frames"].is_array() &&
           !content["frames"].empty() && content["frames"][0].is_object() &&
           content["frames"][0].contains("file_path");
  } catch (const Error&) {
    // A damaged transforms.json is still one: reading it gives the reason.
    return file.filename().string().rfind("transforms", 0) == 0;
  }
}

Scene NerfstudioReader::read(const std::filesystem::path& path, const SceneReading& reading) const {
  const auto file = transforms_file(path);
  if (file.empty())
    fail({path.string(), "transforms.json", "none", "check the folder or choose another format"});
  const std::filesystem::path folder = file.parent_path();
  const json content = read_json_file(file);
  const std::string where = file.string();
  if (!content.is_object() || !content.contains("frames") || !content["frames"].is_array()) {
    fail({where, "a list \"frames\"", "none", "check the file"});
  }
  const json& frames = content["frames"];
  const AppliedTransform applied = applied_transform(content, where);
  const auto image_folder = replacement_folder(folder, frames, reading.image_folder, where);

  SceneBuilder builder(name(), folder.filename() == "nerfstudio" ? folder.parent_path() : folder, reading);
  FrameMaker maker;
  const auto depth_unit = content.contains("depth_unit_scale_factor")
                              ? std::optional(json_number(content, "depth_unit_scale_factor", where))
                              : std::nullopt;
  if (depth_unit && !(*depth_unit > 0 && std::isfinite(*depth_unit))) {
    fail({where, "a positive \"depth_unit_scale_factor\"", fmt::format("{:g}", *depth_unit), "correct it"});
  }
  for (const size_t i : in_order_of_names(frames)) {
    const json& frame = frames[i];
    const std::string frame_where = where + " frame " + std::to_string(i);
    builder.add(frame_where, [&]() -> std::optional<Frame> {
      const std::string listed = json_text(frame, "file_path", frame_where);
      FrameRecord record;
      record.image_file = find_listed(folder, listed, image_folder, frame_where);
      if (record.image_file.empty()) {
        builder.add_missing(folder / listed);
        return std::nullopt;
      }
      const Settings settings(content, frame, frame_where);
      record.name = record.image_file.stem().string();
      set_intrinsics(record, settings);
      record.lens = lens_of(settings);
      if (!frame.contains("transform_matrix")) {
        fail({frame_where, "the key \"transform_matrix\"", "none", "add it"});
      }
      record.world_from_camera = pose_of_matrix(frame["transform_matrix"], applied, frame_where);
      if (frame.contains("depth_file_path")) {
        const auto depth = inside(folder, json_text(frame, "depth_file_path", frame_where), frame_where);
        record.load_depth = depth_loader(depth, depth_unit);
      }
      if (frame.contains("mask_path")) {
        const auto mask = inside(folder, json_text(frame, "mask_path", frame_where), frame_where);
        record.load_validity = [mask] { return read_mask(mask); };
      }
      return maker.make(record);
    });
  }
  Scene& scene = builder.scene();
  std::sort(scene.frames.begin(), scene.frames.end(), [](const Frame& a, const Frame& b) {
    return natural_less(a.image_file.string(), b.image_file.string());
  });
  builder.warn(maker.crop_note());
  return builder.finish();
}

}  // namespace gld
