#include "datasets/cameras_json.h"

#include "datasets/frame_checks.h"
#include "gld/atomic_file.h"
#include "gld/error.h"

#include <cmath>
#include <set>

#include <nlohmann/json.hpp>

namespace gld {
namespace {

using nlohmann::json;
using nlohmann::ordered_json;

constexpr const char* kFormat = "gld cameras 1";

const json& member(const json& object, const std::string& key, const std::string& where) {
  const auto found = object.find(key);
  if (found == object.end()) {
    fail({where, "the key \"" + key + "\"", "none", "add it (docs/FILES.md shows the format)"});
  }
  return *found;
}

double number(const json& object, const std::string& key, const std::string& where) {
  const json& value = member(object, key, where);
  if (!value.is_number()) fail({where, "a number for \"" + key + "\"", value.dump(), "correct it"});
  return value.get<double>();
}

int64_t pixels(const json& object, const std::string& key, const std::string& where) {
  const json& value = member(object, key, where);
  if (!value.is_number_integer() || value.get<double>() < 2 || value.get<double>() > 1 << 20) {
    fail({where, "a whole number of pixels from 2 to 1048576 for \"" + key + "\"", value.dump(),
          "correct it"});
  }
  return value.get<int64_t>();
}

std::string text(const json& object, const std::string& key, const std::string& where) {
  const json& value = member(object, key, where);
  if (!value.is_string()) fail({where, "a text for \"" + key + "\"", value.dump(), "correct it"});
  return value.get<std::string>();
}

std::string text_or_empty(const json& object, const std::string& key, const std::string& where) {
  return object.contains(key) ? text(object, key, where) : std::string();
}

Eigen::Matrix4d pose_matrix(const json& object, const std::string& where) {
  const std::string key = "world_from_camera";
  const json& rows = member(object, key, where);
  Eigen::Matrix4d matrix;
  bool valid = rows.is_array() && rows.size() == 4;
  for (size_t r = 0; valid && r < 4; ++r) {
    valid = rows[r].is_array() && rows[r].size() == 4;
    for (size_t c = 0; valid && c < 4; ++c) {
      valid = rows[r][c].is_number();
      if (valid) matrix(static_cast<int>(r), static_cast<int>(c)) = rows[r][c].get<double>();
    }
  }
  if (!valid) fail({where, "4 rows of 4 numbers for \"" + key + "\"", "something else", "correct it"});
  return matrix;
}

CameraRecord parse_record(const json& object, const std::string& where) {
  if (!object.is_object()) fail({where, "an object", object.dump().substr(0, 40), "correct it"});
  CameraRecord record;
  record.name = text(object, "name", where);
  if (record.name.empty()) fail({where, "a name", "an empty one", "name the frame"});
  record.role = text_or_empty(object, "role", where);
  if (!record.role.empty() && record.role != "source" && record.role != "target") {
    fail({where, "the role source or target", record.role, "correct it or leave it out"});
  }
  record.camera.width = pixels(object, "width", where);
  record.camera.height = pixels(object, "height", where);
  record.camera.intrinsics = intrinsic_matrix(number(object, "fx", where), number(object, "fy", where),
                                              number(object, "cx", where), number(object, "cy", where));
  record.camera.world_from_camera = checked_pose(pose_matrix(object, where), where);
  check_camera(record.camera, where);
  record.image = text_or_empty(object, "image", where);
  record.depth = text_or_empty(object, "depth", where);
  if (!record.depth.empty()) {
    record.depth_unit = number(object, "depth_unit", where);
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
  if (!record.depth.empty()) {
    object["depth"] = record.depth;
    object["depth_unit"] = record.depth_unit;
  }
  object["width"] = camera.width;
  object["height"] = camera.height;
  object["fx"] = camera.intrinsics(0, 0);
  object["fy"] = camera.intrinsics(1, 1);
  object["cx"] = camera.intrinsics(0, 2);
  object["cy"] = camera.intrinsics(1, 2);
  ordered_json rows = ordered_json::array();
  const Eigen::Matrix4d matrix = camera.world_from_camera.matrix();
  for (int r = 0; r < 4; ++r) rows.push_back({matrix(r, 0), matrix(r, 1), matrix(r, 2), matrix(r, 3)});
  object["world_from_camera"] = rows;
  return object;
}

}  // namespace

CameraList parse_cameras_json(const std::string& text_of_file, const std::string& where) {
  const json root = json::parse(text_of_file, nullptr, false);
  if (!root.is_object()) {
    fail({where, "a JSON object", root.is_discarded() ? "text that is not JSON" : "another JSON value",
          "check the file"});
  }
  if (text(root, "format", where) != kFormat) {
    fail({where, std::string("the format \"") + kFormat + "\"", text(root, "format", where),
          "write the file with this program or as docs/FILES.md shows"});
  }
  CameraList cameras;
  const std::string unit = text(root, "unit", where);
  if (unit != "metres" && unit != "scene") fail({where, "the unit metres or scene", unit, "correct it"});
  cameras.metric = unit == "metres";
  const json& frames = member(root, "frames", where);
  if (!frames.is_array() || frames.empty()) {
    fail({where, "a list of at least one frame", frames.is_array() ? "an empty list" : "something else",
          "add frames"});
  }
  std::set<std::string> names;
  for (size_t i = 0; i < frames.size(); ++i) {
    const std::string frame_where = where + ", frame " + std::to_string(i);
    cameras.records.push_back(parse_record(frames[i], frame_where));
    if (!names.insert(cameras.records.back().name).second) {
      fail({frame_where, "a name of its own", "a second " + cameras.records.back().name, "rename one"});
    }
  }
  return cameras;
}

CameraList read_cameras_json(const std::filesystem::path& file) {
  return parse_cameras_json(read_file(file, uint64_t{1} << 28), file.string());
}

std::string cameras_json_text(const CameraList& cameras) {
  ordered_json root;
  root["format"] = kFormat;
  root["convention"] =
      "OpenCV cameras (x right, y down, z forward); pixel (0, 0) has its centre at (0.5, 0.5)";
  root["unit"] = cameras.metric ? "metres" : "scene";
  root["frames"] = ordered_json::array();
  for (const CameraRecord& record : cameras.records) root["frames"].push_back(record_json(record));
  return root.dump(1) + "\n";
}

void write_cameras_json(const std::filesystem::path& file, const CameraList& cameras) {
  for (const CameraRecord& record : cameras.records) {
    const std::string where = file.string() + ", frame " + record.name;
    check_camera(record.camera, where);
    checked_pose(record.camera.world_from_camera.matrix(), where);
  }
  write_file_atomically(file, cameras_json_text(cameras));
}

bool is_cameras_json(const std::string& text_of_file) {
  const json root = json::parse(text_of_file, nullptr, false);
  if (!root.is_object()) return false;
  const auto format = root.find("format");
  return format != root.end() && format->is_string() && format->get<std::string>() == kFormat;
}

}  // namespace gld
