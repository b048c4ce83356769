#pragma once

#include "gld/base/options.h"

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// Named texts inside a file, in order: PNG text chunks, PLY comments. Texts are UTF-8.
using TextItems = std::vector<std::pair<std::string, std::string>>;

// Where an output comes from (DESIGN.md section 5). It holds nothing that changes between two runs of the same
// command, so that the same command gives the same bytes.
struct Provenance {
  std::string program;     // "gld 0.1.0"
  std::string command;     // "sample"
  std::string options;     // JSON on one line
  std::string model_hash;  // SHA-256 of the weights in hex; empty where no model took part
  int64_t seed = 0;
  std::string precision;  // "bfloat16 on AVX512-BF16"; empty where no model took part
};

// Returns "gld 0.1.0" for this build, for example.
std::string program_version();

// Returns JSON on one line of a run's options, as to_json() writes them: those that identify a result
// (options_beside_the_result), of absolute paths the last name.
std::string identifying_options(nlohmann::json options);

// program is this build's; options are those that identify a result (options_beside_the_result): an output's bytes must
// not depend on where it lies.
Provenance make_provenance(const std::string& command, const OptionsGroup& options);

// Returns the command line that makes a result again: "gld sample --views.sources 0,6 ...", quoted for a shell, with
// the options that have another value than in `defaults`, without those that change no result; of absolute paths the
// last name.
std::string command_line_text(const std::string& command, const OptionsGroup& options,
                              const OptionsGroup& defaults);

// The items are "Software", "gld:command", "gld:options", "gld:model", "gld:seed", "gld:precision"; empty texts are
// left out.
TextItems provenance_items(const Provenance& provenance);

}  // namespace gld
