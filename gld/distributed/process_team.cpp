#include "gld/distributed/process_team.h"

namespace gld {

int64_t ProcessTeam::piece_length(int64_t length) const {
  constexpr int64_t kAlignment = 16;  // floats: one cache line
  const int64_t share = (length + count() - 1) / count();
  return (share + kAlignment - 1) / kAlignment * kAlignment;
}

void TeamOfOne::add_at_owners(const torch::Tensor& given, torch::Tensor& owned_sum) {
  owned_sum.narrow(0, 0, given.numel()).add_(given);
}

void TeamOfOne::gather_pieces(const torch::Tensor& owned, torch::Tensor& whole) {
  whole.copy_(owned.narrow(0, 0, whole.numel()));
}

}  // namespace gld
