#pragma once

#include <string>

namespace gld {

// Returns whether a key of a training's metrics.jsonl (docs/FILES.md) tells how the run goes (waiting, time, steps left
// out) and not what it learns.
bool is_course_of_run(const std::string& key);

// Returns whether a key, with "validation_" or without, is a sharpness, which is best at 1.
bool is_sharpness(const std::string& key);

}  // namespace gld
