#include "train/loop/shared_optimiser.h"

#include <algorithm>
#include <cstdint>
#include <optional>

#include <torch/autograd.h>

namespace gld {
namespace {

std::optional<FlatRange> piece_of(const ProcessTeam& team, int64_t length) {
  const int64_t piece = team.piece_length(length);
  const int64_t begin = std::min(team.rank() * piece, length);
  return FlatRange{begin, std::min(begin + piece, length)};
}

}  // namespace

SharedOptimiser::SharedOptimiser(FlatParameters& parameters, const OptimiserOptions& options,
                                 OptimiserShare share, ProcessTeam& team)
    : parameters_(&parameters),
      team_(&team),
      in_pieces_(share == OptimiserShare::kOwnPiece && !team.alone()),
      own_(parameters, options,
           in_pieces_ ? piece_of(team, parameters.values().numel()) : std::optional<FlatRange>()) {}

torch::Tensor SharedOptimiser::padded(const torch::Tensor& piece) const {
  auto whole_piece = torch::zeros({team_->piece_length(parameters_->values().numel())}, piece.options());
  whole_piece.narrow(0, 0, piece.numel()).copy_(piece);
  return whole_piece;
}

void SharedOptimiser::step(double learning_rate, double gradient_norm, int64_t workers) {
  own_.step(learning_rate, gradient_norm, workers);
  if (!in_pieces_) return;
  const torch::NoGradGuard no_grad;
  torch::Tensor values = parameters_->values();
  team_->gather_pieces(padded(values.narrow(0, own_.own().begin, own_.own().length())), values);
}

std::map<std::string, torch::Tensor> SharedOptimiser::whole_state() {
  auto state = own_.state();
  if (!in_pieces_) return state;
  const torch::NoGradGuard no_grad;
  std::map<std::string, torch::Tensor> whole;
  for (const auto& [name, piece] : state) {
    if (name == "steps") {
      whole[name] = piece;
      continue;
    }
    // One after the other, so that the other processes never hold more than one of them.
    auto gathered = torch::zeros_like(parameters_->values());
    team_->gather_pieces(padded(piece), gathered);
    if (team_->rank() == 0) whole[name] = gathered;
  }
  return team_->rank() == 0 ? whole : std::map<std::string, torch::Tensor>();
}

}  // namespace gld
