#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <torch/types.h>

#include <nlohmann/json.hpp>

namespace gld {

// The whole state of a training run at the end of a step: parameters, moving average, optimiser, random
// numbers, data position and whatever the objective keeps.
struct Checkpoint {  // NOLINT(bugprone-exception-escape): moving JSON throws nothing, whatever clang thinks
  // Names, dtypes, shapes and metadata are under the checksum too; this is false in files written before they were.
  bool header_is_checked = true;
  int64_t step = 0;                              // optimiser steps done
  nlohmann::json metadata;                       // numbers and names
  std::map<std::string, torch::Tensor> tensors;  // any device
};

// The names of the tensors that are no step's (Objective::untrained()) begin so; checkpoints of programs of before
// have none.
constexpr const char* kUntrainedTensors = "untrained.";

// Writes one safetensors file under a temporary name and renames it. A checksum over all that it holds, names, dtypes,
// shapes and metadata included, is kept in its metadata.
void save_checkpoint(const std::filesystem::path& file, const Checkpoint& checkpoint);

// Throws Error when the file is no checkpoint, is cut short, or its checksum does not match. Files of format 1, whose
// checksum is over the tensors' bytes alone, are read too.
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

  struct Resumable {  // NOLINT(bugprone-exception-escape): as Checkpoint
    Checkpoint checkpoint;
    std::filesystem::path file;
    std::vector<std::string> damaged;  // newer files that could not be read, one sentence each
  };
  // Throws Error where a run cannot be continued with the checkpoint; where names its file.
  using Check = std::function<void(const Checkpoint& checkpoint, const std::string& where)>;

  // Returns the newest complete checkpoint that passes check; none when there is no checkpoint file at all. A file
  // whose header is under its checksum and that does not pass belongs to other options: this throws the Error of check.
  // Where the header may be damaged, it is passed over like any damaged file. Throws Error when there are files and
  // every one is damaged.
  std::optional<Resumable> newest(const Check& check = {}) const;

  // Returns the steps that have a file, ascending.
  std::vector<int64_t> steps() const;

 private:
  std::filesystem::path file_of(int64_t step) const;

  std::filesystem::path folder_;
  CheckpointFolderOptions options_;
};

}  // namespace gld
