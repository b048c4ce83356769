#pragma once

#include "gld/base/options.h"

#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// Options come from defaults, then a YAML file, then --set key=value and flags, in that order. An unknown key is
// an Error that names the nearest valid one and the line; a value outside its range or of the wrong type too.

// Reads a YAML file into options. Keys are the field names, groups are nested maps.
void load_yaml(OptionsGroup& options, const std::filesystem::path& file);
void load_yaml_text(OptionsGroup& options, const std::string& text, const std::string& where);

// Applies "group.field=value"; value is YAML ("3", "[0, 3]", "true", "text").
void apply_setting(OptionsGroup& options, const std::string& setting);
void apply_setting(OptionsGroup& options, const std::string& key, const std::string& value,
                   const std::string& where);

// Reads a JSON object; where names it in errors.
void load_json(OptionsGroup& options, const nlohmann::json& object, const std::string& where);

std::string to_yaml(const OptionsGroup& options);
nlohmann::json to_json(const OptionsGroup& options);

// Does the range checks of every field and check() of every group.
void check_options(const OptionsGroup& options, const std::string& where);

// What --help and the documentation print.
struct OptionDescription {
  std::string key;  // "group.field"
  std::string help;
  std::string type;           // "integer", "a|b|c", "list of real", ...
  std::string default_value;  // as YAML
  std::string range;          // "[1, 1000]" or empty
};
std::vector<OptionDescription> describe_options(const OptionsGroup& options);

// Returns the candidate nearest in edit distance, or an empty name when nothing is near.
std::string nearest_name(const std::string& name, const std::vector<std::string>& candidates);

}  // namespace gld
