#include "infer/page/report_command.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/json_text.h"
#include "infer/page/sample_page.h"

namespace gld {
namespace {

// The options are as the run says, then as the command line does.
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

PageMaker sample_page_maker(const ReportOptions& options) {
  return {"sample",
          [&](const std::filesystem::path& run) { return sample_page(run, page_options(run, options)); }};
}

size_t write_run_page(const std::filesystem::path& run, const PageOptions& options) {
  const std::string html = page_html(sample_page(run, options));
  write_file_atomically(run / kPageFile, html);
  return html.size();
}

}  // namespace gld
