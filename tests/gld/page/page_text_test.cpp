#include "gld/page/page_text.h"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zlib.h>

namespace gld {
namespace {

// RFC 4648, section 10.
TEST(PageText, Base64IsThatOfTheStandard) {
  EXPECT_EQ(base64_text(""), "");
  EXPECT_EQ(base64_text("f"), "Zg==");
  EXPECT_EQ(base64_text("fo"), "Zm8=");
  EXPECT_EQ(base64_text("foo"), "Zm9v");
  EXPECT_EQ(base64_text("foob"), "Zm9vYg==");
  EXPECT_EQ(base64_text("foobar"), "Zm9vYmFy");
  EXPECT_EQ(base64_text(std::string("\xff\xfe\x00\x80", 4)), "//4AgA==");
}

TEST(PageText, WhatIsDeflatedInflatesToTheSame) {
  std::string text;
  for (int i = 0; i < 5000; ++i) text += std::to_string(i * i % 97) + ",";
  const std::string packed = deflated(text);
  EXPECT_LT(packed.size(), text.size() / 4);
  std::string back(text.size(), '\0');
  uLongf size = back.size();
  ASSERT_EQ(uncompress(reinterpret_cast<Bytef*>(back.data()), &size,
                       reinterpret_cast<const Bytef*>(packed.data()), packed.size()),
            Z_OK);
  EXPECT_EQ(back, text);
}

TEST(PageText, TextStaysText) {
  EXPECT_EQ(html_text("</script><img onerror=\"a('&')\">"),
            "&lt;/script&gt;&lt;img onerror=&quot;a(&#39;&amp;&#39;)&quot;&gt;");
  EXPECT_EQ(html_text("a\nb\xff"), "a\\nb\\xff");
  EXPECT_EQ(escaped_text("a\n<b"), "a\n&lt;b");
}

TEST(PageText, JsonEndsNoScriptElementAndSaysTheSame) {
  const nlohmann::ordered_json value{{"</script><!--", "<script>&amp;\xe2\x80\xa8"},
                                     {"b", {1, 2.5, nullptr}}};
  const std::string text = script_json(value);
  EXPECT_THAT(text, testing::Not(testing::AnyOf(testing::HasSubstr("<"), testing::HasSubstr(">"),
                                                testing::HasSubstr("&"))));
  EXPECT_EQ(nlohmann::ordered_json::parse(text), value);
}

// The hash is that of printf 'alert(1)' | openssl dgst -sha256 -binary | base64
TEST(PageText, APolicyNamesAScriptByItsHash) {
  EXPECT_EQ(policy_hash("alert(1)"), "'sha256-bhHHL3z2vDgxUt0W3dWQOrprscmda2Y5pLsLg4GF+pI='");
}

}  // namespace
}  // namespace gld
