#pragma once

#include "gld/base/options.h"

#include <cstdint>
#include <functional>
#include <optional>
#include <string>

namespace gld {

// Which of several processes this one is. What is not given is taken from the environment of the process, as torchrun
// sets it: RANK, WORLD_SIZE, LOCAL_RANK, MASTER_ADDR, MASTER_PORT.
struct ProcessesOptions : OptionsGroup {
  int64_t count = 0;
  int64_t rank = -1;
  int64_t local_rank = -1;
  std::string master_address;
  int64_t master_port = 0;
  int64_t join_seconds = 60;

  void visit(FieldVisitor& visitor) override;
};

// Ranks, and where the store is at which they meet.
struct ProcessPlacement {
  int64_t rank = 0;
  int64_t count = 1;
  int64_t local_rank = 0;      // on its machine
  std::string master_address;  // empty where count is 1
  int64_t master_port = 0;
  bool store_is_hosted =
      false;  // torchrun's agent holds the store (TORCHELASTIC_USE_AGENT_STORE), rank 0 does otherwise
  std::string attempt =
      "0";  // of torchrun's restarts (TORCHELASTIC_RESTART_COUNT): what one left in the store is not the next one's
  double join_seconds = 60;
};

// It returns the value of a variable, and none where it is not set or empty.
using Environment = std::function<std::optional<std::string>(const std::string& name)>;
std::optional<std::string> variable_of_this_process(const std::string& name);

// Takes options before the environment; without either there is one process. Throws Error naming what is missing or
// contradicts.
ProcessPlacement process_placement(const ProcessesOptions& options, const Environment& environment);

}  // namespace gld
