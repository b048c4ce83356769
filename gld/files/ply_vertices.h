#pragma once

#include "gld/base/mapped_file.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// The vertices of a PLY file as a table of numbers.
struct PlyVertices {
  std::vector<std::string> comments;    // without the word itself
  std::vector<std::string> properties;  // "x"
  int64_t count = 0;
  std::vector<float> values;  // (count, properties)

  // Returns the column of a property, or -1.
  int64_t column(const std::string& property) const;
};

// Returns a comment "NAME TEXT" as lines without the word itself: readers such as rply take none beyond 1024
// characters, so that a long text goes on under "NAME+". Ends of lines become blanks.
std::vector<std::string> ply_comments(const std::string& name, const std::string& text);

// Longest header that is read, in bytes.
constexpr size_t kMaximumPlyHeader = 1 << 20;

// Reads a file of "format binary_little_endian 1.0" whose first element is the vertex, of properties that are numbers;
// elements behind it are left out. Numbers of other types become floats. Throws Error naming `where` for anything else,
// and for a file that is shorter than its header says.
PlyVertices parse_ply_vertices(ByteView file, const std::string& where);

// Returns the same as a file, with every property a float. Comments are single lines.
std::string ply_vertices_bytes(const PlyVertices& vertices);

}  // namespace gld
