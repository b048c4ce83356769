#pragma once

#include "gld/page/page.h"
#include "gld/report/plot.h"

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

namespace gld {

// Pages that are made of tables, curves and pictures, in the order in which they are added.

struct ResultTable {
  std::string title;
  std::string hint;                            // a sentence below the title; may be empty
  std::vector<std::string> columns;            // the first one names the row
  std::vector<std::vector<std::string>> rows;  // as many cells each
};

// Nothing is added where there is no row.
void add_table(Page& page, const ResultTable& table);

// Adds panels as gld/report/plot.h draws them; those with nothing to show are left out. Values that are not finite, or
// not positive on a logarithmic axis, leave a gap.
void add_charts(Page& page, const std::string& title, const std::vector<PlotPanel>& panels);

// Adds PNG files of the run as they are, each with its name; one that is missing or no PNG becomes a doubt. Nothing is
// added for none.
void add_pictures(Page& page, const std::string& title, const std::string& hint,
                  const std::filesystem::path& run,
                  const std::vector<std::pair<std::string, std::string>>& names_and_files);

// Adds a line of "How it was made"; nothing is added for an empty text.
void add_fact(Page& page, const std::string& name, const std::string& text);

// Returns a page of this kind with title, heading, provenance and doubts of a run.
Page results_page(const std::string& title, const nlohmann::ordered_json& report);

}  // namespace gld
