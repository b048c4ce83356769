#include "gld/page/run_page.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/printable_text.h"
#include "gld/base/run_journal.h"
#include "gld/report/report_text.h"
#include "gld/report/run_folder.h"

#include <system_error>

namespace gld {
namespace {

constexpr const char* kRemedy = "name the folder that the command wrote with --out";

// Returns "sample", for example.
std::string known_command_of_run(const std::filesystem::path& run) {
  std::error_code error;
  if (!std::filesystem::is_directory(run, error)) {
    fail({run.string(), "the folder of a run", std::filesystem::exists(run, error) ? "a file" : "nothing",
          kRemedy});
  }
  std::string command = command_of_run(run);
  if (command.empty()) {
    fail({run.string(), "the folder of a run, with config.yaml", "a folder without it", kRemedy});
  }
  return command;
}

bool has_report(const std::filesystem::path& run) {
  std::error_code error;
  return std::filesystem::exists(run / "report.json", error);
}

[[noreturn]] void refuse_unfinished(const std::filesystem::path& run) {
  fail({run.string(), "a finished run, with report.json", "one that was stopped before",
        "finish it with --resume, or run the command again"});
}

// "train level" is a run of "train".
bool makes(const PageMaker& maker, const std::string& command) {
  return command == maker.command || command.rfind(maker.command + " ", 0) == 0;
}

const PageMaker& maker_of(const std::filesystem::path& run, const std::vector<PageMaker>& makers) {
  const std::string command = known_command_of_run(run);
  std::string known;
  for (const PageMaker& maker : makers) {
    if (makes(maker, command)) return maker;
    known += (known.empty() ? "" : ", ") + maker.command;
  }
  fail({run.string(), "a run of gld " + known, "one of gld " + printable_text(command),
        "look at report.json and the pictures beside it"});
}

std::string megabytes(size_t bytes) {
  const size_t tenths = (bytes + 50'000) / 100'000;
  return std::to_string(tenths / 10) + "." + std::to_string(tenths % 10) + " MB";
}

}  // namespace

void report_run(const std::filesystem::path& run, const std::vector<PageMaker>& makers) {
  const PageMaker& maker = maker_of(run, makers);
  RunJournal::refuse_running(run);
  const bool finished = has_report(run);
  if (!finished && !maker.make_of_stopped) refuse_unfinished(run);
  const Page page = finished ? maker.make(run) : maker.make_of_stopped(run);
  const std::string html = page_html(page);
  {
    // The journal is open so that a later run with --overwrite knows the page for a file of this one.
    const RunJournal journal(run);
    write_file_atomically(run / kPageFile, html);
  }
  const std::string asked = page.asked.empty() ? "" : printable_text(page.asked) + "\n";
  print_report({asked + printable_text(page.verdict) + "\n" + printable_text((run / kPageFile).string()) +
                    " (" + megabytes(html.size()) + ")\n",
                page.doubts});
}

}  // namespace gld
