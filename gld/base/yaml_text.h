#pragma once

#include <string>

#include <yaml-cpp/yaml.h>

namespace gld {

// Reads one YAML document of bounded depth and size (aliases can make a circle of it), with every key of a map once.
// Throws Error naming `where`, with the line where there is one.
YAML::Node parse_yaml(const std::string& text, const std::string& where);

}  // namespace gld
