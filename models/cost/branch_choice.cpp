#include "models/cost/branch_choice.h"

#include "models/cost/cost_model.h"

#include <fmt/format.h>

namespace gld {

BranchChoice choose_branches(const GuidanceOptions& guidance, const DitOptions& model,
                             const LatentGrid& grid) {
  constexpr double kMegabyte = 1e6;
  constexpr int64_t kTokensOfAFullPass = 1024;
  BranchChoice choice;
  choice.working_bytes = 2 * dit_cost(model, grid).working_bytes;
  const int64_t tokens = grid.views * (grid.tokens_per_view() + model.num_special_tokens);
  const double megabytes = static_cast<double>(choice.working_bytes) / kMegabyte;
  switch (guidance.guidance_branches) {
    case BranchEvaluation::kBatched:
      choice.batched = true;
      choice.reason = "as asked";
      break;
    case BranchEvaluation::kSequential:
      choice.reason = "as asked";
      break;
    case BranchEvaluation::kAutomatic:
      if (tokens >= kTokensOfAFullPass) {
        choice.reason = fmt::format("{} tokens a branch: a batch would gain nothing", tokens);
        break;
      }
      choice.batched = megabytes <= guidance.guidance_batch_memory;
      choice.reason =
          fmt::format("{} tokens a branch; both together work in about {:.0f} MB, {} {:g} MB", tokens,
                      megabytes, choice.batched ? "within" : "above", guidance.guidance_batch_memory);
      break;
  }
  return choice;
}

}  // namespace gld
