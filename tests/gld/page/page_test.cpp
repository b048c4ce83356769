#include "gld/page/page.h"

#include "gld/page/embedded_page.h"
#include "gld/page/page_text.h"

#include <set>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using testing::HasSubstr;
using testing::Not;

constexpr const char* kHostile = "</script><img src=x onerror=alert(1)>";

size_t times(const std::string& text, const std::string& part) {
  size_t count = 0;
  for (size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + part.size())) ++count;
  return count;
}

// Returns the text between two marks, of which the first stands once.
std::string between(const std::string& text, const std::string& begin, const std::string& end) {
  EXPECT_EQ(times(text, begin), 1u) << begin;
  const size_t from = text.find(begin) + begin.size();
  return text.substr(from, text.find(end, from) - from);
}

Page hostile_page() {
  Page page;
  page.title = page.heading = page.asked = page.verdict = kHostile;
  page.doubts = {kHostile, "a second one"};
  page.provenance = {{"gld:options", "\"><script>alert(1)</script>"}};
  page.data["name"] = kHostile;
  return page;
}

TEST(Page, EverySeamIsThereOnce) {
  std::multiset<std::string> seams;
  for (const PagePart& part : embedded_page()) {
    if (!part.seam.empty()) seams.insert(part.seam);
  }
  EXPECT_EQ(seams, (std::multiset<std::string>{"asked", "controls", "data", "doubts", "heading", "notice",
                                               "policy", "provenance", "reload", "scripts", "style", "three",
                                               "title", "verdict"}));
  EXPECT_THAT(page_html(Page()), Not(HasSubstr("{{policy")));
}

TEST(Page, MarkupInNamesStaysText) {
  const std::string html = page_html(hostile_page());
  EXPECT_THAT(html, Not(HasSubstr("<img src=x")));
  // The four scripts of the template, its data and nothing else.
  EXPECT_EQ(times(html, "<script"), 4u);
  EXPECT_EQ(times(html, "</script"), 4u);
  const std::string data = between(html, "<script type=\"application/json\" id=\"data\">", "</script>");
  EXPECT_EQ(nlohmann::json::parse(data).at("name"), kHostile);
  EXPECT_THAT(html,
              HasSubstr("<li>&lt;/script&gt;&lt;img src=x onerror=alert(1)&gt;</li>\n<li>a second one</li>"));
  EXPECT_THAT(html, HasSubstr("<meta name=\"gld:options\" content=\"&quot;&gt;&lt;script&gt;"));
}

TEST(Page, ThePolicyLetsInWhatTheBuildPutInAndNothingElse) {
  const std::string html = page_html(Page());
  const std::string policy = between(html, "Content-Security-Policy\" content=\"", "\">");
  EXPECT_EQ(policy.rfind("default-src &#39;none&#39;; img-src data:; script-src &#39;sha256-", 0), 0u)
      << policy;
  EXPECT_THAT(policy, Not(HasSubstr("unsafe")));
  EXPECT_THAT(policy, Not(HasSubstr("http")));
  EXPECT_EQ(times(policy, "sha256-"), 4u);
  // What stands between the tags is what was hashed.
  const std::string style = between(html, "<style>", "</style>");
  EXPECT_THAT(policy, HasSubstr(html_text("style-src " + policy_hash(style) + ";")));
  size_t found = 0;
  for (size_t at = html.find("<script>"); at != std::string::npos; at = html.find("<script>", at + 1)) {
    const size_t from = at + 8;
    found += times(policy, html_text(policy_hash(html.substr(from, html.find("</script>", from) - from))));
  }
  EXPECT_EQ(found, 3u);
}

TEST(Page, CarriesTheNoticeOfThreeJs) {
  const std::string html = page_html(Page());
  EXPECT_THAT(html, HasSubstr("three.js authors"));
  EXPECT_THAT(html, HasSubstr("Permission is hereby granted, free of charge"));
}

TEST(Page, EqualPagesAreEqualBytesAndOnlyThoseOfRunsThatGoOnReload) {
  EXPECT_EQ(page_html(hostile_page()), page_html(hostile_page()));
  EXPECT_EQ(page_size(hostile_page()), page_html(hostile_page()).size());
  Page page;
  EXPECT_THAT(page_html(page), Not(HasSubstr("http-equiv=\"refresh\"")));
  page.reload_seconds = 60;
  EXPECT_THAT(page_html(page), HasSubstr("<meta http-equiv=\"refresh\" content=\"60\">"));
}

}  // namespace
}  // namespace gld
