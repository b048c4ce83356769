// googletest whose assertions count themselves: this folder stands in front of googletest's on the include path of all
// tests (tests/support/CMakeLists.txt), so that a test that asserts nothing can fail (tests/support/test_main.cpp).
// The macro stands in every EXPECT_ and ASSERT_, and nowhere in SUCCEED() and ADD_FAILURE().
#pragma once
#pragma GCC system_header  // for #include_next

#include <atomic>

#include_next <gtest/gtest.h>

namespace gld::test {

inline std::atomic<long> assertions_made{0};

// Returns always 0, which is what googletest's own macro switches on.
inline int count_assertion() {
  ++assertions_made;
  return 0;
}

}  // namespace gld::test

#ifndef GTEST_AMBIGUOUS_ELSE_BLOCKER_
#error "This googletest has no GTEST_AMBIGUOUS_ELSE_BLOCKER_: find another macro that every assertion holds."
#endif
#undef GTEST_AMBIGUOUS_ELSE_BLOCKER_
#define GTEST_AMBIGUOUS_ELSE_BLOCKER_     \
  switch (::gld::test::count_assertion()) \
  case 0:                                 \
  default:
