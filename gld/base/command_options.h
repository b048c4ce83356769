#pragma once

#include "gld/base/options.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// Options that several commands have. Each is declared here only, so that it has one name, range and help everywhere; a
// command's visit() calls those that the command uses.

constexpr int64_t kMostThreads = 4096;

// --out is the folder a command writes into; --overwrite says whether an earlier run of the command in it is removed
// first.
void visit_out(FieldVisitor& visitor, std::string& out);
void visit_out(FieldVisitor& visitor, std::string& out, bool& overwrite);
// Throws Error for an empty one; example is such a folder, "runs/sample".
void check_out(const std::string& out, const std::string& example);
// Throws Error where the input of that option ("--model") lies in the run folder that --overwrite replaces.
void check_input_survives(const std::string& option, const std::string& input, const std::string& out,
                          bool overwrite);

// Returns the options that say where a command writes, how it goes about it and what it prints, but not what comes out:
// they are not part of what identifies a result.
const std::vector<std::string>& options_beside_the_result();

// --threads goes from 0 to kMostThreads. 0 is one a core: threads_to_use() says how many that is.
void visit_threads(FieldVisitor& visitor, int64_t& threads);
int64_t threads_to_use(int64_t threads);

// With --json the report is printed as JSON, in the place of text.
void visit_json(FieldVisitor& visitor, bool& json);

// --device is read by gld/tensors/device.h.
void visit_device(FieldVisitor& visitor, std::string& device);

// --seed goes from 0; of says what is drawn with it: "the noise".
void visit_seed(FieldVisitor& visitor, int64_t& seed, const std::string& of);

// --scene is one folder that is one scene.
void visit_scene(FieldVisitor& visitor, std::string& scene);
// --scenes are folders that are scenes or hold some; instead_of says what is taken where there are none.
void visit_scenes(FieldVisitor& visitor, std::vector<std::string>& scenes, const std::string& instead_of);

}  // namespace gld
