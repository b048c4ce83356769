#pragma once

#include "gld/files/weight_file.h"

#include <filesystem>
#include <string>

#include <nlohmann/json.hpp>

namespace gld {

// Returns what gld inspect says about a weight file or a model bundle, as JSON:
//   file:   {"file", "format", "bytes", "tensors": [{"name", "dtype", "shape"}], "values": {...}, "metadata": {...},
//            "totals": {"tensors", "elements", "bytes", "dtypes": {...}}}
//   bundle: {"bundle", "name", "hash", "options": {...}, "parts": {"backbone": file without "tensors", ...},
//            "missing": [...], "totals": {...}}
// Tensors of bundle parts are checked against the modules of model.yaml. Throws Error as the readers do.
nlohmann::ordered_json inspect(const std::filesystem::path& file_or_bundle);

// Returns the same for people: one line a tensor or part, then the totals.
std::string inspection_text(const nlohmann::ordered_json& inspection);

}  // namespace gld
