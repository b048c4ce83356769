#include "cli/version_text.h"

#include "gld/report/provenance.h"
#include "gld/tensors/torch_version.h"

#include <gld_commit.h>

namespace gld {

std::string version_text() {
  constexpr size_t kHashDigits = 8;
  std::string commit = GLD_COMMIT;
  if (commit.size() > kHashDigits) commit = commit.substr(0, kHashDigits) + (commit.back() == '+' ? "+" : "");
  return program_version() + ", commit " + commit + ", LibTorch " + torch_version();
}

}  // namespace gld
