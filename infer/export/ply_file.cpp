#include "infer/export/ply_file.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/files/ply_vertices.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <sstream>

namespace gld {
namespace {

constexpr double kFloatRounding = 1.0 / (1 << 24);

std::string comments(const TextItems& items) {
  std::string lines;
  for (const auto& [name, text] : items) {
    for (const std::string& line : ply_comments(name, text)) lines += "comment " + line + "\n";
  }
  return lines;
}

// Returns the header's lines about a vertex.
std::string property_lines(bool doubles) {
  std::string lines;
  for (const char* axis : {"x", "y", "z"}) {
    lines += std::string("property ") + (doubles ? "double " : "float ") + axis + "\n";
  }
  return lines + "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty float confidence\n";
}

std::string header(const PointCloud& cloud, const TextItems& items, bool doubles) {
  std::string text = "ply\nformat binary_little_endian 1.0\n";
  text += comments(items);
  text += "element vertex " + std::to_string(cloud.size()) + "\n";
  return text + property_lines(doubles) + "end_header\n";
}

bool needs_doubles(const PointCloud& cloud) {
  if (cloud.x_in_world.empty()) return false;
  Eigen::Vector3d low = cloud.x_in_world.front();
  Eigen::Vector3d high = low;
  for (const Eigen::Vector3d& point : cloud.x_in_world) {
    low = low.cwiseMin(point);
    high = high.cwiseMax(point);
  }
  const double largest = std::max(low.cwiseAbs().maxCoeff(), high.cwiseAbs().maxCoeff());
  return largest * kFloatRounding > 1e-5 * (high - low).norm();
}

template <class Value>
void append(std::string& bytes, Value value) {
  const size_t at = bytes.size();
  bytes.resize(at + sizeof(Value));
  std::memcpy(bytes.data() + at, &value, sizeof(Value));
}

template <class Value>
Value take(const char*& at) {
  Value value;
  std::memcpy(&value, at, sizeof(Value));
  at += sizeof(Value);
  return value;
}

// Reads the header's lines up to end_header; returns the number of vertices.
int64_t read_header(std::istringstream& stream, const std::string& where, PlyFile& ply) {
  std::string line;
  std::string format;
  std::string properties;
  int64_t vertices = -1;
  std::getline(stream, line);
  if (line != "ply") fail({where, "a PLY file", "another one", "check the path"});
  while (std::getline(stream, line) && line != "end_header") {
    std::istringstream words(line);
    std::string keyword;
    words >> keyword;
    if (keyword == "comment") {
      std::string name;
      std::string text;
      words >> name;
      words.get();
      std::getline(words, text);
      if (!name.empty() && name.back() == '+' && !ply.comments.empty()) {
        ply.comments.back().second += text;
      } else {
        ply.comments.emplace_back(name, text);
      }
    } else if (keyword == "element") {
      words >> keyword >> vertices;
    } else if (keyword == "format") {
      format = line;
    } else {
      properties += line + "\n";
    }
  }
  const bool whole = format == "format binary_little_endian 1.0" && vertices >= 0 && line == "end_header";
  for (const bool doubles : {false, true}) {
    if (!whole || properties != property_lines(doubles)) continue;
    ply.doubles = doubles;
    return vertices;
  }
  fail({where, "a point cloud of this program", "another PLY header", "open it with another program"});
}

}  // namespace

void export_ply(const std::filesystem::path& file, const PointCloud& cloud, const Provenance& provenance) {
  const bool doubles = needs_doubles(cloud);
  std::string bytes = header(cloud, provenance_items(provenance), doubles);
  bytes.reserve(bytes.size() + cloud.x_in_world.size() * (doubles ? 31 : 19));
  for (size_t i = 0; i < cloud.x_in_world.size(); ++i) {
    const Eigen::Vector3d& point = cloud.x_in_world[i];
    const bool fits =
        point.allFinite() && (doubles || point.cwiseAbs().maxCoeff() <= std::numeric_limits<float>::max());
    if (!fits)
      fail({file.string(), "finite points", "one that is not, number " + std::to_string(i),
            "check the depth and the cameras"});
    for (const double coordinate : point) {
      if (doubles) {
        append(bytes, coordinate);
      } else {
        append(bytes, static_cast<float>(coordinate));
      }
    }
    bytes.append(reinterpret_cast<const char*>(cloud.colours[i].data()), 3);
    append(bytes, cloud.confidences[i]);
  }
  write_file_atomically(file, bytes);
}

PlyFile read_ply(const std::filesystem::path& file) {
  const std::string bytes = read_file(file);
  std::istringstream stream(bytes);
  PlyFile ply;
  const int64_t vertices = read_header(stream, file.string(), ply);
  const size_t start = static_cast<size_t>(stream.tellg());
  const size_t vertex_bytes = ply.doubles ? 31 : 19;
  if ((bytes.size() - start) / vertex_bytes != static_cast<size_t>(vertices) ||
      (bytes.size() - start) % vertex_bytes != 0) {
    fail({file.string(), std::to_string(vertices) + " vertices of " + std::to_string(vertex_bytes) + " bytes",
          std::to_string(bytes.size() - start) + " bytes", "write it again"});
  }
  const char* at = bytes.data() + start;
  for (int64_t i = 0; i < vertices; ++i) {
    Eigen::Vector3d point;
    for (double& coordinate : point) coordinate = ply.doubles ? take<double>(at) : take<float>(at);
    ply.cloud.x_in_world.push_back(point);
    ply.cloud.colours.push_back(take<Rgb>(at));
    ply.cloud.confidences.push_back(take<float>(at));
  }
  return ply;
}

}  // namespace gld
