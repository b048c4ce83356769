#pragma once

#include "gld/base/options.h"
#include "gld/report/table.h"

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace gld {

// gld bench extremes makes one table of what happens at the ends of the range of cameras, logits, norms, flows,
// precisions, splats, image files, depth and the whole of a small model.
struct ExtremesBenchmarkOptions : OptionsGroup {
  std::string out;
  bool overwrite = false;
  int64_t camera_sets = 10000;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
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
std::vector<ExtremeRow> precision_extremes();
std::vector<ExtremeRow> splat_extremes();
// These three write files into an existing folder.
std::vector<ExtremeRow> image_extremes(const std::filesystem::path& folder);
std::vector<ExtremeRow> depth_extremes(const std::filesystem::path& folder);
std::vector<ExtremeRow> forward_extremes(const std::filesystem::path& folder);

// An area is asked with these.
struct ExtremeSettings {
  int64_t camera_sets = 10000;   // random ones
  std::filesystem::path folder;  // an existing one, for files
};

// The one list of what is checked: gld bench extremes reports it, and the tests run each area of it.
struct ExtremeArea {
  std::string name;
  std::function<std::vector<ExtremeRow>(const ExtremeSettings&)> rows;
};
const std::vector<ExtremeArea>& extreme_areas();

// Returns for example "norms, RMS 1e-30: relative error is 2e-06, expected at most 1e-06."
std::string extreme_text(const ExtremeRow& row);

// Returns 0 when the action ends with an Error, as it should, else 1.
double accepted(const std::function<void()>& action);

Table extremes_table(const std::vector<ExtremeRow>& rows);

// Writes extremes.csv, extremes.md and report.json into options.out. Returns 0 when every row passes, else 1.
int run_extremes_benchmark(const ExtremesBenchmarkOptions& options);

}  // namespace gld
