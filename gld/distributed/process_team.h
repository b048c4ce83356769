#pragma once

#include "gld/distributed/process_placement.h"

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// Several processes that train one model, each with all of it. All call the same functions in the same order. A process
// that ends or cannot be reached ends the others within 10 s, wherever they are, each with one sentence that names it;
// a function that fails for another reason throws Error.
class ProcessTeam {
 public:
  virtual ~ProcessTeam() = default;

  virtual int64_t rank() const = 0;
  virtual int64_t count() const = 0;
  // Returns the number of processes on the machine of this one, itself included.
  virtual int64_t local_count() const = 0;

  // Returns what every process gave, in the order of ranks; it is the same everywhere.
  virtual std::vector<std::string> gather(const std::string& mine) = 0;

  bool alone() const { return count() == 1; }

  // A flat tensor is cut into count() pieces of piece_length(); the last may be shorter. Piece r is owned by rank r.
  int64_t piece_length(int64_t length) const;
  // Adds this process's piece of every process's `given` to owned_sum (piece_length), in the order of ranks, which
  // gives the same bits as one process that adds them one after the other. given is float32 and of the same length
  // everywhere.
  virtual void add_at_owners(const torch::Tensor& given, torch::Tensor& owned_sum) = 0;
  // Puts every owner's piece into whole.
  virtual void gather_pieces(const torch::Tensor& owned, torch::Tensor& whole) = 0;
  // Overwrites the tensor with that of rank `from`; shape and type are the same everywhere.
  virtual void broadcast(torch::Tensor& tensor, int64_t from) = 0;

  // Waits until all have come here; from then on each may end when it likes, and calls nothing else.
  virtual void finish() = 0;

  // Returns the seconds spent in the functions above since the last call of this one, waiting for slower processes
  // included.
  virtual double take_communication_seconds() = 0;
};

// A process that works alone: rank 0 of 1, who has what it gave.
class TeamOfOne final : public ProcessTeam {
 public:
  int64_t rank() const override { return 0; }
  int64_t count() const override { return 1; }
  int64_t local_count() const override { return 1; }
  std::vector<std::string> gather(const std::string& mine) override { return {mine}; }
  void add_at_owners(const torch::Tensor& given, torch::Tensor& owned_sum) override;
  void gather_pieces(const torch::Tensor& owned, torch::Tensor& whole) override;
  void broadcast(torch::Tensor& /*tensor*/, int64_t /*from*/) override {}
  void finish() override {}
  double take_communication_seconds() override { return 0; }
};

// Returns the engines of this build: "gloo", or none.
std::vector<std::string> process_engines();

// Meets the others at the store of rank 0. Throws Error where this build has no engine, the store cannot be made or
// reached, a rank is there twice, the processes disagree about their number, not all come within join_seconds, they are
// of different versions, or one of them can only be reached from its own machine.
std::unique_ptr<ProcessTeam> join_processes(const ProcessPlacement& placement);

}  // namespace gld
