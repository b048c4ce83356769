#include "gld/report/cairo_text.h"

#include <algorithm>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

constexpr TextFont kFont{14, TextWeight::kRegular};
// This letter is in a plane that is left to private use, where no usual font has anything.
const std::string kMissing = "\U0010FFFD";

TEST(CairoText, WhatNoFontHasIsShownAsItsCodePoint) {
  for (const char* text : {"room_0012", "Zürich", "Комната 3", "δωμάτιο", "a – b …", "naïve e\u0301"}) {
    EXPECT_EQ(drawable_text(text, kFont), text);
  }
  EXPECT_EQ(drawable_text(kMissing, kFont), "U+10FFFD");
  EXPECT_EQ(drawable_text("a" + kMissing + kMissing + "b" + kMissing, kFont), "aU+10FFFD U+10FFFDbU+10FFFD");
  EXPECT_EQ(drawable_text("", kFont), "");
}

TEST(CairoText, BytesThatAreNoTextAreShownToo) {
  testing::internal::CaptureStderr();
  EXPECT_EQ(drawable_text("a\xff"
                          "b",
                          kFont),
            "aU+FFFDb");
  EXPECT_EQ(drawable_text("a\xe6\xbc", kFont), "aU+FFFD U+FFFD");  // the beginning of a character
  EXPECT_EQ(drawable_text(std::string("a\0b", 3), kFont), "aU+FFFDb");
  EXPECT_EQ(drawable_text("a\nb\tc", kFont), "aU+000AbU+0009c");
  EXPECT_GT(text_extent("\xff\xfe\xfd", kFont).width, 0);
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
}

TEST(CairoText, ExtentGrowsWithTheTextAndItsSize) {
  const TextExtent small = text_extent("Hxg", kFont);
  const TextExtent large = text_extent("Hxg", {28, TextWeight::kRegular});
  EXPECT_NEAR(large.width, 2 * small.width, 0.1 * large.width);
  EXPECT_LT(small.top, -8);
  EXPECT_GT(small.bottom, 1);  // below the baseline
  EXPECT_LT(small.left, small.right);
  EXPECT_LE(small.right, small.width + 1);
  EXPECT_GT(text_extent("Hxg", {14, TextWeight::kBold}).width, small.width);
  EXPECT_EQ(text_extent("", kFont).width, 0);
}

// Letters of the Arabic script join: a word is not the sum of its letters.
TEST(CairoText, LettersJoinWhereTheScriptWantsIt) {
  const std::string word = "سلام";
  double letters = 0;
  for (size_t i = 0; i < word.size(); i += 2) letters += text_extent(word.substr(i, 2), kFont).width;
  EXPECT_LT(text_extent(word, kFont).width, 0.9 * letters);
}

TEST(CairoText, LongNamesLoseTheirMiddle) {
  const std::string name = "corridor_of_the_second_floor_towards_the_garden_0012";
  EXPECT_EQ(shortened_text(name, 1000, kFont), name);
  size_t shorter = name.size();
  for (double width = 350; width > 20; width -= 7) {
    const std::string cut = shortened_text(name, width, kFont);
    EXPECT_LE(text_extent(cut, kFont).width, width);
    EXPECT_LE(cut.size(), shorter + std::string("…").size());
    shorter = std::min(shorter, cut.size());
    const size_t gap = cut.find("…");
    ASSERT_NE(gap, std::string::npos) << width;
    EXPECT_EQ(name.rfind(cut.substr(0, gap), 0), 0U);
    const std::string end = cut.substr(gap + std::string("…").size());
    EXPECT_EQ(name.substr(name.size() - end.size()), end);
    EXPECT_LE(end.size() - gap, 1U) << "the end gets the odd character";
  }
  EXPECT_EQ(shortened_text(name, 2, kFont), "");
}

TEST(CairoText, ShorteningKeepsCharactersAndTheirAccentsWhole) {
  std::string name;
  for (int i = 0; i < 30; ++i) name += "e\u0301";
  const std::string cut = shortened_text(name, 100, kFont);
  EXPECT_EQ(cut.find("…") % 3, 0U);
  EXPECT_EQ((cut.size() - std::string("…").size()) % 3, 0U);
  EXPECT_THAT(shortened_text("Очень_длинное_название_комнаты_0012", 120, kFont),
              testing::AllOf(testing::StartsWith("Оч"), testing::EndsWith("0012")));
}

TEST(CairoText, ShorteningKeepsCodePointsWhole) {
  std::string name;
  for (int i = 0; i < 30; ++i) name += kMissing;
  const std::string cut = shortened_text(name, 300, kFont);
  EXPECT_EQ(cut.find("…") % kMissing.size(), 0U);
  const std::string drawn = drawable_text(cut, kFont);
  EXPECT_THAT(drawn, testing::AllOf(testing::StartsWith("U+10FFFD"), testing::HasSubstr("U+10FFFD…U+10FFFD"),
                                    testing::EndsWith("U+10FFFD")));
  EXPECT_THAT(shortened_text(std::string(40, '\xff'), 200, kFont), testing::HasSubstr("…"));
}

}  // namespace
}  // namespace gld
