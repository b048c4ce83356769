#pragma once

#include <filesystem>
#include <string>

#include <Eigen/Core>
#include <nlohmann/json.hpp>

namespace gld {

// Parses a JSON file of at most 128 MiB as parse_json does (gld/base/json_text.h).
nlohmann::json read_json_file(const std::filesystem::path& file);

// Returns object[key] as a number, an integer or a text; throws Error naming where and key when it is missing or of
// another type.
double json_number(const nlohmann::json& object, const std::string& key, const std::string& where);
int64_t json_integer(const nlohmann::json& object, const std::string& key, const std::string& where);
std::string json_text(const nlohmann::json& object, const std::string& key, const std::string& where);

// Returns the same with a value for a missing key.
double json_number_or(const nlohmann::json& object, const std::string& key, double otherwise,
                      const std::string& where);

// Returns a 3x4 or 4x4 matrix that is a list of rows; 0 0 0 1 is added to the former.
Eigen::Matrix4d json_pose(const nlohmann::json& rows, const std::string& where);
nlohmann::json pose_to_json(const Eigen::Matrix4d& pose);

}  // namespace gld
