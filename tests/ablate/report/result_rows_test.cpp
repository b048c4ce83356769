#include "ablate/report/result_rows.h"

#include "gld/base/atomic_file.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <cmath>

#include <gtest/gtest.h>

namespace gld {
namespace {

class ResultRowsTest : public testing::Test {
 protected:
  ResultRows read(const std::string& text) {
    write_file_atomically(folder_.path() / "eval.csv", text);
    return read_result_rows(folder_.path() / "eval.csv");
  }
  template <class Action>
  std::string error(const Action& action) {
    std::string message = test::error_of(action);
    const std::string path = folder_.path().string() + "/";
    if (message.rfind(path, 0) == 0) message.erase(0, path.size());
    return message;
  }

  test::TemporaryFolder folder_;
};

TEST_F(ResultRowsTest, AreSplitAsRfc4180Says) {
  const ResultRows rows = read("scene,psnr\n\"a,b\"\"c\",1\r\n\"two\nlines\",2");
  ASSERT_EQ(rows.rows.size(), 2U);
  EXPECT_EQ(rows.rows[0][0], "a,b\"c");
  EXPECT_EQ(rows.rows[1][0], "two\nlines");
  EXPECT_EQ(rows.rows[1][1], "2");
}

TEST_F(ResultRowsTest, NumbersAreBySceneAndAbsentOnesAreLeftOut) {
  const auto numbers = numbers_by_scene(read("scene,psnr\na,20.5\nb,\nc,inf\n"), "psnr", {});
  ASSERT_EQ(numbers.size(), 2U);
  EXPECT_DOUBLE_EQ(numbers.at("a").at(""), 20.5);
  EXPECT_TRUE(std::isinf(numbers.at("c").at("")));
}

TEST_F(ResultRowsTest, RowsAreChosenAndSamplesOfATargetAveraged) {
  const ResultRows rows =
      read("scene,sources,sample,target,psnr\na,1,0,x,1\na,1,1,x,3\na,1,0,y,7\na,2,0,x,9\n");
  const auto numbers = numbers_by_scene(rows, "psnr", {{"sources", "1"}});
  EXPECT_DOUBLE_EQ(numbers.at("a").at("x"), 2);
  EXPECT_DOUBLE_EQ(numbers.at("a").at("y"), 7);
}

TEST_F(ResultRowsTest, AReportIsOneRowWithItsStagesByName) {
  const auto file = folder_.path() / "report.json";
  write_file_atomically(
      file,
      R"({"scene": {"name": "room"}, "stages": [{"stage": "M1", "seconds": 1.5}, {"stage": "RGB decoding", "seconds": 2}],
                                  "warnings": ["a"], "psnr": null})");
  const ResultRows rows = read_result_rows(file);
  EXPECT_DOUBLE_EQ(numbers_by_scene(rows, "stages.M1.seconds", {}).at("room").at(""), 1.5);
  EXPECT_DOUBLE_EQ(numbers_by_scene(rows, "stages.RGB decoding.seconds", {}).at("room").at(""), 2);
  EXPECT_TRUE(numbers_by_scene(rows, "psnr", {}).empty());
}

TEST_F(ResultRowsTest, RowsWithoutScenesAreOfOne) {
  const auto numbers = numbers_by_scene(read("block,pck\n0,1\n1,5\n"), "pck", {{"block", "1"}});
  EXPECT_DOUBLE_EQ(numbers.at("all").at(""), 5);
}

TEST_F(ResultRowsTest, ErrorsSayWhatIsThere) {
  EXPECT_EQ(error([&] { read("scene,psnr\na,1,2\n"); }),
            "eval.csv:2: expected 2 cells, found 3; run the stage again.");
  EXPECT_EQ(error([&] { read("scene,psnr\n\"a,1\n"); }),
            "eval.csv:2: expected a quote that is closed, found the end of the file; write it again.");
  EXPECT_EQ(error([&] { read(""); }),
            "eval.csv: expected a line with the names of columns, found an empty file; run the stage again.");
  EXPECT_EQ(error([&] { numbers_by_scene(read("scene,psnr\na,1\n"), "psr", {}); }),
            "eval.csv: expected a column 'psr', found none; did you mean 'psnr'?");
  EXPECT_EQ(
      error([&] { numbers_by_scene(read("scene,psnr\na,x\n"), "psnr", {}); }),
      "eval.csv:2, column 'psnr': expected a number, found 'x'; choose another column, or run the stage again.");
  EXPECT_EQ(error([&] {
              numbers_by_scene(read("scene,psnr\na,1\n"), "psnr", {{"scene", "b"}});
            }),
            "eval.csv: expected rows with scene b, found none; see what the file has.");
}

}  // namespace
}  // namespace gld
