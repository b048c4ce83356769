#include "gld/page/results.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/page/page_text.h"
#include "gld/page/run_report.h"

#include <cmath>
#include <system_error>

namespace gld {
namespace {

using Json = nlohmann::ordered_json;

constexpr uint64_t kLargestPicture = uint64_t{1} << 26;
constexpr std::string_view kPngStart("\x89PNG\r\n\x1a\n", 8);

bool is_shown(double value, AxisScale scale) {
  return std::isfinite(value) && (scale == AxisScale::kLinear || value > 0);
}

Json panel_json(const PlotPanel& panel) {
  Json series = Json::array();
  for (const PlotSeries& one : panel.series) {
    Json points = Json::array();
    for (const auto& [x, y] : one.points) {
      if (is_shown(x, panel.x.scale)) {
        points.push_back(is_shown(y, panel.y.scale) ? Json{x, y} : Json{x, nullptr});
      }
    }
    if (points.size() > 1) series.push_back({{"name", one.name}, {"points", points}});
  }
  return {{"title", panel.title},
          {"x", panel.x.label},
          {"y", panel.y.label},
          {"logarithmic", panel.y.scale == AxisScale::kLog},
          {"series", series}};
}

Json& parts_of(Page& page) {
  Json& parts = page.data["parts"];
  if (parts.is_null()) parts = Json::array();
  return parts;
}

}  // namespace

void add_table(Page& page, const ResultTable& table) {
  if (table.rows.empty()) return;
  parts_of(page).push_back({{"type", "table"},
                            {"title", table.title},
                            {"hint", table.hint},
                            {"columns", table.columns},
                            {"rows", table.rows}});
}

void add_charts(Page& page, const std::string& title, const std::vector<PlotPanel>& panels) {
  Json charts = Json::array();
  for (const PlotPanel& panel : panels) {
    Json chart = panel_json(panel);
    if (!chart["series"].empty()) charts.push_back(std::move(chart));
  }
  if (!charts.empty()) parts_of(page).push_back({{"type", "charts"}, {"title", title}, {"charts", charts}});
}

void add_pictures(Page& page, const std::string& title, const std::string& hint,
                  const std::filesystem::path& run,
                  const std::vector<std::pair<std::string, std::string>>& names_and_files) {
  Json pictures = Json::array();
  for (const auto& [name, file] : names_and_files) {
    std::error_code error;
    if (!std::filesystem::is_regular_file(run / file, error)) {
      page.doubts.push_back(file + " is left out of this page: the file is missing.");
      continue;
    }
    const std::string bytes = read_file(run / file, kLargestPicture);
    if (bytes.compare(0, kPngStart.size(), kPngStart) != 0) {
      page.doubts.push_back(file + " is left out of this page: expected a PNG file, found another one.");
      continue;
    }
    pictures.push_back({{"name", name}, {"address", data_address("image/png", bytes)}});
  }
  if (pictures.empty()) return;
  parts_of(page).push_back({{"type", "pictures"}, {"title", title}, {"hint", hint}, {"pictures", pictures}});
}

void add_fact(Page& page, const std::string& name, const std::string& text) {
  if (!text.empty()) page.data["facts"].push_back({name, text});
}

Page results_page(const std::string& title, const nlohmann::ordered_json& report) {
  Page page;
  page.title = page.heading = title;
  page.doubts = doubts_of_run(report);
  page.provenance = provenance_of_run(report);
  page.data["kind"] = "results";
  page.data["parts"] = Json::array();
  page.data["facts"] = Json::array();
  page.data["stages"] = Json::array();
  page.data["command"] = "";
  return page;
}

}  // namespace gld
