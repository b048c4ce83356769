#pragma once

#include <string>
#include <vector>

namespace gld {

// What a command that computes nothing else found out.
struct ReportText {
  std::string text;                   // for standard output, without the warnings unless it is JSON
  std::vector<std::string> warnings;  // one sentence each, which --quiet shows too
};

// Standard output shows the text, and standard error shows the warnings.
void print_report(const ReportText& report);

// Prints "warning: SENTENCE", a line each on standard error, behind what standard output was given before.
void print_warnings(const std::vector<std::string>& warnings);

}  // namespace gld
