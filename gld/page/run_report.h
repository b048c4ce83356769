#pragma once

#include "gld/report/provenance.h"

#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// What the report.json of a run says. A report of another version may lack anything: what it does not say is left out.

// What a warning of gld sample begins with where depth has no unit; the page says it in words of its own.
constexpr const char* kScaleNotKnown = "The scale of the predicted depth is not known";

// Throws Error where there is none or it is no JSON.
nlohmann::ordered_json read_run_report(const std::filesystem::path& run);

// Returns the text, number or anything else at a path of keys ("/verdict/sentence"), and null where the report has
// none.
const nlohmann::ordered_json& report_value(const nlohmann::ordered_json& report, const std::string& path);
// Returns the text there; it is empty where there is none.
std::string report_text_at(const nlohmann::ordered_json& report, const std::string& path);
// Returns the number there as text; it is empty where there is none.
std::string report_number_at(const nlohmann::ordered_json& report, const std::string& path);

// Returns every doubt, a sentence each: what the model has not seen, and the warnings of the run.
std::vector<std::string> doubts_of_run(const nlohmann::ordered_json& report);

// Returns the provenance of the run's files, by this program.
TextItems provenance_of_run(const nlohmann::ordered_json& report);

}  // namespace gld
