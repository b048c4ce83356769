#pragma once

#include <string>

#include <nlohmann/json.hpp>

namespace gld {

// These functions say what the report.json of a run of gld sample says, in sentences for people.

// Returns what was asked for: "Asked for: 4 new views of kitchen from 2 photographs, ..."; it is empty where the report
// does not say.
std::string asked_of_sample(const nlohmann::ordered_json& report);
// Returns what came out, whatever the pictures look like.
std::string verdict_of_sample(const nlohmann::ordered_json& report);

}  // namespace gld
