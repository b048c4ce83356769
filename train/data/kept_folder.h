#pragma once

#include "gld/files/weight_file.h"

#include <atomic>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include <torch/types.h>

namespace gld {

// What is kept of a scene: tensors by name. None say that nothing came of it, which is kept as well.
using KeptTensors = std::map<std::string, torch::Tensor>;

struct KeptThing {
  KeptTensors tensors;
  std::map<std::string, std::string> text;  // beside them, by name
};

// A folder of what trainings draw, and of what frozen networks make of it, for the next run that needs the same:
// another variant of an ablation, a run that goes on, the next kind of training. A thing is a file of its own, written
// whole or not at all, so that several processes may use one folder. Nothing in it is ever needed: what is not there is
// made anew.
//
// A thing is known by what it was made of and by this very executable (SHA-256): another build may draw or encode
// otherwise, and finds nothing. Files of builds that are gone stay until somebody removes the folder. What depends on
// more than that (weights, device, LibTorch) has it in made_of.
class KeptFolder {
 public:
  // made_of: everything that the things of this use depend on, beside their own keys. Throws Error where the folder
  // cannot be made.
  KeptFolder(const std::filesystem::path& folder, const std::string& made_of);

  // Returns what is kept under that key: tensors on the CPU that share the file's memory. Nothing where there is none,
  // or a file that is not whole.
  std::optional<KeptThing> find(const std::string& key) const;
  // Writes it, and returns whether it did. Where that fails, or less than 4 GiB of the disk are free, it says so once
  // and keeps no more: a full disk ends no training.
  bool keep(const std::string& key, const KeptThing& thing) const;

 private:
  std::filesystem::path file_of(const std::string& key) const;

  std::filesystem::path folder_;
  std::string made_of_;
  mutable std::atomic<bool> failed_{false};  // a write has
};

}  // namespace gld
