#pragma once

#include "gld/report/benchmark_results.h"

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// Returns what figures depend on beside the code that is measured: the program and its commit ("+": with changes),
// LibTorch, its BLAS, the processor, its vectors and its unit for every reduced precision.
nlohmann::ordered_json measured_with();

// The end of every benchmark: finish_benchmark with measured_with() in the report, and the problems, one sentence each,
// printed as warnings. Returns the exit status: 1 where there is a problem, for which figures of the run must not
// count.
int finish_measured_benchmark(RunFolder& folder, BenchmarkResults results,
                              const std::vector<std::string>& problems = {});

}  // namespace gld
