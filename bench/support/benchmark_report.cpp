#include "bench/support/benchmark_report.h"

#include "gld/machine/instruction_set.h"
#include "gld/machine/matrix_unit.h"
#include "gld/machine/processor_name.h"
#include "gld/report/provenance.h"
#include "gld/report/report_text.h"
#include "gld/tensors/torch_version.h"

#include <utility>

#include <gld_commit.h>

namespace gld {

nlohmann::ordered_json measured_with() {
  nlohmann::ordered_json units;
  for (const auto precision : {ComputePrecision::kBFloat16, ComputePrecision::kInt8}) {
    units[compute_precision_name(precision)] = matrix_unit_name(best_matrix_unit(precision), precision);
  }
  return {{"program", program_version()},  {"commit", GLD_COMMIT},
          {"libtorch", torch_version()},   {"blas", blas_text()},
          {"processor", processor_name()}, {"vectors", instruction_set_name(best_instruction_set())},
          {"matrix_units", units}};
}

int finish_measured_benchmark(RunFolder& folder, BenchmarkResults results,
                              const std::vector<std::string>& problems) {
  results.report["measured_with"] = measured_with();
  results.report["problems"] = problems;
  finish_benchmark(folder, results);
  print_warnings(problems);
  return problems.empty() ? 0 : 1;
}

}  // namespace gld
