#include "gld/report/provenance.h"

#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/json_text.h"

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

}  // namespace

std::string program_version() { return "gld " GLD_VERSION; }

std::string identifying_options(nlohmann::json options) {
  for (const std::string& name : options_beside_the_result()) options.erase(name);
  shorten_paths(options);
  return json_text(options);
}

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
