#pragma once

#include "datasets/scenes/view_sampling.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/options.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// gld bench sample-plan: what every way to sample costs and how far it ends from a converged solve of the same noise.
struct SamplePlanBenchmarkOptions : OptionsGroup {
  std::string model = "configs/tiny";
  int64_t synthetic = 16;
  int64_t synthetic_seed = 888000;  // neither training nor gld eval uses it
  std::vector<std::string> scenes;  // folders; empty: generated ones
  SyntheticOptions generator;
  ViewSampling views;
  double guidance_scale = 1.5;
  std::vector<int64_t> counts{6, 8, 10, 12, 16, 20, 24};
  std::vector<std::string> families;    // of PlanVariant beside "fewer evaluations"; empty for all
  std::vector<std::string> precisions;  // beside float32
  int64_t reference_evaluations = 64;
  int64_t repeats = 2;
  int64_t workers = 0;
  bool write_table = false;
  int64_t seed = 0;
  std::string device = "cpu";
  int64_t threads = 0;
  std::string out;
  bool overwrite = false;

  SamplePlanBenchmarkOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Writes sample_plan.csv, samples.csv, sample_plan.md, .svg, .png, plan_errors.json and report.json into options.out,
// and plan_errors.json into the bundle with write_table. Returns the exit status.
int run_sample_plan_benchmark(const SamplePlanBenchmarkOptions& options);

}  // namespace gld
