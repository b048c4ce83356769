#pragma once

#include "gld/base/options.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// gld export makes of a run of gld sample formats that other programs take as they are.
struct ExportOptions : OptionsGroup {
  std::string run;
  std::vector<std::string> as;
  std::string out;
  bool overwrite = false;
  int64_t max_points = 300'000;
  int64_t surface_vertices = 500'000;
  double edge_step = 0.02;
  double far_limit = 20;
  int64_t between = 0;
  int64_t views_per_second = 4;
  // Keys of the options that the command line names.
  std::vector<std::string> named;

  void visit(FieldVisitor& visitor) override;
  // Checks that the formats exist, each once, and that something looks at each option that was named.
  void check() const override;
};

// Returns "glb", "colmap", "nerfstudio", "webp", "mp4".
const std::vector<std::string>& export_format_names();

// Reads the run's folder and nothing else; writes scene.glb, colmap/, nerfstudio/, path.webp, path.mp4, those that are
// asked for, and report.json into options.out. Each is there whole or not at all, and has the same bytes whatever is
// asked for beside it. What is missing in the run is an Error before anything is written. It stops between files and
// pictures on Ctrl-C.
void run_export(const ExportOptions& options);

}  // namespace gld
