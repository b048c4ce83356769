#pragma once

#include "infer/evaluate/scene_evaluation.h"

#include <nlohmann/json.hpp>

namespace gld {

// Returns what gld eval keeps of a scene that is done, so that a later run goes on with the next one: every number with
// its reason and what it is of each target. Numbers keep all their digits.
nlohmann::ordered_json scene_record(const SceneEvaluation& scene);

// Reads the same back. A column that the record does not have, because another version wrote it, is absent. Throws
// Error naming `where` for text that is no record.
SceneEvaluation scene_from_record(const nlohmann::json& record, const std::string& where);

// Returns the number; "inf" and "-inf" are text and NaN is null, as JSON does not have them.
nlohmann::ordered_json number_record(double value);

}  // namespace gld
