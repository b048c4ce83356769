#include "infer/page/run_words.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using Json = nlohmann::ordered_json;
using testing::ElementsAre;
using testing::IsEmpty;

TEST(RunWords, SayWhatWasAskedFor) {
  Json report{
      {"scene",
       {{"name", "kitchen"}, {"views", {"a", "b", "c"}}, {"sources", 1u}, {"width", 504}, {"height", 280}}},
      {"model", {{"name", "tiny"}}}};
  EXPECT_EQ(asked_of_sample(report),
            "Asked for: 2 new views of kitchen from 1 photograph at 504x280 pixels, by the model tiny.");
  report["scene"]["sources"] = 2u;
  report.erase("model");
  EXPECT_EQ(asked_of_sample(report),
            "Asked for: 1 new view of kitchen from 2 photographs at 504x280 pixels.");
  report["scene"]["sources"] = 9u;
  EXPECT_EQ(asked_of_sample(report), "");
  EXPECT_EQ(asked_of_sample(Json::array()), "");
}

TEST(RunWords, SayWhatCameOut) {
  EXPECT_EQ(verdict_of_sample({{"verdict", {{"sentence", "They fit."}}}}), "They fit.");
  EXPECT_EQ(verdict_of_sample(Json::object()),
            "No pictures were asked for, so that nothing is said of their quality.");
}

TEST(RunWords, SayEveryDoubtOnce) {
  const Json report{
      {"verdict", {{"drawn_rooms_only", true}, {"unfamiliar", false}}},
      {"warnings",
       {"the cameras of the photographs are not sure: they turn only",
        "The scale of the predicted depth is not known (camera_poses: none). Depth, points.ply and cameras.json are in the model's.",
        "the cameras of the photographs are not sure: they turn only", 7}}};
  EXPECT_THAT(
      doubts_of_run(report),
      ElementsAre(
          "The model has seen drawn rooms only: do not expect it to know what real places look like.",
          "The cameras of the photographs are not sure: they turn only.",
          "How large the scene is is not known: depth, cloud and cameras are in the model's own unit."));
  EXPECT_THAT(doubts_of_run({{"verdict", {{"drawn_rooms_only", true}, {"unfamiliar", true}}}}), IsEmpty());
  EXPECT_THAT(doubts_of_run(Json::object()), IsEmpty());
}

TEST(RunWords, AValueThatIsNotThereIsNull) {
  const Json report{{"a", {{"b", {1, "two"}}}}};
  EXPECT_EQ(report_text_at(report, "/a/b/1"), "two");
  EXPECT_EQ(report_text_at(report, "/a/b/0"), "");
  EXPECT_TRUE(report_value(report, "/a/b/2").is_null());
  EXPECT_TRUE(report_value(report, "/a/b/c").is_null());
  EXPECT_TRUE(report_value(report, "/x/y").is_null());
}

}  // namespace
}  // namespace gld
