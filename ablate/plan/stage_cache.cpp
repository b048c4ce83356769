#include "ablate/plan/stage_cache.h"

#include "gld/base/atomic_file.h"
#include "gld/base/json_text.h"
#include "gld/report/progress.h"
#include "gld/report/table.h"

#include <algorithm>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

std::optional<nlohmann::json> read_json(const std::filesystem::path& file) {
  if (!std::filesystem::is_regular_file(file)) return std::nullopt;
  return parse_json(read_file(file), file.string());
}

std::string bytes_text(double bytes) {
  return bytes >= 1e9 ? fmt::format("{:.1f} GB", bytes / 1e9) : fmt::format("{:.0f} MB", bytes / 1e6);
}

// Of the instances of one stage.
struct StageLine {
  int64_t runs = 0, done = 0, begun = 0, unknown = 0;
  double seconds_left = 0;
  int64_t peak_bytes = 0;
  double disk_bytes = 0;
  bool like = false;
};

}  // namespace

StageState StageCache::state(const StageTask& task) const {
  if (std::filesystem::is_regular_file(folder(task) / "done.json")) return StageState::kDone;
  return std::filesystem::exists(folder(task) / "stage.json") ? StageState::kBegun : StageState::kMissing;
}

std::optional<StageCost> StageCache::cost(const StageTask& task) const {
  const auto json = read_json(folder(task) / "done.json");
  if (!json) return std::nullopt;
  return StageCost{json->value("seconds", 0.0), json->value("peak_bytes", int64_t{0}),
                   json->value("disk_bytes", int64_t{0})};
}

double StageCache::seconds_spent(const StageTask& task) const {
  const auto json = read_json(folder(task) / "spent.json");
  return json ? json->value("seconds", 0.0) : 0;
}

void StageCache::begin(const StageTask& task) const {
  std::filesystem::create_directories(folder(task));
  const nlohmann::ordered_json json{
      {"stage", task.stage}, {"command", task.command}, {"depends_on", task.depends}};
  write_file_atomically(folder(task) / "stage.json", json_text(json, 2) + "\n");
}

void StageCache::note_seconds_spent(const StageTask& task, double seconds) const {
  const nlohmann::ordered_json json{{"seconds", seconds_spent(task) + seconds}};
  write_file_atomically(folder(task) / "spent.json", json_text(json, 2) + "\n");
}

void StageCache::finish(const StageTask& task, const StageCost& cost) const {
  const nlohmann::ordered_json json{
      {"seconds", cost.seconds}, {"peak_bytes", cost.peak_bytes}, {"disk_bytes", cost.disk_bytes}};
  write_file_atomically(folder(task) / "done.json", json_text(json, 2) + "\n");
}

std::vector<bool> needed_tasks(const AblationPlan& plan, const StageCache& cache) {
  std::vector<bool> needed(plan.tasks.size(), false);
  for (const VariantRun& run : plan.runs) {
    for (const size_t result : run.results) needed[result] = true;
  }
  // Each task is behind those that it needs.
  for (size_t number = plan.tasks.size(); number-- > 0;) {
    if (!needed[number] || cache.state(plan.tasks[number]) == StageState::kDone) continue;
    for (const size_t before : plan.tasks[number].needs) needed[before] = true;
  }
  return needed;
}

ExpectedCost expected_cost(const AblationPlan& plan, size_t task, const StageCache& cache) {
  if (const auto own = cache.cost(plan.tasks[task])) return {CostSource::kMeasured, *own, 1};
  ExpectedCost expected;
  double seconds = 0;
  double disk = 0;
  for (const StageTask& other : plan.tasks) {
    if (other.stage != plan.tasks[task].stage) continue;
    const auto cost = cache.cost(other);
    if (!cost) continue;
    seconds += cost->seconds;
    disk += static_cast<double>(cost->disk_bytes);
    expected.cost.peak_bytes = std::max(expected.cost.peak_bytes, cost->peak_bytes);
    ++expected.like;
  }
  if (expected.like == 0) return expected;
  expected.source = CostSource::kLikeStages;
  expected.cost.seconds = seconds / static_cast<double>(expected.like);
  expected.cost.disk_bytes = static_cast<int64_t>(disk / static_cast<double>(expected.like));
  return expected;
}

std::string plan_text(const AblationPlan& plan, const StageCache& cache, int64_t jobs) {
  std::vector<std::pair<std::string, StageLine>> lines;
  StageLine all;
  const std::vector<bool> needed = needed_tasks(plan, cache);
  for (size_t number = 0; number < plan.tasks.size(); ++number) {
    const StageTask& task = plan.tasks[number];
    if (!needed[number] && cache.state(task) != StageState::kDone) continue;
    const std::string name = task.stage == task.command ? task.stage : task.stage + " (" + task.command + ")";
    auto line =
        std::find_if(lines.begin(), lines.end(), [&](const auto& entry) { return entry.first == name; });
    if (line == lines.end()) line = lines.insert(line, {name, {}});
    const StageState state = cache.state(task);
    const ExpectedCost expected = expected_cost(plan, number, cache);
    for (StageLine* total : {&line->second, &all}) {
      ++total->runs;
      if (state == StageState::kDone) ++total->done;
      if (state == StageState::kBegun) ++total->begun;
      if (expected.source == CostSource::kUnknown) {
        ++total->unknown;
        continue;
      }
      if (expected.source == CostSource::kLikeStages) {
        total->like = true;
        total->seconds_left += expected.cost.seconds;
      }
      total->peak_bytes = std::max(total->peak_bytes, expected.cost.peak_bytes);
      total->disk_bytes += static_cast<double>(expected.cost.disk_bytes);
    }
  }
  const auto time_text = [](const StageLine& line) -> std::string {
    if (line.done == line.runs) return "0 s";
    if (line.unknown == line.runs - line.done) return "unknown";
    const std::string known = duration_text(line.seconds_left);
    return line.unknown == 0 ? known : known + " and " + std::to_string(line.unknown) + " unknown";
  };
  Table table({"stage", "runs", "done", "begun", "time left", "memory of one", "disk"});
  for (const auto& [name, line] : lines) {
    table.add_row({name, line.runs, line.done, line.begun, time_text(line),
                   line.peak_bytes > 0 ? bytes_text(static_cast<double>(line.peak_bytes)) : "unknown",
                   line.unknown < line.runs ? bytes_text(line.disk_bytes) : "unknown"});
  }
  std::string text = table.markdown();
  text += fmt::format(
      "\n{} stages for {} runs of variants and seeds: {} done, {} to run, {} at a time; time left {}{}.\n",
      all.runs, plan.runs.size(), all.done, all.runs - all.done, jobs, time_text(all),
      jobs > 1 && all.seconds_left > 0 ? " of one at a time" : "");
  if (all.unknown > 0) {
    text +=
        "Unknown is what no finished stage of its name tells: time, memory and disk are measured, not guessed.\n";
  }
  return text;
}

}  // namespace gld
