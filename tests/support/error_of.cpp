#include "tests/support/error_of.h"

#include "gld/base/error.h"

#include <gtest/gtest.h>

namespace gld::test {

std::string error_of(const std::function<void()>& action) {
  try {
    action();
  } catch (const Error& error) {
    return error.what();
  }
  ADD_FAILURE() << "no error was thrown";
  return {};
}

}  // namespace gld::test
