#include "gld/base/json_text.h"

#include "tests/support/error_of.h"

#include <string>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;

std::string refusal(const std::string& text) {
  return error_of([&] { parse_json(text, "a.json"); });
}

std::string repeated(const std::string& text, size_t times) {
  std::string all;
  for (size_t i = 0; i < times; ++i) all += text;
  return all;
}

TEST(JsonText, RefusesInOneSentence) {
  EXPECT_EQ(refusal("{\n\"a\": }"), "a.json:2: expected JSON, found a syntax error; correct the file.");
  EXPECT_EQ(
      refusal("[1,\nNaN]"),
      "a.json:2: expected JSON, found NaN or Infinity, which are no JSON; write null or leave the value out.");
  EXPECT_EQ(
      refusal("[-Infinity]"),
      "a.json:1: expected JSON, found NaN or Infinity, which are no JSON; write null or leave the value out.");
  EXPECT_EQ(refusal("{\"Info\" 1}"), "a.json:1: expected JSON, found a syntax error; correct the file.");
  EXPECT_EQ(refusal("[1e400]"),
            "a.json: expected numbers up to 1.8e308, found a larger one; correct the value.");
  EXPECT_EQ(refusal("[\"\xFF\"]"), "a.json:1: expected JSON, found text that is no UTF-8; correct the file.");
  EXPECT_EQ(refusal(""), "a.json:1: expected JSON, found a syntax error; correct the file.");
}

TEST(JsonText, AKeyGivenTwiceIsRefused) {
  EXPECT_EQ(refusal("{\"fx\": 3, \"k\": {\"fx\": 1}, \"fx\": 112}"),
            "a.json: expected each key of an object once, found \"fx\" twice; remove one of them.");
  EXPECT_NO_THROW(parse_json("[{\"fx\": 3}, {\"fx\": 3, \"inner\": {\"fx\": 3}}]", "a.json"));
}

TEST(JsonText, NestingEndsBeforeTheStackDoes) {
  EXPECT_NO_THROW(parse_json(repeated("[", 64) + repeated("]", 64), "a.json"));
  for (const size_t depth : {size_t{65}, size_t{70'000}, size_t{5'000'000}}) {
    EXPECT_EQ(refusal("\n" + repeated("[", depth) + repeated("]", depth)),
              "a.json:2: expected JSON nested at most 64 deep, found more; check that it is the right file.");
  }
  EXPECT_NO_THROW(parse_json("[\"" + repeated("[", 1000) + "\\\"" + repeated("{", 1000) + "\"]", "a.json"));
}

TEST(JsonText, TakesNoMoreMemoryThanAFileOfCamerasNeeds) {
  EXPECT_EQ(refusal("[0" + repeated(",0", 20'000'000) + "]"),
            "a.json: expected at most 20000000 values, found more; check that it is the right file.");
}

TEST(JsonText, BytesThatAreNoUtf8AreReplacedWhenWritten) {
  const nlohmann::ordered_json object = {{"out", std::string("runs/\xFF")}};
  EXPECT_EQ(json_text(object), "{\"out\":\"runs/\xEF\xBF\xBD\"}");
}

}  // namespace
}  // namespace gld
