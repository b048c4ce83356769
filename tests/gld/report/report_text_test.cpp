#include "gld/report/report_text.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

// Names of files and scenes come into warnings, and a terminal obeys what stands in them.
TEST(ReportText, WarningsHoldNothingThatATerminalObeys) {
  testing::internal::CaptureStderr();
  print_warnings({"images/fra\x1b[31mme\x07.png does not exist", "two\nlines"});
  EXPECT_EQ(testing::internal::GetCapturedStderr(),
            "warning: images/fra\\x1b[31mme\\x07.png does not exist\nwarning: two\\nlines\n");
}

}  // namespace
}  // namespace gld
