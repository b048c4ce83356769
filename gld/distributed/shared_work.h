#pragma once

#include "gld/base/options.h"
#include "gld/distributed/process_placement.h"
#include "gld/distributed/process_team.h"

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

namespace gld {

// This process among those that work together, or alone: then it is a team of one.
struct ProcessShare {
  ProcessPlacement placement;
  std::unique_ptr<ProcessTeam> team = std::make_unique<TeamOfOne>();

  // Rank 0 says what is said once and writes the run folder.
  bool leads() const { return placement.rank == 0; }
  // Threads that are not asked for (0) are the machine's, shared by the processes on it.
  int64_t threads(int64_t asked) const;
  // "cuda" without a number is the device of this process's local rank where there are several.
  std::string device(const std::string& asked) const;
};

// Takes options before the environment of this process (process_placement.h); waits for the others where there are any.
ProcessShare join_others(const ProcessesOptions& options);

// Throws the same Error at every process where one would not do what rank 0 does: with other options (those of the
// process itself aside) or another model.
void check_same_work(ProcessTeam& team, const OptionsGroup& options, const std::string& model_hash);

// What this process makes of a piece of work, as bytes, and what is done with it wherever it was made.
struct PieceOfWork {
  std::function<std::string(int64_t piece)> make;
  std::function<void(int64_t piece, const std::string& made)> take;
};

// Every piece is made once, by one process, in rounds of one each: piece i of the list by rank i modulo their number.
// take is called at every process for every piece, in the order of the list, after each round. The list is the same
// everywhere.
void share_pieces(const ProcessShare& share, const std::vector<int64_t>& pieces, const PieceOfWork& work);

}  // namespace gld
