#include "ablate/report/ablation_run.h"

#include "ablate/page/ablation_page.h"
#include "ablate/plan/stage_cache.h"
#include "ablate/plan/stage_plan.h"
#include "ablate/report/ablation_report.h"
#include "ablate/report/other_runs.h"
#include "ablate/run/stage_lock.h"
#include "ablate/run/stage_runner.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/base/json_text.h"
#include "gld/base/option_differences.h"
#include "gld/base/run_journal.h"
#include "gld/page/run_page.h"
#include "gld/report/run_folder.h"

#include <algorithm>
#include <iostream>
#include <memory>
#include <set>
#include <utility>
#include <vector>

#include <fmt/format.h>

namespace gld {
namespace {

namespace fs = std::filesystem;

// Removes of an earlier ablation whatever its commands wrote: folders named by keys, and nothing else. Another ablation
// may work there too, with --cache.
void remove_stages(const fs::path& cache) {
  if (!fs::is_directory(cache)) return;
  std::vector<fs::path> stages;
  std::vector<std::unique_ptr<StageLock>> locks;
  for (const auto& entry : fs::directory_iterator(cache)) {
    if (!is_stage_key(entry.path().filename().string())) continue;
    locks.push_back(std::make_unique<StageLock>(entry.path()));
    if (!locks.back()->take()) {
      fail({entry.path().string(), "a stage that nobody works at, to begin anew without it",
            "another ablation at work", "wait until it ends, or choose another --out"});
    }
    stages.push_back(entry.path());
  }
  for (const fs::path& stage : stages) fs::remove_all(stage);
}

// Whole results that are there are of the same question: others would be lost. What was stopped, or failed in part, may
// be asked otherwise.
void check_same_question(const Ablation& ablation, const AblationPlan& plan, const std::string& program,
                         const fs::path& folder) {
  const fs::path file = folder / "report.json";
  if (!fs::exists(file) || !fs::exists(folder / "ablation.yaml")) return;
  const nlohmann::json report = parse_json(read_file(file), file.string());
  for (const auto& variant : report.value("variants", nlohmann::json::array()))
    if (variant.contains("problems")) return;
  const fs::path config = folder / kRunConfiguration;
  if (!fs::exists(config)) return;
  std::set<std::string> asked{"model", "smoke", "seeds", "only", "overrides", "device"};
  if (std::any_of(plan.tasks.begin(), plan.tasks.end(), [](const StageTask& task) { return task.alone; }))
    asked.insert("threads");
  std::string stages = ablation.options.cache, others;
  for (const auto& difference : differences_from(read_file(config), config.string(), ablation.options)) {
    if (difference.key == "cache") stages = difference.before;
    if (asked.count(difference.key) == 0) continue;
    others += (others.empty() ? "" : ", ") + difference_text(difference);
  }
  if (read_file(folder / "ablation.yaml") != ablation.text)
    others = "another description" + (others.empty() ? "" : ", " + others);
  if (others.empty()) {
    std::set<std::string> before, now;
    for (const auto& stage : report.value("stages", nlohmann::json::array()))
      before.insert(stage.value("question", ""));
    for (const StageTask& task : plan.tasks) now.insert(task.question);
    // Another program has other options, which are part of the question, and begins anew in any case.
    if (report.value("program", "") != program || before.count("") > 0 || before == now) return;
    others = "other weights in the model's folder, or another file of a stage's config";
  }
  if (stages.empty() || stages == "\"\"") stages = (folder / "cache").string();
  fail(
      {folder.string(), "the question whose results are there", others,
       fmt::format(
           "choose another --out, with --cache {} to take its finished stages, or begin anew with --overwrite",
           stages)});
}

}  // namespace

AblationOutcome run_ablation(const Ablation& ablation, const ProgramCommands& commands) {
  const AblateOptions& options = ablation.options;
  const AblationPlan plan = plan_ablation(ablation, commands);
  for (const auto& [first, second] : equal_variants(ablation, plan)) {
    std::cerr << fmt::format(
        "warning: variants '{}' and '{}' are the same rows and columns of the same stages: nothing tells them apart.\n",
        first, second);
  }
  std::vector<OtherRun> others = read_other_runs(ablation, plan);
  const fs::path own_cache = fs::path(options.out) / "cache";
  const StageCache cache(options.cache.empty() ? own_cache : fs::path(options.cache));
  if (options.plan) return {plan_text(plan, cache, options.jobs_to_use()), true};

  if (!options.overwrite) check_same_question(ablation, plan, commands.version, options.out);
  RunFolder folder(options.out, "ablate", options,
                   options.overwrite ? EarlierRun::kOverwrite : EarlierRun::kContinue);
  if (options.overwrite) remove_stages(own_cache);
  write_file_atomically(folder.path() / "ablation.yaml", ablation.text);
  if (!options.json) std::cout << plan_text(plan, cache, options.jobs_to_use()) << std::flush;
  // The running stages write checkpoints before they stop.
  install_interrupt_handler(StopDeadline::kSafePoint);
  RunningOptions running{commands.program, options.jobs_to_use(), options.threads, folder.path(), {}};
  running.check_done = [&](size_t task) { check_result_columns(ablation, plan, cache, task); };
  const auto outcomes = run_tasks(plan, cache, running);

  AblationResults results;
  results.program = commands.version;
  results.numbers = collect_numbers(ablation, plan, cache, outcomes);
  add_other_runs(others, results.numbers);
  results.others = std::move(others);
  results.claims = judge_claims(ablation, results.numbers);
  const std::string markdown = ablation_markdown(ablation, plan, cache, results);
  write_file_atomically(folder.path() / "ablation.md", markdown);
  write_file_atomically(folder.path() / "ablation.csv", ablation_csv(results));
  folder.note("results", "ablation.md");
  folder.note("rows", "ablation.csv");
  const auto draw = [&](const Figure& figure, const std::string& name, const std::string& noted) {
    if (figure.panels.empty()) return;
    write_svg(figure, folder.path() / (name + ".svg"));
    write_png(figure, folder.path() / (name + ".png"));
    folder.note(noted, name + ".png");
  };
  draw(ablation_figure(ablation, results), "ablation", "plot");
  draw(claims_figure(ablation, results), "claims", "claims");
  const auto report = ablation_json(ablation, plan, cache, results);
  folder.write_report(report);
  folder.note("report", "report.json");
  write_file_atomically(folder.path() / kPageFile, page_html(ablation_page(folder.path())));
  folder.note("page", kPageFile);

  const bool complete = std::all_of(outcomes.begin(), outcomes.end(), [](const TaskOutcome& outcome) {
    return outcome.done || !outcome.needed;
  });
  if (options.json) return {json_text(report, 2) + "\n", complete};
  return {markdown + "\n" + folder.closing_box(), complete};
}

}  // namespace gld
