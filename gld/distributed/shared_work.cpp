#include "gld/distributed/shared_work.h"

#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/option_differences.h"

#include <algorithm>

#include <nlohmann/json.hpp>

namespace gld {

int64_t ProcessShare::threads(int64_t asked) const {
  if (asked > 0 || team->alone()) return asked;
  return std::max<int64_t>(1, threads_to_use(0) / team->local_count());
}

std::string ProcessShare::device(const std::string& asked) const {
  return !team->alone() && asked == "cuda" ? "cuda:" + std::to_string(placement.local_rank) : asked;
}

ProcessShare join_others(const ProcessesOptions& options) {
  ProcessShare share;
  share.placement = process_placement(options, variable_of_this_process);
  if (share.placement.count > 1) share.team = join_processes(share.placement);
  return share;
}

void check_same_work(ProcessTeam& team, const OptionsGroup& options, const std::string& model_hash) {
  const nlohmann::json mine = {{"options", to_yaml(options)}, {"model", model_hash}};
  const auto first = nlohmann::json::parse(team.gather(mine.dump()).front());
  std::string of_first, here;
  for (const auto& difference : differences_from(first.at("options").get<std::string>(), "rank 0", options)) {
    if (is_beside_the_result(difference.key)) continue;
    const std::string separator = here.empty() ? "" : ", ";
    of_first += separator + difference.key + " " + difference.before;
    here += separator + difference.now;
  }
  nlohmann::json complaint;
  if (!here.empty()) {
    complaint = {"the options of rank 0 (" + of_first + ")", here,
                 "start every process with the same options"};
  } else if (mine.at("model") != first.at("model")) {
    complaint = {"the model files that rank 0 has", "others in the folder of --model",
                 "copy those of rank 0 there, model.yaml included"};
  }
  const auto complaints = team.gather(complaint.dump());
  for (size_t rank = 0; rank < complaints.size(); ++rank) {
    const auto said = nlohmann::json::parse(complaints[rank]);
    if (said.is_null()) continue;
    fail({"rank " + std::to_string(rank), said.at(0).get<std::string>(), said.at(1).get<std::string>(),
          said.at(2).get<std::string>()});
  }
}

void share_pieces(const ProcessShare& share, const std::vector<int64_t>& pieces, const PieceOfWork& work) {
  const auto processes = static_cast<size_t>(share.team->count());
  const auto own = static_cast<size_t>(share.placement.rank);
  for (size_t first = 0; first < pieces.size(); first += processes) {
    std::string made;
    if (first + own < pieces.size()) made = work.make(pieces[first + own]);
    const auto all = share.team->gather(made);
    for (size_t i = 0; i < processes && first + i < pieces.size(); ++i) work.take(pieces[first + i], all[i]);
  }
}

}  // namespace gld
