#include "gld/files/ply_vertices.h"

#include "gld/base/error.h"
#include "gld/base/printable_text.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <limits>
#include <sstream>

#include <fmt/format.h>

namespace gld {
namespace {

template <class Number>
float number_at(const char* at) {
  Number value;
  std::memcpy(&value, at, sizeof(value));
  return static_cast<float>(value);
}

struct NumberType {
  const char* name;
  const char* other_name;
  size_t bytes;
  float (*read)(const char* at);
};
constexpr std::array<NumberType, 8> kNumberTypes = {{{"float", "float32", 4, number_at<float>},
                                                     {"double", "float64", 8, number_at<double>},
                                                     {"uchar", "uint8", 1, number_at<uint8_t>},
                                                     {"char", "int8", 1, number_at<int8_t>},
                                                     {"ushort", "uint16", 2, number_at<uint16_t>},
                                                     {"short", "int16", 2, number_at<int16_t>},
                                                     {"uint", "uint32", 4, number_at<uint32_t>},
                                                     {"int", "int32", 4, number_at<int32_t>}}};

const NumberType* number_type(const std::string& name) {
  for (const NumberType& type : kNumberTypes) {
    if (name == type.name || name == type.other_name) return &type;
  }
  return nullptr;
}

struct Column {
  const NumberType* type;
  size_t offset;
};

}  // namespace

int64_t PlyVertices::column(const std::string& property) const {
  const auto found = std::find(properties.begin(), properties.end(), property);
  return found == properties.end() ? -1 : found - properties.begin();
}

std::vector<std::string> ply_comments(const std::string& name, const std::string& text) {
  constexpr size_t kLongest = 900;
  std::string line = text;
  std::replace(line.begin(), line.end(), '\n', ' ');
  std::replace(line.begin(), line.end(), '\r', ' ');
  std::vector<std::string> lines{fmt::format("{} {}", name, line.substr(0, kLongest))};
  for (size_t at = kLongest; at < line.size(); at += kLongest)
    lines.push_back(fmt::format("{}+ {}", name, line.substr(at, kLongest)));
  return lines;
}

PlyVertices parse_ply_vertices(ByteView file, const std::string& where) {
  const std::string header(reinterpret_cast<const char*>(file.data), std::min(file.size, kMaximumPlyHeader));
  const std::string mark = "end_header\n";
  const size_t end = header.find("\n" + mark);
  if (header.compare(0, 4, "ply\n") != 0 || end == std::string::npos)
    fail({where, "a PLY file", "another one", "check the path"});
  std::istringstream lines(header.substr(4, end + 1 - 4));
  PlyVertices vertices;
  std::vector<Column> columns;
  size_t bytes_each = 0;
  std::string line, format, element;
  bool known_vertices = false;
  while (std::getline(lines, line)) {
    std::istringstream words(line);
    std::string keyword;
    words >> keyword;
    if (keyword == "comment") {
      vertices.comments.push_back(line.size() > 8 ? line.substr(8) : "");
    } else if (keyword == "format") {
      format = line;
    } else if (keyword == "element") {
      int64_t count = -1;
      words >> element >> count;
      if (!known_vertices && (element != "vertex" || count < 0)) {
        fail({where, "\"element vertex\" with a number first", "\"" + printable_text(line) + "\"",
              "write it again with vertices first"});
      }
      if (!known_vertices) vertices.count = count;
      known_vertices = true;
    } else if (keyword == "property" && element == "vertex") {
      std::string type, name;
      words >> type >> name;
      const NumberType* number = number_type(type);
      if (number == nullptr || name.empty()) {
        fail({where, "properties of vertices that are numbers", "\"" + printable_text(line) + "\"",
              "write it again without that property"});
      }
      vertices.properties.push_back(name);
      columns.push_back({number, bytes_each});
      bytes_each += number->bytes;
    }
  }
  if (format != "format binary_little_endian 1.0") {
    fail({where, "\"format binary_little_endian 1.0\"", "\"" + printable_text(format) + "\"",
          "convert it to binary PLY"});
  }
  if (!known_vertices || bytes_each == 0) fail({where, "vertices with properties", "none", "check the file"});
  const size_t start = end + 1 + mark.size(), rest = file.size - start;
  if (static_cast<uint64_t>(vertices.count) > rest / bytes_each) {
    fail({where, fmt::format("{} vertices of {} bytes", vertices.count, bytes_each),
          fmt::format("{} bytes", rest), "write or download it again"});
  }
  vertices.values.resize(static_cast<size_t>(vertices.count) * columns.size());
  const char* row = reinterpret_cast<const char*>(file.data) + start;
  float* value = vertices.values.data();
  for (int64_t i = 0; i < vertices.count; ++i, row += bytes_each) {
    for (const Column& column : columns) *value++ = column.type->read(row + column.offset);
  }
  return vertices;
}

std::string ply_vertices_bytes(const PlyVertices& vertices) {
  std::string bytes = "ply\nformat binary_little_endian 1.0\n";
  for (const std::string& comment : vertices.comments) bytes += "comment " + comment + "\n";
  bytes += fmt::format("element vertex {}\n", vertices.count);
  for (const std::string& property : vertices.properties) bytes += "property float " + property + "\n";
  bytes += "end_header\n";
  bytes.append(reinterpret_cast<const char*>(vertices.values.data()), vertices.values.size() * sizeof(float));
  return bytes;
}

}  // namespace gld
