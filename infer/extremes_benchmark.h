#pragma once

#include "gld/options.h"
#include "gld/table.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// gld bench extremes: one table of what happens at the ends of the range of cameras, logits, norms and flows.
struct ExtremesBenchmarkOptions : OptionsGroup {
  std::string out;
  int64_t camera_sets = 10000;

  void visit(FieldVisitor& visitor) override;
};

// A measured number and the limit it must not exceed.
struct ExtremeRow {
  std::string area;
  std::string situation;
  std::string measured;
  double value = 0;
  double limit = 0;

  bool passed() const { return value <= limit; }  // NaN does not pass
};

std::vector<ExtremeRow> camera_extremes(int64_t random_sets);
std::vector<ExtremeRow> attention_extremes();
std::vector<ExtremeRow> norm_extremes();
std::vector<ExtremeRow> flow_extremes();

Table extremes_table(const std::vector<ExtremeRow>& rows);

// Writes extremes.csv, extremes.md and report.json into options.out. Returns 0 when every row passes, else 1.
int run_extremes_benchmark(const ExtremesBenchmarkOptions& options);

}  // namespace gld
