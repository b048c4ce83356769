#pragma once

#include "gld/distributed/process_team.h"
#include "train/optim/optimiser.h"

#include <map>
#include <string>

#include <torch/types.h>

namespace gld {

enum class OptimiserShare {
  kWhole,  // every process keeps moments and average of all parameters, and moves all of them
  kOwnPiece,  // of the piece that it owns alone, whose new values the others get from it (ZeRO-1, Rajbhandari et al. 2020)
};

// The optimiser of a run in one process or several. By its own pieces, moments and moving average take as much memory
// in all processes together as in one, and each step sends the parameters once more; the bits are the same, because
// Adam moves each number by itself. Functions marked so are called by all processes of a team together.
class SharedOptimiser {
 public:
  // A team of one has everything. Throws the Error of Optimiser for pieces of Muon's matrices.
  SharedOptimiser(FlatParameters& parameters, const OptimiserOptions& options, OptimiserShare share,
                  ProcessTeam& team);

  double gradient_norm() const { return own_.gradient_norm(); }
  bool has_average() const { return own_.has_average(); }
  // Returns whether this process lacks some of the state.
  bool in_pieces() const { return in_pieces_; }

  // All together call this: it does Optimiser::step(), and sends the new values of all pieces.
  void step(double learning_rate, double gradient_norm, int64_t workers);
  // All together call this: it returns the state of all parameters, as Optimiser::state() names it. In pieces only rank
  // 0 gets it; the others get nothing.
  std::map<std::string, torch::Tensor> whole_state();
  // Returns tensors of the shapes and types of whole_state(), of any contents.
  std::map<std::string, torch::Tensor> like_whole_state() const { return own_.whole_initial_state(); }
  // Takes what belongs to this process of a state of all parameters. Throws Optimiser::load_state()'s Error.
  void load_state(const std::map<std::string, torch::Tensor>& whole, const std::string& where) {
    own_.load_state(whole, where);
  }

 private:
  // Returns a piece as long as every other; the last one's end is zero.
  torch::Tensor padded(const torch::Tensor& piece) const;

  FlatParameters* parameters_;
  ProcessTeam* team_;
  bool in_pieces_;
  Optimiser own_;
};

}  // namespace gld
