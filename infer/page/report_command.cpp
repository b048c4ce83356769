#include "infer/page/report_command.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/printable_text.h"
#include "gld/base/run_journal.h"
#include "gld/report/report_text.h"
#include "infer/page/run_words.h"
#include "infer/page/sample_page.h"

#include <algorithm>
#include <fstream>
#include <iostream>
#include <system_error>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr const char* kRemedy = "name the folder that the command wrote with --out";

// "sample", of the first line of config.yaml.
std::string command_of_run(const std::filesystem::path& run) {
  std::error_code error;
  if (!std::filesystem::is_directory(run, error)) {
    fail({run.string(), "the folder of a run", std::filesystem::exists(run, error) ? "a file" : "nothing",
          kRemedy});
  }
  std::ifstream stream(run / kRunConfiguration);
  std::string line;
  std::getline(stream, line);
  const std::string start = "# gld ";
  const auto end = line.find(": the options");
  if (line.rfind(start, 0) != 0 || end == std::string::npos) {
    fail({run.string(), "the folder of a run, with config.yaml", "a folder without it", kRemedy});
  }
  return line.substr(start.size(), end - start.size());
}

void require_report(const std::filesystem::path& run) {
  std::error_code error;
  if (std::filesystem::exists(run / "report.json", error)) return;
  fail({run.string(), "a finished run, with report.json", "one that was stopped before",
        "finish it with --resume, or run the command again"});
}

// As the run says, then as the command line does.
PageOptions page_options(const std::filesystem::path& run, const ReportOptions& asked) {
  const auto file = run / "report.json";
  const nlohmann::json report = parse_json(read_file(file), file.string());
  PageOptions options;
  const nlohmann::json::json_pointer of_page("/options/page");
  if (report.contains(of_page)) load_json(options, report.at(of_page), file.string() + ", options.page");
  for (const std::string& key : asked.named) {
    if (key == "page.page_points") options.page_points = asked.page.page_points;
    if (key == "page.page_megabytes") options.page_megabytes = asked.page.page_megabytes;
  }
  return options;
}

}  // namespace

void ReportOptions::visit(FieldVisitor& visitor) {
  visitor.group({"page", "what the page holds, where it is not to be what the run says"}, page);
}

size_t write_run_page(const std::filesystem::path& run, const PageOptions& options) {
  const std::string html = page_html(sample_page(run, options));
  write_file_atomically(run / kPageFile, html);
  return html.size();
}

void report_run(const std::filesystem::path& run, const ReportOptions& options) {
  const std::string command = command_of_run(run);
  if (command != "sample") {
    fail({run.string(), "a run of gld sample", "one of gld " + printable_text(command),
          "look at report.json and the pictures beside it"});
  }
  RunJournal::refuse_running(run);
  require_report(run);
  const Page page = sample_page(run, page_options(run, options));
  const std::string html = page_html(page);
  {
    // So that a later run with --overwrite knows the page for a file of this one.
    const RunJournal journal(run);
    write_file_atomically(run / kPageFile, html);
  }
  print_report(
      {fmt::format("{}\n{}\n{} ({:.1f} MB)\n", printable_text(page.asked), printable_text(page.verdict),
                   printable_text((run / kPageFile).string()), static_cast<double>(html.size()) / 1e6),
       page.doubts});
}

}  // namespace gld
