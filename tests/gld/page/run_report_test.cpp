#include "gld/page/run_report.h"

#include "gld/base/atomic_file.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <string>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using Json = nlohmann::ordered_json;
using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

TEST(RunReport, SaysEveryDoubtOnce) {
  const Json report{{"verdict", {{"drawn_rooms_only", true}, {"unfamiliar", false}}},
                    {"warnings",
                     {"the cameras of the photographs are not sure: they turn only",
                      std::string(kScaleNotKnown) +
                          " (camera_poses: none). Depth, points.ply and cameras.json are in the model's.",
                      "the cameras of the photographs are not sure: they turn only", 7}}};
  EXPECT_THAT(
      doubts_of_run(report),
      ElementsAre(
          "The cameras of the photographs are not sure: they turn only.",
          "How large the scene is is not known: depth, cloud and cameras are in the model's own unit."));
  // Where photographs are unlike what a model has seen, the verdict says so; what is said of every run is no doubt.
  EXPECT_THAT(doubts_of_run({{"verdict", {{"drawn_rooms_only", true}, {"unfamiliar", true}}}}), IsEmpty());
  EXPECT_THAT(doubts_of_run(Json::object()), IsEmpty());
}

TEST(RunReport, AValueThatIsNotThereIsNull) {
  const Json report{{"a", {{"b", {1, "two"}}}}};
  EXPECT_EQ(report_text_at(report, "/a/b/1"), "two");
  EXPECT_EQ(report_text_at(report, "/a/b/0"), "");
  EXPECT_TRUE(report_value(report, "/a/b/2").is_null());
  EXPECT_TRUE(report_value(report, "/a/b/c").is_null());
  EXPECT_TRUE(report_value(report, "/x/y").is_null());
}

TEST(RunReport, HasTheProvenanceOfTheRunsFiles) {
  const Json report{{"command", "sample"},
                    {"options", {{"out", "/home/me/run"}, {"scene", "/home/me/kitchen"}, {"threads", 3}}},
                    {"model_hash", "abc"},
                    {"seed", 5}};
  const TextItems items = provenance_of_run(report);
  EXPECT_THAT(items, Contains(std::make_pair("gld:command", "sample")));
  EXPECT_THAT(items, Contains(std::make_pair("gld:options", "{\"scene\":\"kitchen\"}")));
  EXPECT_THAT(items, Contains(std::make_pair("gld:model", "abc")));
  EXPECT_THAT(items, Contains(std::make_pair("gld:seed", "5")));
}

TEST(RunReport, IsReadOrRefused) {
  test::TemporaryFolder folder;
  write_file_atomically(folder.path() / "report.json", "{\"b\": 1, \"a\": 2.5}");
  const Json report = read_run_report(folder.path());
  EXPECT_EQ(report.dump(), "{\"b\":1,\"a\":2.5}");
  EXPECT_EQ(report_number_at(report, "/a"), "2.5");
  EXPECT_EQ(report_number_at(report, "/c"), "");
  write_file_atomically(folder.path() / "report.json", "{");
  EXPECT_THAT(test::error_of([&] { read_run_report(folder.path()); }),
              HasSubstr("report.json:1: expected JSON"));
}

}  // namespace
}  // namespace gld
