#include "bench/processes/process_benchmark.h"

#include "bench/support/benchmark_report.h"
#include "bench/training/repeated_scene.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/distributed/shared_work.h"
#include "gld/machine/timing.h"
#include "gld/report/run_folder.h"
#include "gld/tensors/compute_threads.h"
#include "gld/tensors/torch_version.h"
#include "models/bundle/bundle.h"
#include "train/loop/micro_batches.h"

#include <algorithm>
#include <limits>
#include <optional>

#include <torch/types.h>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr double kKilobyte = 1024;

double median(const std::vector<double>& values) { return spread_of(values).median; }

struct ExchangeRow {
  double bytes = 0;
  double adding = 0;     // seconds, medians
  double gathering = 0;  // seconds
};

ExchangeRow measure_exchange(ProcessTeam& team, int64_t floats, int64_t repeats) {
  const auto given = torch::ones({floats});
  auto whole = torch::empty_like(given);
  std::vector<double> adding, gathering;
  for (int64_t repeat = 0; repeat <= repeats; ++repeat) {
    auto owned = torch::zeros({team.piece_length(floats)});
    team.gather("");  // all begin together
    const double first = seconds_of([&] { team.add_at_owners(given, owned); });
    team.gather("");
    const double second = seconds_of([&] { team.gather_pieces(owned, whole); });
    if (repeat == 0) continue;  // connections are made
    adding.push_back(first);
    gathering.push_back(second);
  }
  return {static_cast<double>(floats) * sizeof(float), median(adding), median(gathering)};
}

struct MeasuredStep {
  double seconds = 0;        // medians
  double communicating = 0;  // of these; waiting for a slower process included
};

MeasuredStep measure_step(Objective& objective, ProcessTeam& team, const ProcessBenchmarkOptions& options) {
  FlatParameters parameters(objective.parameters());
  const std::vector<MicroBatch> own(static_cast<size_t>(options.micro_batches));
  MicroBatchWork work;
  std::vector<double> seconds, communicating;
  for (int64_t repeat = 0; repeat <= options.repeats; ++repeat) {
    parameters.zero_gradients();
    team.gather("");
    team.take_communication_seconds();
    const double taken = seconds_of([&] {
      if (team.alone()) {
        add_gradients(objective, parameters, own, work);
      } else {
        add_gradients_of_all(team, objective, parameters, own, options.micro_batches * team.count(), work);
      }
    });
    if (repeat == 0) continue;
    seconds.push_back(taken);
    communicating.push_back(team.take_communication_seconds());
  }
  return {median(seconds), median(communicating)};
}

Table message_table(const std::vector<ExchangeRow>& rows) {
  Table table({"bytes", "adding_seconds", "gathering_seconds"});
  for (const auto& row : rows) table.add_row({row.bytes, row.adding, row.gathering});
  return table;
}

Table forecast_table(const std::vector<ForecastStep>& steps, int64_t micro_batches) {
  Table table({"processes", "micro_batches", "computing_seconds", "communicating_seconds", "efficiency",
               "times_one_process"});
  for (const auto& step : steps) {
    table.add_row({step.processes, step.processes * micro_batches, step.computing, step.communicating,
                   step.efficiency(), static_cast<double>(step.processes) * step.efficiency()});
  }
  return table;
}

std::string cost_text(const std::string& what, const MessageCost& cost) {
  return fmt::format("{}: {:.3g} ms for each other process and {:.3g} GB/s", what, 1e3 * cost.latency,
                     1e-9 * cost.rate);
}

}  // namespace

double MessageCost::seconds(double bytes, int64_t processes) const {
  const auto others = static_cast<double>(processes - 1);
  return others * latency + bytes * others / static_cast<double>(processes) / rate;
}

MessageCost message_cost(const std::vector<MeasuredExchange>& exchanges, int64_t processes) {
  const auto smaller = [](const MeasuredExchange& a, const MeasuredExchange& b) { return a.bytes < b.bytes; };
  const auto [least, most] = std::minmax_element(exchanges.begin(), exchanges.end(), smaller);
  if (processes < 2 || exchanges.empty() || !(least->bytes < most->bytes)) {
    fail({"message cost", "exchanges of two sizes at least, between two processes at least",
          fmt::format("{} between {}", exchanges.size(), processes), "measure more"});
  }
  const auto others = static_cast<double>(processes - 1);
  const double moved = (most->bytes - least->bytes) * others / static_cast<double>(processes);
  const double longer = most->seconds - least->seconds;
  MessageCost cost;
  cost.rate = longer > 0 ? moved / longer : std::numeric_limits<double>::infinity();
  const double sent = least->bytes * others / static_cast<double>(processes) / cost.rate;
  cost.latency = std::max(0.0, (least->seconds - sent) / others);
  return cost;
}

ForecastStep forecast_step(const StepToForecast& step, const MessageCost& add, const MessageCost& gather,
                           int64_t processes) {
  ForecastStep forecast;
  forecast.processes = processes;
  forecast.computing = step.computing;
  if (processes > 1) {
    forecast.communicating =
        static_cast<double>(step.micro_batches) * add.seconds(step.gradient_bytes, processes) +
        gather.seconds(step.gradient_bytes, processes);
  }
  return forecast;
}

void ProcessBenchmarkOptions::visit(FieldVisitor& visitor) {
  visit_out(visitor, out, overwrite);
  visitor.text({"model", "folder with a model.yaml, whose first generator is trained"}, model);
  visitor.group(
      {"processes", "several processes that train together; torchrun sets the environment that is meant"},
      processes);
  visitor.integer({"micro_batches", "of each process in a step"}, micro_batches, {1, 1000});
  visitor.integers({"message_kilobytes", "sizes of the gradients whose exchange is timed"}, message_kilobytes,
                   {1, 10'000'000});
  visitor.integers({"forecast", "numbers of processes to forecast a step for"}, forecast, {1, 1'000'000});
  visitor.real(
      {"forecast_rate",
       "operations a second that a process of the forecast computes, as gld bench forward measures them; 0: "
       "as these do"},
      forecast_rate, {0, 1e18});
  visitor.integer({"repeats", "measurements of each, of which the median counts"}, repeats, {1, 1000});
  visit_threads(visitor, threads);
}

void ProcessBenchmarkOptions::check() const {
  check_out(out, "runs/bench");
  if (message_kilobytes.size() < 2 ||
      *std::min_element(message_kilobytes.begin(), message_kilobytes.end()) ==
          *std::max_element(message_kilobytes.begin(), message_kilobytes.end())) {
    fail({"--message-kilobytes", "two different sizes at least", message_kilobytes.empty() ? "none" : "one",
          "write for example --message-kilobytes 16,4096"});
  }
}

int run_process_benchmark(const ProcessBenchmarkOptions& options) {
  const ProcessShare share = join_others(options.processes);
  if (share.team->alone()) {
    fail({"gld bench processes", "two processes at least", "one",
          "start it with torchrun, or in each process with --processes.count and so on"});
  }
  ProcessTeam& team = *share.team;
  std::optional<RunFolder> folder;
  if (share.leads()) folder.emplace(options.out, "bench processes", options, earlier_run(options.overwrite));
  use_threads(share.threads(options.threads));
  const auto opened = ModelBundle::open(options.model);
  check_same_work(team, options, opened.content_hash());
  const BundleOptions& bundle = opened.options();
  const ImageSize image = image_size_from_text(bundle.trained_sizes.front(), "trained_sizes");
  RepeatedScene objective(bundle, bundle.generators.front().dit, {4, 2, image});
  StepToForecast step;
  step.micro_batches = options.micro_batches;
  for (const auto& item : objective.parameters()) {
    step.gradient_bytes += static_cast<double>(item.parameter.numel()) * sizeof(float);
  }

  std::vector<ExchangeRow> rows;
  std::vector<MeasuredExchange> adding, gathering;
  for (const int64_t kilobytes : options.message_kilobytes) {
    rows.push_back(
        measure_exchange(team, static_cast<int64_t>(kKilobyte / sizeof(float)) * kilobytes, options.repeats));
    adding.push_back({rows.back().bytes, rows.back().adding});
    gathering.push_back({rows.back().bytes, rows.back().gathering});
  }
  // A process runs alone while the others compute the same: what they take from each other of caches and memory is part
  // of it.
  team.gather("");
  TeamOfOne itself;
  const MeasuredStep alone = measure_step(objective, itself, options);
  const MeasuredStep together = measure_step(objective, team, options);
  team.finish();
  if (!share.leads()) return 0;

  const MessageCost add = message_cost(adding, team.count()), gather = message_cost(gathering, team.count());
  step.computing = alone.seconds;
  const double flop = kForwardsAStep * static_cast<double>(options.micro_batches) * objective.flop();
  const ForecastStep check = forecast_step(step, add, gather, team.count());
  if (options.forecast_rate > 0) step.computing = flop / options.forecast_rate;
  std::vector<ForecastStep> forecasts;
  for (const int64_t processes : options.forecast)
    forecasts.push_back(forecast_step(step, add, gather, processes));

  BenchmarkResults results;
  results.text = fmt::format(
      "# Processes that train together\n\n"
      "{} processes of {} threads, {} micro-batches each in a step, {:.1f} MB of gradients. A step takes {:.3g} s, of "
      "which {:.3g} s are communication and waiting; computing alone, beside the others, {:.3g} s. From the messages below {:.3g} "
      "s of communication were to be expected.\n\n"
      "{}; {}.\n\n{}\n"
      "A step in other numbers of processes, each with as many micro-batches{}, at these message costs:\n\n{}",
      team.count(), thread_count(), options.micro_batches, 1e-6 * step.gradient_bytes, together.seconds,
      together.communicating, alone.seconds, check.communicating,
      cost_text("Adding gradients at their owners", add), cost_text("gathering the sums", gather),
      message_table(rows).markdown(),
      options.forecast_rate > 0 ? fmt::format(" computed at {:.3g} TFLOP/s", 1e-12 * options.forecast_rate)
                                : "",
      forecast_table(forecasts, options.micro_batches).markdown());
  results.files = {{"messages.csv", message_table(rows).csv()},
                   {"steps.csv", forecast_table(forecasts, options.micro_batches).csv()},
                   {"processes.md", results.text}};
  results.report = {{"command", "bench processes"},
                    {"options", to_json(options)},
                    {"processes", team.count()},
                    {"threads", thread_count()},
                    {"gradient_bytes", step.gradient_bytes},
                    {"step_seconds", together.seconds},
                    {"communicating_seconds", together.communicating},
                    {"computing_seconds", alone.seconds},
                    {"expected_communicating_seconds", check.communicating},
                    {"flop", flop},
                    {"add_latency", add.latency},
                    {"add_rate", add.rate},
                    {"gather_latency", gather.latency},
                    {"gather_rate", gather.rate}};
  results.notes = {{"messages", "messages.csv"}, {"forecast", "steps.csv"}, {"tables", "processes.md"}};
  return finish_measured_benchmark(*folder, results);
}

}  // namespace gld
