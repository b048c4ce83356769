#include "bench/solvers/solver_benchmark.h"

#include "bench/solvers/solver_benchmark_figures.h"
#include "bench/solvers/stiff_benchmark.h"
#include "gld/base/atomic_file.h"
#include "gld/tensors/weight_tensors.h"
#include "tests/support/temporary_folder.h"

#include <cmath>
#include <set>
#include <sstream>

#include <ATen/core/grad_mode.h>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

FlowProblem small_problem() {
  RandomMixtureOptions options;
  options.dimensions = 6;
  options.components = 3;
  options.conditional_components = 1;
  options.samples = 5;
  options.solution_tolerance = 1e-6;
  auto problem = random_mixture_problem(options);
  problem.name = "mixture";
  return problem;
}

void write_problem(const FlowProblem& problem, const std::filesystem::path& file) {
  save_safetensors(file, {{"means", problem.mixture.means},
                          {"variances", problem.mixture.variances},
                          {"weights", problem.mixture.weights},
                          {"conditional_components", torch::tensor(problem.conditional_components)},
                          {"guidance_scale", torch::full({1}, problem.guidance_scale, torch::kFloat64)},
                          {"noise", problem.noise},
                          {"solution", problem.solution},
                          {"standard_deviation", problem.standard_deviation}});
}

TEST(SolverBenchmark, SweepsEverySolverScheduleAndCount) {
  SolverBenchmarkOptions options;
  options.counts = {4, 12};
  options.tolerances = {1e-2, 1e-4};
  const auto rows = sweep_solvers(small_problem(), options);
  std::set<std::string> solvers, schedules;
  for (const auto& row : rows) {
    solvers.insert(row.solver);
    schedules.insert(row.schedule);
    EXPECT_EQ(row.problem, "mixture");
    EXPECT_EQ(row.non_finite, 0);
    EXPECT_LE(row.error_rms, row.error_max);
    if (row.budget > 0) {
      EXPECT_LE(row.evaluations, std::max<int64_t>(row.budget, 4));
    }
  }
  EXPECT_EQ(solvers.size(), 13u);  // all but the stochastic ones and rodas3
  EXPECT_THAT(schedules, testing::ElementsAre("karras", "logsnr", "published", "shifted", "tolerance 0.0001",
                                              "tolerance 0.01", "uniform"));
  EXPECT_EQ(rows.size(), 11u * 5 * 2 + 2 * 2);
  const auto csv = solver_table(rows).csv();
  EXPECT_EQ(csv.substr(0, csv.find('\n')),
            "problem,solver,schedule,evaluations,accepted,rejected,seconds,error_rms,error_max,non_finite");
  EXPECT_EQ(work_precision_figure(rows).panels.size(), 2u);
}

// A solve that stops is a row without an error, never a wrong number.
TEST(SolverBenchmark, FailedSolvesHaveNoError) {
  auto problem = small_problem();
  problem.mixture.means.fill_(1e308);
  SolverOptions options;
  options.solver = SolverKind::kEuler;
  const auto row = solve_problem(problem, options);
  EXPECT_EQ(row.non_finite, 1);
  EXPECT_TRUE(std::isnan(row.error_rms));
}

// The problem follows from the options alone, not from what lies beside the folder that the program runs in.
TEST(SolverBenchmark, TheProblemIsBuiltInUnlessAFileIsNamed) {
  const test::TemporaryFolder folder;
  std::filesystem::create_directories(folder.path() / "shared" / "problems");
  std::filesystem::create_directories(folder.path() / "project");
  const auto file = folder.path() / "shared" / "problems" / "mixture.safetensors";
  write_problem(small_problem(), file);
  const auto before = std::filesystem::current_path();
  std::filesystem::current_path(folder.path() / "project");
  SolverBenchmarkOptions options;
  const auto built_in = benchmark_problem(options);
  std::filesystem::current_path(before);
  EXPECT_EQ(built_in.noise.sizes(), (std::vector<int64_t>{192, 48}));
  options.problem = file.string();
  EXPECT_EQ(benchmark_problem(options).noise.sizes(), (std::vector<int64_t>{5, 6}));
}

TEST(SolverBenchmark, WritesItsRunFolder) {
  const test::TemporaryFolder folder;
  write_problem(small_problem(), folder.path() / "other.safetensors");
  SolverBenchmarkOptions options;
  options.problem = (folder.path() / "other.safetensors").string();
  options.out = (folder.path() / "run").string();
  options.counts = {6, 12};  // without the 16 of the widths' figure
  options.tolerances = {1e-3};
  testing::internal::CaptureStdout();
  EXPECT_EQ(run_solver_benchmark(options), 0);
  EXPECT_THAT(testing::internal::GetCapturedStdout(), testing::HasSubstr("solvers.csv"));
  const std::filesystem::path run = options.out;
  for (const char* name :
       {"config.yaml", "solvers.csv", "solvers.md", "guidance.csv", "stochastic.csv", "report.json",
        "work_precision.svg", "work_precision.png", "schedules.png", "widths.svg"}) {
    EXPECT_TRUE(std::filesystem::exists(run / name)) << name;
  }
  EXPECT_THAT(read_file(run / "solvers.csv"), testing::HasSubstr("\nmixture,unipc3,logsnr,12,"));
  const auto report = nlohmann::json::parse(read_file(run / "report.json"));
  EXPECT_EQ(report["targets"].size(), 0u);  // another problem than theirs
  EXPECT_THAT(read_file(run / "solvers.md"),
              testing::HasSubstr("another mixture than that of docs/RESULTS.md"));
  EXPECT_EQ(report["default_solver"], "unipc3");
}

TEST(StiffBenchmark, EveryRowIsFinishedWithAnErrorOrFailedWithAReason) {
  StiffBenchmarkOptions options;
  options.tolerances = {1e-3};
  options.max_evaluations = 3000;
  options.fixed_evaluations = 200;
  const auto rows = stiff_rows(options);
  EXPECT_EQ(rows.size(), 8u * 8);
  for (const auto& row : rows) {
    EXPECT_EQ(row.finished, row.outcome == "finished");
    EXPECT_EQ(row.finished, std::isfinite(row.error));
    if (row.solver == "rodas3") {
      EXPECT_TRUE(row.finished) << row.problem << " " << row.outcome;
    }
    if (row.problem == "prothero_robinson_1e6" && row.solver != "rodas3") {
      EXPECT_FALSE(row.finished) << row.solver;
    }
  }
}

}  // namespace
}  // namespace gld
