#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include <nlohmann/json.hpp>

namespace gld {

// What gld inspect says about what this program has written, beside weight files and bundles:
//   run folder: {"run", "kind": "train level", "state": "running" | "finished" | "not finished", "checkpoints":
//               [{"file", "step", "loss", "best_validation_loss"}], "next": command or null}; a number that is not
//               known is null
//   PNG:        {"picture", "width", "height", "texts": {name: text}}
//   PLY:        {"cloud", "vertices", "properties": [...], "texts": {name: text}}
//   GLB:        {"scene", "meshes", "cameras", "pictures", "texts": {name: text}}
// Texts are those of the file, provenance among them (gld/report/provenance.h). None for anything else. Throws Error
// for a damaged PNG, PLY or GLB file; a checkpoint that cannot be read is listed with its "problem".
std::optional<nlohmann::ordered_json> inspect_output(const std::filesystem::path& file_or_folder);

// Returns the same for people. What is no printable text is written so that it is.
std::string output_inspection_text(const nlohmann::ordered_json& inspection);

}  // namespace gld
