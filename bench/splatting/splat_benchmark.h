#pragma once

#include "bench/splatting/splat_errors.h"
#include "bench/splatting/splat_speed.h"
#include "gld/base/options.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// gld bench splat times splatting beside LibTorch's dense rendering, and what fits reach in which time, on a drawn
// room.
struct SplatBenchmarkOptions : OptionsGroup {
  std::string out;
  bool overwrite = false;
  int64_t room = 0;  // of gld synth's seed 0
  int64_t views = 20;
  int64_t threads = 0;
  SplatSpeedSettings speed;
  SplatErrorSettings errors;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Writes splat_speed.csv, splat_fits.csv, splat_features.csv, splat.md, splat.svg, splat.png and report.json into
// options.out. Returns the exit status.
int run_splat_benchmark(const SplatBenchmarkOptions& options);

}  // namespace gld
