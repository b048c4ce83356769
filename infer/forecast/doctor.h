#pragma once

#include "gld/base/options.h"
#include "gld/flow/guidance.h"
#include "gld/flow/solvers/solver.h"
#include "gld/report/report_text.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

struct DoctorOptions : OptionsGroup {
  std::string model;
  int64_t views = 8;
  int64_t sources = 4;
  std::string size = "504x280";
  SolverOptions solver;
  GuidanceOptions guidance;
  int64_t threads = 0;
  bool measure = false;
  bool json = false;

  DoctorOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// gld doctor: what LibTorch, BLAS, processor and memory this program found, how fast they are, what is wrong with
// them, and with a model a forecast of sampling's time and memory with what would lower them. Text or JSON. The
// machine's rates are measured where none are kept, and with measure always; they are kept for other commands
// (infer/forecast/machine_rates.h). process_engines: what several processes of this build train by.
ReportText doctor_report(const DoctorOptions& options, const std::vector<std::string>& process_engines = {});

}  // namespace gld
