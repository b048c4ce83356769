#include "datasets/formats/colmap_text.h"

#include "datasets/formats/text_fields.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"

#include <algorithm>
#include <map>
#include <sstream>
#include <string>

#include <fmt/format.h>

namespace gld {
namespace {

bool is_comment(const std::string& line) {
  const size_t first = line.find_first_not_of(" \t");
  return first != std::string::npos && line[first] == '#';
}

bool is_blank(const std::string& line) { return line.find_first_not_of(" \t") == std::string::npos; }

// Returns what follows the first `count` blank-separated fields: an image's name may contain blanks.
std::string after_fields(const std::string& line, size_t count) {
  size_t position = 0;
  for (size_t i = 0; i < count; ++i) {
    position = line.find_first_not_of(" \t", position);
    position = std::min(line.find_first_of(" \t", position), line.size());
  }
  position = line.find_first_not_of(" \t", position);
  if (position == std::string::npos) return {};
  return line.substr(position, line.find_last_not_of(" \t") + 1 - position);
}

// A comment must not begin a line of its own.
std::string one_line(std::string text) {
  std::replace_if(
      text.begin(), text.end(), [](char letter) { return letter == '\n' || letter == '\r'; }, ' ');
  return text;
}

void read_cameras_txt(const std::filesystem::path& file, ColmapModel& model) {
  for (const TextLine& line : read_lines(file)) {
    if (is_comment(line.text) || is_blank(line.text)) continue;
    const auto fields = blank_separated(line.text);
    if (fields.size() < 5) {
      fail({line.where, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS", std::to_string(fields.size()) + " fields",
            "correct the file"});
    }
    ColmapCamera camera;
    camera.model = fields[1];
    camera.width = parse_integer(fields[2], line.where);
    camera.height = parse_integer(fields[3], line.where);
    camera.parameters = parse_numbers(fields, 4, fields.size() - 4, line.where);
    model.cameras[parse_integer(fields[0], line.where)] = camera;
  }
}

// Returns whether a line is one of observations, X Y POINT3D_ID each: an image's has a tenth field, its name.
bool is_observations(const std::string& line) {
  size_t fields = 0;
  std::istringstream words(line);
  std::string last;
  for (std::string word; words >> word; ++fields) last = word;
  return fields % 3 == 0 && (fields == 0 || last.find_first_not_of("-0123456789") == std::string::npos);
}

void read_images_txt(const std::filesystem::path& file, ColmapModel& model) {
  // Every image has a second line, of observations, which may be empty.
  bool observations = false;
  for (const TextLine& line : read_lines(file)) {
    if (is_comment(line.text)) continue;
    if (observations) {
      observations = false;
      if (is_observations(line.text)) continue;
      fail({line.where, "the observations of the image above: X Y POINT3D_ID each, or an empty line",
            "another line", "check that every image has its line of observations"});
    }
    if (is_blank(line.text)) continue;
    const auto fields = blank_separated(line.text, 10);
    if (fields.size() < 10) {
      fail({line.where, "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME",
            std::to_string(fields.size()) + " fields",
            "check that every image has its line of observations"});
    }
    const auto n = parse_numbers(fields, 1, 7, line.where);
    ColmapImage image;
    image.rotation = Eigen::Quaterniond(n[0], n[1], n[2], n[3]);
    image.translation = {n[4], n[5], n[6]};
    image.camera_id = parse_integer(fields[8], line.where);
    image.name = after_fields(line.text, 9);
    model.images.push_back(image);
    observations = true;
  }
}

void read_points_txt(const std::filesystem::path& file, ColmapModel& model) {
  std::map<int64_t, Eigen::Vector3d> points;
  for (const TextLine& line : read_lines(file)) {
    if (is_comment(line.text) || is_blank(line.text)) continue;
    const auto fields = blank_separated(line.text, 4);  // the track behind them may be long
    const auto n = parse_numbers(fields, 1, 3, line.where);
    points[parse_integer(fields[0], line.where)] = {n[0], n[1], n[2]};
  }
  for (const auto& item : points) model.points_in_world.push_back(item.second);
}

}  // namespace

ColmapModel read_colmap_text(const std::filesystem::path& folder) {
  ColmapModel model;
  read_cameras_txt(folder / "cameras.txt", model);
  read_images_txt(folder / "images.txt", model);
  const auto points = folder / "points3D.txt";
  if (std::filesystem::exists(points)) read_points_txt(points, model);
  return model;
}

void write_colmap_text(const std::filesystem::path& folder, const ColmapModel& model) {
  const auto tracks = colmap_tracks(model);
  std::string comments;
  for (const std::string& comment : model.comments) comments += "# " + one_line(comment) + "\n";
  std::string text = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n" + comments;
  for (const auto& [id, camera] : model.cameras) {
    text += fmt::format("{} {} {} {}", id, camera.model, camera.width, camera.height);
    for (double value : camera.parameters) text += fmt::format(" {}", value);
    text += "\n";
  }
  write_file_atomically(folder / "cameras.txt", text);
  text = "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n" +
         comments;
  for (size_t i = 0; i < model.images.size(); ++i) {
    const ColmapImage& image = model.images[i];
    const Eigen::Quaterniond& q = image.rotation;
    const Eigen::Vector3d& t = image.translation;
    text += fmt::format("{} {} {} {} {} {} {} {} {} {}\n", i + 1, q.w(), q.x(), q.y(), q.z(), t.x(), t.y(),
                        t.z(), image.camera_id, image.name);
    for (size_t k = 0; k < image.sightings.size(); ++k) {
      const ColmapSighting& sighting = image.sightings[k];
      text += fmt::format("{}{} {} {}", k == 0 ? "" : " ", sighting.position.x(), sighting.position.y(),
                          sighting.point);
    }
    text += "\n";
  }
  write_file_atomically(folder / "images.txt", text);
  text = "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n" + comments;
  for (size_t i = 0; i < model.points_in_world.size(); ++i) {
    const Eigen::Vector3d& p = model.points_in_world[i];
    const ColmapPointLooks looks = model.point_looks.empty() ? ColmapPointLooks() : model.point_looks[i];
    text += fmt::format("{} {} {} {} {} {} {} {}", i + 1, p.x(), p.y(), p.z(), looks.colour[0],
                        looks.colour[1], looks.colour[2], looks.error);
    for (const ColmapTrackElement& element : tracks[i])
      text += fmt::format(" {} {}", element.image_id, element.sighting);
    text += "\n";
  }
  write_file_atomically(folder / "points3D.txt", text);
}

}  // namespace gld
