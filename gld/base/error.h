#pragma once

#include <stdexcept>
#include <string>

namespace gld {

// What a message to the user must say (DESIGN.md section 6). Leave a part empty where it adds nothing.
struct ErrorParts {
  std::string where;     // file, key, line or tensor
  std::string expected;  // what was expected
  std::string found;     // what was there instead
  std::string remedy;    // what to do, as an imperative
};

// The one exception type of the project. what() is a single line:
//   "WHERE: expected EXPECTED, found FOUND; REMEDY."
class Error : public std::runtime_error {
 public:
  explicit Error(const ErrorParts& parts);
  const ErrorParts& parts() const { return parts_; }

 private:
  ErrorParts parts_;
};

[[noreturn]] void fail(const ErrorParts& parts);

// Thrown to unwind after Ctrl-C; finished files are whole. The command line turns it into exit status 130.
class Interrupted : public std::runtime_error {
 public:
  explicit Interrupted(const std::string& done) : std::runtime_error(done) {}
};

}  // namespace gld
