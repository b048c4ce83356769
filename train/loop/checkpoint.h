#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <torch/types.h>

#include <nlohmann/json.hpp>

namespace gld {

// The whole state of a training run at the end of a step: parameters, moving average, optimiser, random
// numbers, data position and whatever the objective keeps.
struct Checkpoint {
  int64_t step = 0;                              // optimiser steps done
  nlohmann::json metadata;                       // numbers and names
  std::map<std::string, torch::Tensor> tensors;  // any device
};

// Writes one safetensors file under a temporary name and renames it. A checksum over all tensors is kept in
// its metadata.
void save_checkpoint(const std::filesystem::path& file, const Checkpoint& checkpoint);

// Throws Error when the file is no checkpoint, is cut short, or its checksum does not match.
Checkpoint load_checkpoint(const std::filesystem::path& file);

struct CheckpointFolderOptions {
  int64_t keep_last = 3;  // at least 1
};

// checkpoints/step_000001000.safetensors ... and best.safetensors of one run.
class CheckpointFolder {
 public:
  CheckpointFolder(std::filesystem::path folder, const CheckpointFolderOptions& options);

  const std::filesystem::path& path() const { return folder_; }
  // Writes the checkpoint and removes all but the newest keep_last.
  std::filesystem::path save(const Checkpoint& checkpoint) const;
  std::filesystem::path save_best(const Checkpoint& checkpoint) const;

  struct Resumable {
    Checkpoint checkpoint;
    std::filesystem::path file;
    std::vector<std::string> damaged;  // newer files that could not be read, one sentence each
  };
  // The newest complete checkpoint; none when there is no checkpoint file at all. Throws Error when there are
  // files and every one is damaged.
  std::optional<Resumable> newest() const;

  // Steps that have a file, ascending.
  std::vector<int64_t> steps() const;

 private:
  std::filesystem::path file_of(int64_t step) const;

  std::filesystem::path folder_;
  CheckpointFolderOptions options_;
};

}  // namespace gld
