#pragma once

#include <functional>
#include <string>

namespace gld {

// For work that stop_if_interrupted() (gld/base/interrupt.h) cannot unwind, from any thread: says what was done so far,
// removes unfinished files and ends the process with the exit status of an interrupt.
[[noreturn]] void end_interrupted_process(const std::string& done);

// Something begun that is undone when the deadline of a stop ends the process while this lives; files and folders that
// are only to be removed have Unfinished (gld/base/interrupt.h).
class UndoneAtEnd {
 public:
  // undo is called while other threads go on; it may throw, and must not wait for one that may not come to its end.
  explicit UndoneAtEnd(std::function<void()> undo);
  ~UndoneAtEnd();
  UndoneAtEnd(const UndoneAtEnd&) = delete;
  UndoneAtEnd& operator=(const UndoneAtEnd&) = delete;
};

}  // namespace gld
