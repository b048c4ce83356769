#include "datasets/formats/cameras_json.h"

#include "datasets/formats/file_listing.h"
#include "datasets/formats/json_file.h"
#include "datasets/scenes/frame_checks.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"

#include <cmath>
#include <set>

#include <nlohmann/json.hpp>

namespace gld {
namespace {

using nlohmann::json;
using nlohmann::ordered_json;

constexpr const char* kFormat = "gld cameras 1";

std::string text_or_empty(const json& object, const std::string& key, const std::string& where) {
  return object.contains(key) ? json_text(object, key, where) : std::string();
}

CameraRecord parse_record(const json& object, const std::string& where) {
  CameraRecord record;
  record.name = json_text(object, "name", where);
  if (record.name.empty()) fail({where, "a name", "an empty one", "name the frame"});
  record.role = text_or_empty(object, "role", where);
  if (!record.role.empty() && record.role != "source" && record.role != "target") {
    fail({where, "the role source or target", record.role, "correct it or leave it out"});
  }
  record.camera.width = json_integer(object, "width", where);
  record.camera.height = json_integer(object, "height", where);
  record.camera.intrinsics =
      intrinsic_matrix(json_number(object, "fx", where), json_number(object, "fy", where),
                       json_number(object, "cx", where), json_number(object, "cy", where));
  const auto pose = object.find("world_from_camera");
  if (pose == object.end()) fail({where, "the key \"world_from_camera\"", "none", "add it"});
  record.camera.world_from_camera = checked_pose(json_pose(*pose, where), where);
  check_frame_camera(record.camera, where);
  record.image = text_or_empty(object, "image", where);
  record.depth = text_or_empty(object, "depth", where);
  if (is_image_name(record.depth)) {
    record.depth_unit = json_number(object, "depth_unit", where);
    if (!(record.depth_unit > 0) || !std::isfinite(record.depth_unit)) {
      fail({where, "a positive \"depth_unit\"", object.at("depth_unit").dump(), "correct it"});
    }
  }
  return record;
}

ordered_json record_json(const CameraRecord& record) {
  const Camera& camera = record.camera;
  ordered_json object;
  object["name"] = record.name;
  if (!record.role.empty()) object["role"] = record.role;
  if (!record.image.empty()) object["image"] = record.image;
  if (!record.depth.empty()) object["depth"] = record.depth;
  if (record.depth_unit > 0) object["depth_unit"] = record.depth_unit;
  object["width"] = camera.width;
  object["height"] = camera.height;
  object["fx"] = camera.intrinsics(0, 0);
  object["fy"] = camera.intrinsics(1, 1);
  object["cx"] = camera.intrinsics(0, 2);
  object["cy"] = camera.intrinsics(1, 2);
  object["world_from_camera"] = pose_to_json(camera.world_from_camera.matrix());
  return object;
}

CameraList list_from_json(const json& root, const std::string& where) {
  if (!root.is_object()) fail({where, "a JSON object", "another JSON value", "check the file"});
  const std::string format = json_text(root, "format", where);
  if (format != kFormat) {
    fail({where, std::string("the format \"") + kFormat + "\"", "\"" + format + "\"",
          "write the file as docs/FILES.md shows"});
  }
  CameraList cameras;
  const std::string unit = json_text(root, "unit", where);
  if (unit != "metres" && unit != "scene") fail({where, "the unit metres or scene", unit, "correct it"});
  cameras.metric = unit == "metres";
  cameras.points = text_or_empty(root, "points", where);
  const auto frames = root.find("frames");
  if (frames == root.end() || !frames->is_array() || frames->empty()) {
    fail({where, "a list of at least one camera as \"frames\"",
          frames == root.end() ? "none" : (frames->is_array() ? "an empty list" : "something else"),
          "add the cameras"});
  }
  std::set<std::string> names;
  for (size_t i = 0; i < frames->size(); ++i) {
    const std::string frame_where = where + " frame " + std::to_string(i);
    cameras.records.push_back(parse_record((*frames)[i], frame_where));
    const std::string& name = cameras.records.back().name;
    if (!names.insert(name).second) {
      fail({frame_where, "a name of its own", "a second " + name, "rename one of the two"});
    }
  }
  return cameras;
}

}  // namespace

CameraList read_cameras_json(const std::filesystem::path& file) {
  return list_from_json(read_json_file(file), file.string());
}

std::string cameras_json_text(const CameraList& cameras) {
  ordered_json root;
  root["format"] = kFormat;
  root["convention"] =
      "OpenCV cameras (x right, y down, z forward); pixel (0, 0) has its centre at (0.5, 0.5)";
  root["unit"] = cameras.metric ? "metres" : "scene";
  if (!cameras.points.empty()) root["points"] = cameras.points;
  root["frames"] = ordered_json::array();
  for (const CameraRecord& record : cameras.records) root["frames"].push_back(record_json(record));
  return json_text(root, 1) + "\n";
}

void write_cameras_json(const std::filesystem::path& file, const CameraList& cameras) {
  for (const CameraRecord& record : cameras.records) {
    const std::string where = file.string() + " " + record.name;
    checked_pose(record.camera.world_from_camera.matrix(), where);
    check_frame_camera(record.camera, where);
  }
  write_file_atomically(file, cameras_json_text(cameras));
}

}  // namespace gld
