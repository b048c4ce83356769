#pragma once

#include "gld/page/page.h"

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace gld {

// A page is called this in a run folder.
inline constexpr const char* kPageFile = "report.html";

// How the page of a command's runs is made from their folder.
struct PageMaker {
  std::string command;  // "sample"; "train" is that of "train level" too
  std::function<Page(const std::filesystem::path& run)> make;
  // Of a run without report.json, which was stopped or killed; may be empty.
  std::function<Page(const std::filesystem::path& run)> make_of_stopped = nullptr;
};

// gld report: writes RUN/report.html, and prints where it is and what is doubtful about the run. Throws Error for a
// folder that is no run of these commands, a run without report.json whose command has no page of it, and one that is
// still written.
void report_run(const std::filesystem::path& run, const std::vector<PageMaker>& makers);

}  // namespace gld
