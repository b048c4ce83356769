#include "infer/forecast/plan_report.h"

#include "gld/report/progress.h"

#include <algorithm>

#include <fmt/format.h>

namespace gld {

std::string plan_text(const SamplingPlan& plan) {
  std::string text =
      fmt::format("{:<16} {:>10} {:>14} {:>10}  {}\n", "stage", "TFLOP", "time", "memory", "why");
  for (const auto& stage : plan.stages) {
    if (!stage.runs) {
      text +=
          fmt::format("{:<16} {:>10} {:>14} {:>10}  {}\n", stage.name, "-", "left out", "-", stage.reason);
      continue;
    }
    text += fmt::format("{:<16} {:>10.4g} {:>14} {:>10}  {}\n", stage.name, stage.cost.flop() / 1e12,
                        stage.seconds > 0 ? duration_text(stage.seconds) : "-", bytes_text(stage.peak_bytes),
                        stage.reason);
  }
  text +=
      fmt::format("{:<16} {:>10.4g} {:>14} {:>10}\n", "together", plan.flop() / 1e12,
                  plan.seconds() > 0 ? duration_text(plan.seconds()) : "-", bytes_text(plan.peak_bytes()));
  return text;
}

namespace {

const StageRecord* record_of(const std::vector<StageRecord>& records, const std::string& stage) {
  for (const auto& record : records) {
    if (record.name == stage) return &record;
  }
  return nullptr;
}

// Whether what was predicted of a stage is the memory of a GPU: that of the models' products, which it computes.
bool is_on_gpu(const PlannedStage& stage, const StageRecord& record) {
  return stage.of_products && record.device_bytes > 0;
}

int64_t bytes_of(const PlannedStage& stage, const StageRecord& record) {
  return is_on_gpu(stage, record) ? record.device_bytes : record.peak_bytes;
}

nlohmann::ordered_json ratio(double actual, double predicted) {
  if (predicted <= 0) return nullptr;
  return actual / predicted;
}

// Null where none were predicted: seconds of a GPU are not.
nlohmann::ordered_json seconds_or_null(double seconds) {
  return seconds > 0 ? nlohmann::ordered_json(seconds) : nlohmann::ordered_json();
}

nlohmann::ordered_json stage_json(const PlannedStage& stage) {
  return {{"stage", stage.name},
          {"runs", stage.runs},
          {"reason", stage.reason},
          {"evaluations", stage.evaluations},
          {"with_unconditional_branch", stage.with_unconditional},
          {"condition_encoder_runs", stage.parts.condition_encoder},
          {"velocity_decoder_runs", stage.parts.velocity_decoder},
          {"tflop", stage.cost.flop() / 1e12},
          {"linear_layers_in", compute_precision_name(stage.precision.linear)},
          {"attention_in", compute_precision_name(stage.precision.attention)},
          {"predicted_seconds", seconds_or_null(stage.seconds)},
          {"predicted_peak_bytes", stage.peak_bytes}};
}

}  // namespace

nlohmann::ordered_json plan_json(const SamplingPlan& plan) {
  auto list = nlohmann::ordered_json::array();
  for (const auto& stage : plan.stages) list.push_back(stage_json(stage));
  return list;
}

nlohmann::ordered_json predicted_seconds_json(const SamplingPlan& plan) {
  return seconds_or_null(plan.seconds());
}

nlohmann::ordered_json plan_json(const SamplingPlan& plan, const std::vector<StageRecord>& records) {
  auto list = nlohmann::ordered_json::array();
  for (const auto& stage : plan.stages) {
    auto object = stage_json(stage);
    if (const StageRecord* record = record_of(records, stage.name)) {
      object["seconds"] = record->seconds;
      object["seconds_over_predicted"] = ratio(record->seconds, stage.seconds);
      object["peak_bytes"] = record->peak_bytes;
      if (record->device_bytes > 0) object["device_bytes"] = record->device_bytes;
      object["peak_over_predicted"] =
          ratio(static_cast<double>(bytes_of(stage, *record)), static_cast<double>(stage.peak_bytes));
    }
    list.push_back(std::move(object));
  }
  return list;
}

std::vector<TimedStage> timed_stages(const SamplingPlan& plan, const std::vector<StageRecord>& records) {
  std::vector<TimedStage> timed;
  for (const auto& stage : plan.stages) {
    const StageRecord* record = record_of(records, stage.name);
    if (record == nullptr || !stage.of_products || !(stage.seconds > 0)) continue;
    timed.push_back({stage.precision.linear, stage.seconds, record->seconds});
  }
  return timed;
}

std::string actual_text(const SamplingPlan& plan, const std::vector<StageRecord>& records) {
  double seconds = 0;
  int64_t host = 0, gpu = 0;
  for (const auto& stage : plan.stages) {
    const StageRecord* record = record_of(records, stage.name);
    if (record == nullptr) continue;
    seconds += record->seconds;
    int64_t& most = is_on_gpu(stage, *record) ? gpu : host;
    most = std::max(most, bytes_of(stage, *record));
  }
  const std::string predicted =
      plan.seconds() > 0 ? fmt::format(" (predicted {})", duration_text(plan.seconds())) : std::string();
  return fmt::format("the planned stages took {}{} and at most {}{} (predicted {})\n", duration_text(seconds),
                     predicted, bytes_text(gpu > 0 ? gpu : host), gpu > 0 ? " of the GPU's memory" : "",
                     bytes_text(plan.peak_bytes()));
}

}  // namespace gld
