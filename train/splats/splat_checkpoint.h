#pragma once

#include "datasets/splats/splat_fit.h"
#include "gld/report/table.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace gld {

// A fit as it stands after a step: with the views and the options all that the others depend on.
struct SplatCheckpoint {
  SplatFit fit;
  int64_t started_with = 0;                  // Gaussians
  double seconds = 0;                        // so far
  double processor_seconds = 0;              // so far
  std::string views;                         // fit_views_hash
  std::vector<std::vector<TableCell>> rows;  // of steps.csv
};

constexpr const char* kSplatCheckpointFile = "fit.checkpoint";

// Returns the hash of cameras and pixels of what is fitted and held out.
std::string fit_views_hash(const std::vector<const FittedView*>& views);

// Writes a safetensors file of the fit's arrays, whole or not at all; its metadata hold the rest as JSON and the
// SHA-256 of both.
void write_splat_checkpoint(const std::filesystem::path& file, const SplatCheckpoint& checkpoint);
// Throws Error that names the file where a byte of it is another than was written.
SplatCheckpoint read_splat_checkpoint(const std::filesystem::path& file);

}  // namespace gld
