#pragma once

#include "bench/solvers/solver_benchmark.h"
#include "gld/report/plot.h"

#include <vector>

namespace gld {

// The figure shows the error of the mixture against evaluations and against seconds: every solver on its log-SNR grid,
// the published sampler, the adaptive solvers, the targets and the Pareto front over all rows.
Figure work_precision_figure(const std::vector<SolverRow>& rows);
// The figure shows the error of the mixture against evaluations by schedule, for Euler and for the default solver.
Figure schedule_figure(const std::vector<SolverRow>& rows);
// The figure shows the error of the single Gaussians against their width, at 16 evaluations.
Figure width_figure(const std::vector<SolverRow>& rows);

// Returns the targets on the mixture for one rule of the grid: evaluations and error.
const std::vector<std::pair<double, double>>& mixture_targets();

}  // namespace gld
