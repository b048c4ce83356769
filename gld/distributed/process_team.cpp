#include "gld/distributed/process_team.h"

namespace gld {

int64_t ProcessTeam::piece_length(int64_t length) const {
  constexpr int64_t kAlignment = 16;  // floats: one cache line
  const int64_t share = (length + count() - 1) / count();
  return (share + kAlignment - 1) / kAlignment * kAlignment;
}

}  // namespace gld
