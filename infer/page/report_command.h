#pragma once

#include "infer/page/page_options.h"

#include <filesystem>
#include <string>
#include <vector>

namespace gld {

// gld report: the page of a run, made again from its folder.
struct ReportOptions : OptionsGroup {
  PageOptions page;  // what the run was made with, where the command line says nothing
  // Keys that the command line names; not an option itself.
  std::vector<std::string> named;

  void visit(FieldVisitor& visitor) override;
};

// Writes RUN/report.html, and prints where it is and what is doubtful about the run. Throws Error for a folder that is no
// run of gld sample, a run without report.json, and one that is still written.
void report_run(const std::filesystem::path& run, const ReportOptions& options);

// The page of a run into its folder, whole or not at all; returns its bytes. For the command that writes the run.
size_t write_run_page(const std::filesystem::path& run, const PageOptions& options);

}  // namespace gld
