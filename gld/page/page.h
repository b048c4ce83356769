#pragma once

#include "gld/report/provenance.h"

#include <cstdint>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// A page for browsers that is one file and asks no network for anything: style, scripts, pictures and data are inside,
// and its policy (Content-Security-Policy) lets nothing else in. docs/PAGE.md says what it shows.
struct Page {
  std::string title;                // of the window
  std::string heading;              // "New views of kitchen"
  std::string asked;                // what was asked for, a sentence
  std::string verdict;              // what came out, in sentences; read first, also where no script runs
  std::vector<std::string> doubts;  // a sentence or more each
  TextItems provenance;
  nlohmann::ordered_json data = nlohmann::ordered_json::object();  // what the scripts of this folder show
  int64_t reload_seconds = 0;  // a page of a run that goes on loads itself again after so many; 0: never
};

// Returns the whole file. Texts may hold anything, also markup and bytes that are no UTF-8: they stay text. Equal pages
// give equal bytes.
std::string page_html(const Page& page);

// Returns how many bytes page_html() gives.
size_t page_size(const Page& page);

}  // namespace gld
