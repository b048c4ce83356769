#include "gld/base/printable_text.h"

#include "gld/base/error.h"
#include "tests/support/error_of.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(PrintableText, LeavesTextOfAnyScriptAlone) {
  const std::string text = "Zürich 東京 \"a\\b\" \xF0\x9F\x8F\xA0";
  EXPECT_EQ(printable_text(text), text);
}

TEST(PrintableText, NothingThatATerminalObeysGetsThrough) {
  EXPECT_EQ(printable_text("a\x1b[2Jb\r\n\tc\x07"), "a\\x1b[2Jb\\r\\n\\tc\\x07");
  EXPECT_EQ(printable_text("\xC2\x9B"
                           "2J"),
            "\\x9b2J");  // the same command in one character
  EXPECT_EQ(printable_text("gpj.\xE2\x80\xAE"
                           "exe"),
            "gpj.\\u202eexe");  // text that runs backwards
  EXPECT_EQ(printable_text(std::string("\0", 1)), "\\x00");
}

TEST(PrintableText, BytesThatAreNoUtf8AreShownAsNumbers) {
  EXPECT_EQ(printable_text("\xFF"
                           "a\xC3"),
            "\\xffa\\xc3");
  EXPECT_EQ(printable_text("\xC0\xAF"), "\\xc0\\xaf");           // a slash in more bytes than it needs
  EXPECT_EQ(printable_text("\xED\xA0\x80"), "\\xed\\xa0\\x80");  // half a surrogate pair
  EXPECT_EQ(printable_text("\xF4\x90\x80\x80"), "\\xf4\\x90\\x80\\x80");  // beyond the last character
}

TEST(PrintableText, IsNeverCutInsideACharacter) {
  EXPECT_EQ(printable_text("ab\xC3\xBC"
                           "cd",
                           3),
            "ab...");
  EXPECT_EQ(printable_text("ab\xC3\xBC"
                           "cd",
                           4),
            "ab\xC3\xBC...");
  EXPECT_EQ(printable_text("abc", 3), "abc");
}

TEST(PrintableText, EveryErrorIsOneLineOfIt) {
  EXPECT_EQ(test::error_of([] {
              fail({"a\nb\x1b]0;x\x07", "c", "\xFF", "d"});
            }),
            "a\\nb\\x1b]0;x\\x07: expected c, found \\xff; d.");
}

// What was typed, or stands in a file, may be as long as that: an error says enough of it, and all of a path.
TEST(PrintableText, ErrorsQuoteLongWordsInPart) {
  const std::string path = "/" + std::string(250, 'p');
  const std::string said =
      Error({path, "frames", "'" + std::string(70'000, 'a') + "'", "choose among them"}).what();
  EXPECT_EQ(said, path + ": expected frames, found '" + std::string(37, 'a') + "..." + std::string(36, 'a') +
                      "'; choose among them.");
}

}  // namespace
}  // namespace gld
