#pragma once

#include <string>

namespace gld {

// For work that stop_if_interrupted() (gld/base/interrupt.h) cannot unwind, from any thread: says what was done so far,
// removes unfinished files and ends the process with the exit status of an interrupt.
[[noreturn]] void end_interrupted_process(const std::string& done);

}  // namespace gld
