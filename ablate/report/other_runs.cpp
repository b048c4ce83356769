#include "ablate/report/other_runs.h"

#include "ablate/report/result_rows.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"

#include <algorithm>
#include <map>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr const char* kWhere = "--with-runs";

// By stage, what its tasks ask: several, where variants give a stage other options. The other run may have asked more.
using Questions = std::map<std::string, std::set<std::string>>;

Questions questions_of(const AblationPlan& plan) {
  Questions questions;
  for (const StageTask& task : plan.tasks) questions[task.stage].insert(task.question);
  return questions;
}

[[noreturn]] void refuse_report(const fs::path& folder) {
  fail({(folder / "report.json").string(), "the report of gld ablate", "another file",
        "give --with-runs folders that gld ablate wrote"});
}

Json read_report(const fs::path& folder) {
  const fs::path file = folder / "report.json";
  if (!fs::is_regular_file(file) || !fs::is_regular_file(folder / "ablation.csv")) {
    fail({kWhere, "the run folder of a finished gld ablate",
          "'" + folder.string() + "' without report.json and ablation.csv",
          "let that ablation end, or leave the folder out"});
  }
  Json report = parse_json(read_file(file), file.string());
  const auto is_list = [&](const char* key) { return report.contains(key) && report.at(key).is_array(); };
  if (!is_list("variants") || !is_list("stages")) refuse_report(folder);
  if (!is_list("seeds")) {
    fail(
        {file.string(), "the seeds and the questions of its stages",
         "the report of a program that did not note them",
         "run it again with --overwrite: stages that are done in its cache are taken where the program is the same"});
  }
  return report;
}

void check_questions(const Json& report, const fs::path& folder, const AblationPlan& plan) {
  Questions others;
  for (const Json& stage : report.at("stages"))
    others[stage.value("stage", "")].insert(stage.value("question", ""));
  for (const auto& [stage, questions] : questions_of(plan)) {
    const auto found = others.find(stage);
    const bool has_all = found != others.end() && std::includes(found->second.begin(), found->second.end(),
                                                                questions.begin(), questions.end());
    if (has_all) continue;
    fail(
        {kWhere, fmt::format("stage '{}' as it is here in everything but its seed", stage),
         fmt::format("{} in '{}'", found == others.end() ? "none" : "another one", folder.string()),
         "give it the same description, model, --overrides, --threads and --smoke, or leave the folder out"});
  }
}

// Returns what a variant's results answer, as the report noted it, or as its stages say that it did not yet.
Json question_of(const Json& report, const std::string& variant, const Json& reads) {
  if (reads.contains("question")) return reads.at("question");
  std::set<std::string> questions;
  for (const Json& stage : report.at("stages")) {
    if (stage.value("stage", "") != reads.value("stage", "")) continue;
    const auto users = stage.value("used_by", std::vector<std::string>());
    const bool used = std::any_of(users.begin(), users.end(), [&](const std::string& user) {
      return user.rfind(variant + ", seed ", 0) == 0;
    });
    if (used) questions.insert(stage.value("question", ""));
  }
  return fmt::format("{}", fmt::join(questions, " "));
}

void check_numbers_read(const Json& report, const fs::path& folder, const Json& here) {
  if (!report.contains("reads")) {
    fail({(folder / "report.json").string(), "which numbers it compares",
          "the report of a program that did not note them", "run it again, or leave the folder out"});
  }
  for (const auto& [variant, entry] : here.items()) {
    const Json there = report.at("reads").value(variant, Json::object());
    if (question_of(report, variant, there) != entry.at("question")) {
      fail(
          {kWhere, fmt::format("variant '{}' as it is here in everything but its seed", variant),
           fmt::format("another one of that name in '{}'", folder.string()),
           "give it the same description, model, --overrides, --threads and --smoke, or leave the folder out"});
    }
    for (const auto& [key, value] : entry.items()) {
      if (key == "question" || there.value(key, Json()) == value) continue;
      fail({kWhere, fmt::format("the same numbers, of variant '{}' {}: {}", variant, key, value.dump()),
            fmt::format("{} in '{}'", there.value(key, Json()).dump(), folder.string()),
            "give it the same description, or leave the folder out"});
    }
  }
}

// A metric without a row was absent in every scene.
std::vector<VariantNumbers> read_numbers(const Ablation& ablation, const OtherRun& run) {
  const ResultRows rows = read_result_rows(run.folder / "ablation.csv");
  const auto found = [&](const std::map<std::string, std::string>& where) {
    return any_row(rows, where) ? numbers_by_scene(rows, "value", where)
                                : std::map<std::string, std::map<std::string, double>>();
  };
  std::vector<VariantNumbers> all;
  for (const VariantDescription& variant : ablation.variants) {
    VariantNumbers numbers;
    numbers.variant = variant.name;
    for (const int64_t seed : run.seeds) {
      const std::string number = std::to_string(seed);
      if (!any_row(rows, {{"variant", variant.name}, {"seed", number}})) {
        fail({rows.file.string(), fmt::format("rows of variant '{}', seed {}", variant.name, seed), "none",
              "run that ablation without --only, or this one with it"});
      }
      for (const MetricDescription& metric : ablation.metrics) {
        numbers.metrics[metric.name][seed] =
            found({{"variant", variant.name}, {"seed", number}, {"metric", metric.name}});
      }
    }
    all.push_back(std::move(numbers));
  }
  return all;
}

// Returns what the run says of itself; owners says of each seed so far whose it is.
OtherRun described_run(const fs::path& folder, const Json& report, std::map<int64_t, std::string>& owners) {
  OtherRun run;
  run.folder = folder;
  run.program = report.value("program", "");
  for (const Json& entry : report.at("seeds")) {
    const int64_t seed = run.seeds.emplace_back(entry.get<int64_t>());
    const auto [owner, is_new] = owners.emplace(seed, "that of '" + folder.string() + "'");
    if (is_new) continue;
    fail({kWhere, "every seed once",
          fmt::format("seed {} of '{}', which is {} too", seed, folder.string(), owner->second),
          "choose other --seeds, or leave the folder out"});
  }
  for (const Json& variant : report.at("variants")) {
    if (!variant.contains("problems")) continue;
    fail({kWhere, "a run in which everything ran",
          fmt::format("'{}', whose variant '{}' did not", folder.string(), variant.value("name", "")),
          "run its command again, or leave the folder out"});
  }
  for (const Json& stage : report.at("stages")) run.seconds += stage.value("seconds", 0.0);
  return run;
}

}  // namespace

nlohmann::ordered_json numbers_read(const Ablation& ablation, const AblationPlan& plan) {
  nlohmann::ordered_json reads;
  for (const VariantRun& run : plan.runs) {
    const VariantDescription& variant = ablation.variants[run.variant];
    const std::string& stage = plan.tasks[run.results.front()].stage;
    std::set<std::string> questions;
    for (const size_t result : run.results) questions.insert(plan.tasks[result].question);
    nlohmann::ordered_json entry{{"stage", stage},
                                 {"question", fmt::format("{}", fmt::join(questions, " "))},
                                 {"file", ablation.stage(stage).results},
                                 {"rows", variant.rows}};
    for (const MetricDescription& metric : ablation.metrics)
      entry["metric " + metric.name] = {{"column", column_of(variant, metric)}, {"better", metric.better}};
    reads[variant.name] = std::move(entry);
  }
  return reads;
}

std::vector<OtherRun> read_other_runs(const Ablation& ablation, const AblationPlan& plan) {
  std::map<int64_t, std::string> owners;
  for (const int64_t seed : ablation.options.seeds) owners[seed] = "this ablation's";
  std::vector<OtherRun> others;
  for (const std::string& name : ablation.options.with_runs) {
    const Json report = read_report(name);
    try {
      others.push_back(described_run(name, report, owners));
      check_questions(report, name, plan);
      check_numbers_read(report, name, numbers_read(ablation, plan));
    } catch (const Json::exception&) {  // something in it is of another kind
      refuse_report(name);
    }
    others.back().numbers = read_numbers(ablation, others.back());
  }
  return others;
}

void add_other_runs(const std::vector<OtherRun>& others, std::vector<VariantNumbers>& numbers) {
  for (const OtherRun& other : others) {
    for (size_t i = 0; i < numbers.size(); ++i) {
      for (const auto& [metric, by_seed] : other.numbers[i].metrics)
        numbers[i].metrics[metric].insert(by_seed.begin(), by_seed.end());
    }
  }
}

}  // namespace gld
