#include "ablate/page/ablation_page.h"

#include "gld/base/atomic_file.h"
#include "tests/support/data_folders.h"
#include "tests/support/temporary_folder.h"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

TEST(AblationPage, ShowsTheClaimsFirst) {
  const Page page = ablation_page(test::source_root() / "docs/measured/ablations/sources");
  EXPECT_EQ(page.heading, "Number of source views (Table 4)");
  EXPECT_EQ(page.verdict, "Of 3 claims: 2 reproduced, 1 undecided.");
  const auto& parts = page.data.at("parts");
  ASSERT_EQ(parts.size(), 4u);
  EXPECT_EQ(
      parts[0].at("rows")[1].dump(),
      "[\"3 sources over 2 sources\",\"psnr\",\"0.851 [0.458, 1.28]\",\"58 : 11\",\"0.0008\",\"better with N = 4 than "
      "with 2\",\"reproduced\"]");
  EXPECT_THAT(parts[1].at("columns").dump(), HasSubstr("\"psnr, dB (higher)\""));
  EXPECT_THAT(parts[1].at("rows").dump(), HasSubstr("[\"1 source\",\"21.5 [19.8, 23.5]\""));
  EXPECT_EQ(parts[2].at("title"), "What is claimed");
  EXPECT_EQ(parts[3].at("type"), "pictures");
  EXPECT_EQ(page.data.at("stages")[0].at("stage"), "eval: n1, seed 0 and 2 more");
  EXPECT_THAT(page.data.at("command").get<std::string>(),
              HasSubstr("gld ablate --config configs/ablations/sources.yaml"));
}

TEST(AblationPage, SaysBeyondWhichMarginAClaimIs) {
  test::TemporaryFolder run;
  write_file_atomically(run.path() / "report.json",
                        R"({"variants": [{"name": "a", "label": "A"}, {"name": "b", "label": "B"}],
                            "claims": [{"name": "c", "metric": "x", "better": "a", "worse": "b", "beyond": ["b", "a"],
                                        "verdict": "undecided"}]})");
  EXPECT_EQ(ablation_page(run.path()).data.at("parts")[0].at("rows")[0][0].get<std::string>(),
            "A over B, by more than B over A");
}

TEST(AblationPage, SaysThatASmokeRunSaysNothing) {
  test::TemporaryFolder run;
  write_file_atomically(
      run.path() / "report.json",
      "{\"smoke\": true, \"variants\": [{\"label\": \"a\", \"metrics\": {\"x~/1\": {\"mean\": 1}}}, {\"label\": \"b\"}]}");
  const Page page = ablation_page(run.path());
  EXPECT_EQ(page.verdict, "This ablation compares its variants and makes no claim.");
  EXPECT_THAT(page.doubts,
              ElementsAre("This is a smoke run, whose stages take seconds: its numbers say nothing."));
  EXPECT_EQ(page.data.at("parts")[0].at("rows").dump(), "[[\"a\",\"1\"],[\"b\",\"\"]]");
}

}  // namespace
}  // namespace gld
