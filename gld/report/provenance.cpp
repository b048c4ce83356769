#include "gld/report/provenance.h"

#include "gld/base/configuration.h"

#include <nlohmann/json.hpp>

namespace gld {

std::string program_version() { return "gld " GLD_VERSION; }

Provenance make_provenance(const std::string& command, const OptionsGroup& options,
                           const std::vector<std::string>& leave_out) {
  nlohmann::json values = to_json(options);
  for (const std::string& name : leave_out) values.erase(name);
  Provenance provenance;
  provenance.program = program_version();
  provenance.command = command;
  provenance.options = values.dump();
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

std::string find_text(const TextItems& items, const std::string& name) {
  for (const auto& [key, text] : items) {
    if (key == name) return text;
  }
  return {};
}

}  // namespace gld
