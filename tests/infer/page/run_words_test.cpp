#include "infer/page/run_words.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

using Json = nlohmann::ordered_json;

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

}  // namespace
}  // namespace gld
