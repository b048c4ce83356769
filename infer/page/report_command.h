#pragma once

#include "gld/page/run_page.h"
#include "infer/page/page_options.h"

#include <filesystem>
#include <string>
#include <vector>

namespace gld {

// What gld report is told of the page of a run of gld sample.
struct ReportOptions : OptionsGroup {
  PageOptions page;  // what the run was made with, where the command line says nothing
  // Keys that the command line names; not an option itself.
  std::vector<std::string> named;

  void visit(FieldVisitor& visitor) override;
};

// For report_run(). The options must outlive it.
PageMaker sample_page_maker(const ReportOptions& options);

// Writes the page of a run of gld sample into its folder, whole or not at all; returns its bytes. It is for the command
// that writes the run.
size_t write_run_page(const std::filesystem::path& run, const PageOptions& options);

}  // namespace gld
