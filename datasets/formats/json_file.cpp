#include "datasets/formats/json_file.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/printable_text.h"

#include <algorithm>

namespace gld {
namespace {

constexpr uint64_t kLargestJson = uint64_t{1} << 27;

const nlohmann::json& member(const nlohmann::json& object, const std::string& key, const std::string& where) {
  if (!object.is_object() || !object.contains(key)) {
    fail({where, "the key \"" + key + "\"", "none", "add it"});
  }
  return object.at(key);
}

[[noreturn]] void fail_type(const std::string& where, const std::string& key, const char* expected,
                            const nlohmann::json& found) {
  const bool whole = !found.is_structured();
  std::string text = whole ? json_text(found) : found.is_array() ? "a list" : "an object";
  if (text.size() > 40) text = printable_text(text, 37);
  fail({where, std::string(expected) + " as \"" + key + "\"", text, "correct the value"});
}

}  // namespace

nlohmann::json read_json_file(const std::filesystem::path& file) {
  return parse_json(read_file(file, kLargestJson), file.string());
}

double json_number(const nlohmann::json& object, const std::string& key, const std::string& where) {
  const nlohmann::json& value = member(object, key, where);
  if (!value.is_number()) fail_type(where, key, "a number", value);
  return value.get<double>();
}

int64_t json_integer(const nlohmann::json& object, const std::string& key, const std::string& where) {
  const double value = json_number(object, key, where);
  // nerfstudio writes sizes as 960.0 now and then.
  if (!(value > -1e15 && value < 1e15) || value != static_cast<double>(static_cast<int64_t>(value))) {
    fail_type(where, key, "an integer", object.at(key));
  }
  return static_cast<int64_t>(value);
}

std::string json_text(const nlohmann::json& object, const std::string& key, const std::string& where) {
  const nlohmann::json& value = member(object, key, where);
  if (!value.is_string()) fail_type(where, key, "a text", value);
  return value.get<std::string>();
}

double json_number_or(const nlohmann::json& object, const std::string& key, double otherwise,
                      const std::string& where) {
  return object.contains(key) ? json_number(object, key, where) : otherwise;
}

Eigen::Matrix4d json_pose(const nlohmann::json& rows, const std::string& where) {
  Eigen::Matrix4d pose = Eigen::Matrix4d::Identity();
  const bool shaped = rows.is_array() && (rows.size() == 3 || rows.size() == 4) &&
                      std::all_of(rows.begin(), rows.end(), [](const nlohmann::json& row) {
                        return row.is_array() && row.size() == 4 &&
                               std::all_of(row.begin(), row.end(),
                                           [](const nlohmann::json& value) { return value.is_number(); });
                      });
  if (!shaped) {
    fail({where, "a matrix of 3 or 4 rows of 4 numbers", "something else", "correct the matrix"});
  }
  for (size_t row = 0; row < rows.size(); ++row) {
    for (size_t column = 0; column < 4; ++column) {
      pose(static_cast<Eigen::Index>(row), static_cast<Eigen::Index>(column)) =
          rows[row][column].get<double>();
    }
  }
  return pose;
}

nlohmann::json pose_to_json(const Eigen::Matrix4d& pose) {
  nlohmann::json rows = nlohmann::json::array();
  for (Eigen::Index row = 0; row < 4; ++row) {
    rows.push_back({pose(row, 0), pose(row, 1), pose(row, 2), pose(row, 3)});
  }
  return rows;
}

}  // namespace gld
