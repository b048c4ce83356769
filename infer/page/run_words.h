#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// What the report.json of a run says, in sentences for people. A report of another version may lack anything: what it
// does not say is left out.

// The text, number or anything else at a path of keys ("/verdict/sentence"); null where the report has none.
const nlohmann::ordered_json& report_value(const nlohmann::ordered_json& report, const std::string& path);
// The text there; empty where there is none.
std::string report_text_at(const nlohmann::ordered_json& report, const std::string& path);

// What gld sample was asked for: "4 new views of kitchen from 2 photographs, ...".
std::string asked_of_sample(const nlohmann::ordered_json& report);
// What came out, whatever the pictures look like.
std::string verdict_of_sample(const nlohmann::ordered_json& report);
// Every doubt, a sentence each: what the model has not seen, and the warnings of the run.
std::vector<std::string> doubts_of_run(const nlohmann::ordered_json& report);

}  // namespace gld
