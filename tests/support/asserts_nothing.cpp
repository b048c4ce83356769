// Tests that assert nothing, for the test that says so (tests/CMakeLists.txt).
#include <gtest/gtest.h>

TEST(AssertsNothing, BecauseItReturns) {}
TEST(AssertsNothing, BecauseItOnlySucceeds) { SUCCEED(); }
TEST(AssertsSomething, Once) { EXPECT_EQ(1 + 1, 2); }
