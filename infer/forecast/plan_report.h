#pragma once

#include "gld/machine/stage_record.h"
#include "infer/forecast/machine_rates.h"
#include "infer/forecast/sampling_plan.h"

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

// A plan for people and for report.json, before a run and beside what it took.
namespace gld {

// Returns a table, one line a stage, for people.
std::string plan_text(const SamplingPlan& plan);
nlohmann::ordered_json plan_json(const SamplingPlan& plan);

// Returns the seconds of all stages; null where none were predicted.
nlohmann::ordered_json predicted_seconds_json(const SamplingPlan& plan);

// Returns the same with what every stage took: seconds, peak memory, and both over what was predicted.
nlohmann::ordered_json plan_json(const SamplingPlan& plan, const std::vector<StageRecord>& records);
// Returns what learn_from_run() (infer/forecast/machine_rates.h) takes.
std::vector<TimedStage> timed_stages(const SamplingPlan& plan, const std::vector<StageRecord>& records);
// Returns one line: the planned stages' seconds and peak memory together, as they were and as predicted.
std::string actual_text(const SamplingPlan& plan, const std::vector<StageRecord>& records);

}  // namespace gld
