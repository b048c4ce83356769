#include "infer/page/eval_page.h"

#include "gld/base/atomic_file.h"
#include "tests/support/data_folders.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

// The evaluation that ships with the small model.
TEST(EvaluationPage, ShowsTheMeansOfARun) {
  const Page page = evaluation_page(test::source_root() / "configs/tiny/evaluation");
  EXPECT_EQ(page.title, "gld eval, model model");
  EXPECT_THAT(page.verdict,
              StartsWith("Over 64 scenes the samples have a PSNR of 22.3 dB; the mean prediction 23.6, "));
  EXPECT_THAT(page.verdict, HasSubstr("In 64 of 64 scenes"));
  const auto& table = page.data.at("parts").at(0);
  EXPECT_EQ(table.at("rows").at(0).dump(),
            "[\"sample_psnr\",\"22.3\",\"21.6 to 23\",\"dB\",\"higher\",\"64\",\"\"]");
  EXPECT_THAT(page.data.at("facts").dump(), HasSubstr("unipc3 on logsnr, 16 evaluations a level"));
  EXPECT_EQ(page_html(page), page_html(evaluation_page(test::source_root() / "configs/tiny/evaluation")));
}

TEST(EvaluationPage, HasASectionForEachNumberOfSourcesAndItsSheets) {
  test::TemporaryFolder run;
  write_file_atomically(
      run.path() / "report.json",
      "{\"scenes\": 2, \"means\": {}, \"by_sources\": {\"1\": {\"means\": {\"sample_psnr\": {\"mean\": 1.5, \"absent\": "
      "{\"why\": 3}}}}, \"2\": {\"means\": {\"sample_psnr\": {\"mean\": 2.5}}}}}");
  std::filesystem::create_directories(run.path() / "sheets");
  const std::string png = std::string("\x89PNG\r\n\x1a\n", 8);
  for (const char* file : {"sheets/b.png", "sheets/a.png", "best_scene.png"})
    write_file_atomically(run.path() / file, png);
  const Page page = evaluation_page(run.path());
  EXPECT_EQ(page.verdict, "2 scenes were evaluated.");
  const auto& parts = page.data.at("parts");
  ASSERT_EQ(parts.size(), 3u);
  EXPECT_EQ(parts[0].at("pictures").size(), 3u);
  EXPECT_EQ(parts[0].at("pictures")[1].at("name"), "a");
  EXPECT_EQ(parts[1].at("title"), "Metrics with 1 sources");
  EXPECT_EQ(parts[1].at("rows")[0].dump(), "[\"sample_psnr\",\"1.5\",\"\",\"\",\"\",\"\",\"3\"]");
}

}  // namespace
}  // namespace gld
