#include "gld/report/provenance.h"

#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/dashed_name.h"
#include "gld/base/json_text.h"
#include "gld/base/option_differences.h"
#include "gld/report/shell_word.h"

#include <algorithm>
#include <cstring>
#include <filesystem>

#include <nlohmann/json.hpp>

namespace gld {
namespace {

// An output that is passed on must not say where its maker keeps things: of an absolute path the last name is left.
void shorten_paths(nlohmann::json& values) {
  for (auto& value : values) {
    if (value.is_structured()) shorten_paths(value);
    if (!value.is_string()) continue;
    const std::filesystem::path path = value.get<std::string>();
    if (!path.is_absolute()) continue;
    value = (path.has_filename() ? path : path.parent_path()).filename().string();
  }
}

// Returns a value as a flag takes it: lists are divided at commas.
std::string flag_value(const nlohmann::json& value) {
  if (value.is_string()) return value.get<std::string>();
  if (!value.is_array()) return value.dump();
  std::string list;
  for (const auto& one : value) list += (list.empty() ? "" : ",") + flag_value(one);
  return list;
}

const nlohmann::json& value_of(const nlohmann::json& values, const std::string& key) {
  std::string path = "/" + key;
  std::replace(path.begin(), path.end(), '.', '/');
  return values.at(nlohmann::json::json_pointer(path));
}

}  // namespace

std::string identifying_options(nlohmann::json options) {
  for (const std::string& name : options_beside_the_result()) options.erase(name);
  shorten_paths(options);
  return json_text(options);
}

std::string command_line_text(const std::string& command, const OptionsGroup& options,
                              const OptionsGroup& defaults) {
  nlohmann::json values = to_json(options), usual = to_json(defaults);
  shorten_paths(values);
  shorten_paths(usual);
  std::string line = "gld " + command;
  for (const OptionDescription& option : describe_options(options)) {
    if (is_beside_the_result(option.key)) continue;
    const auto& value = value_of(values, option.key);
    if (value == value_of(usual, option.key)) continue;
    const std::string name = dashed_name(option.key);
    line += value.is_boolean() ? (value.get<bool>() ? " --" : " --no-") + name
                               : " --" + name + " " + shell_word(flag_value(value));
  }
  return line;
}

std::string program_version() { return "gld " GLD_VERSION; }

Provenance make_provenance(const std::string& command, const OptionsGroup& options) {
  Provenance provenance;
  provenance.program = program_version();
  provenance.command = command;
  provenance.options = identifying_options(to_json(options));
  return provenance;
}

TextItems provenance_items(const Provenance& provenance) {
  TextItems items;
  const auto add = [&](const char* name, const std::string& text) {
    if (!text.empty()) items.emplace_back(name, text);
  };
  add("Software", provenance.program);
  add("gld:command", provenance.command);
  add("gld:options", provenance.options);
  add("gld:model", provenance.model_hash);
  add("gld:seed", std::to_string(provenance.seed));
  add("gld:precision", provenance.precision);
  return items;
}

}  // namespace gld
