#include "gld/report/report_text.h"

#include "gld/base/printable_text.h"

#include <iostream>

namespace gld {

void print_report(const ReportText& report) {
  std::cout << report.text;
  print_warnings(report.warnings);
}

void print_warnings(const std::vector<std::string>& warnings) {
  std::cout << std::flush;
  for (const auto& warning : warnings) std::cerr << "warning: " << printable_text(warning) << "\n";
}

}  // namespace gld
