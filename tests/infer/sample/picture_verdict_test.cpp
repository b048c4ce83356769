#include "infer/sample/picture_verdict.h"

#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using testing::HasSubstr;
using testing::Not;

LeftOutPhotograph left_out(double covered, double psnr_covered, double psnr, double trivial) {
  LeftOutPhotograph one;
  one.from = {1};
  one.depth_known = true;
  one.covered = covered;
  one.psnr_covered = psnr_covered;
  one.psnr = psnr;
  one.psnr_nearest = trivial;
  one.psnr_mean = trivial - 1;
  return one;
}

PictureEvidence evidence_of(const LeftOutPhotograph& one) {
  PictureEvidence evidence;
  evidence.sources = 2;
  evidence.left_out = {one, one};
  evidence.keeps_photographs = true;
  evidence.kept = 0.84;
  return evidence;
}

// The means of tests/shared/shared_leave_one_out_test.cpp, best first.
TEST(PictureVerdict, RealScenesAreOrderedRightly) {
  const double none = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(verdict_of(evidence_of(left_out(0.93, 30.1, 29.5, 18.4))).photographs, PhotographsAgree::kWell);
  EXPECT_EQ(verdict_of(evidence_of(left_out(0.97, 25.0, 24.6, 17.5))).photographs, PhotographsAgree::kWell);
  EXPECT_EQ(verdict_of(evidence_of(left_out(0.66, 22.5, 20.4, 16.1))).photographs, PhotographsAgree::kWell);
  EXPECT_EQ(verdict_of(evidence_of(left_out(0.66, 19.5, 18.4, 16.1))).photographs,
            PhotographsAgree::kRoughly);
  EXPECT_EQ(verdict_of(evidence_of(left_out(0.42, 10.9, 12.2, 13.1))).photographs, PhotographsAgree::kNot);
  EXPECT_EQ(verdict_of(evidence_of(left_out(0, none, 12.7, 11.2))).photographs, PhotographsAgree::kHardly);
  EXPECT_EQ(verdict_of(PictureEvidence()).photographs, PhotographsAgree::kOne);
}

// From one place, however much they overlap, photographs tell no depth.
TEST(PictureVerdict, PhotographsWithoutDepthAreNotSaidToLieApart) {
  LeftOutPhotograph one = left_out(0, std::numeric_limits<double>::quiet_NaN(), 12.7, 11.2);
  one.depth_known = false;
  PictureEvidence evidence = evidence_of(one);
  evidence.kept = 0;
  const PictureVerdict verdict = verdict_of(evidence);
  EXPECT_EQ(verdict.photographs, PhotographsAgree::kUntold);
  EXPECT_EQ(
      verdict.sentence,
      "The photographs tell no depth: they were taken from one place or from far away, show nothing in common or have "
      "no texture: expect inventions; 0 % of the target views come from them; take some a step to the side of each "
      "other, of the same things.");
  EXPECT_EQ(verdict_json(verdict, evidence).at("photographs"), "tell no depth");
}

TEST(PictureVerdict, IsOneSentenceWithItsFigures) {
  const std::string good = verdict_of(evidence_of(left_out(0.93, 30.1, 29.5, 18.4))).sentence;
  EXPECT_EQ(
      good,
      "These pictures are as good as the photographs' predictions of each other are (30 dB where they show the "
      "same, 30 dB in all, 93 % shown); 84 % of the target views come from them.");
  const std::string bad = verdict_of(evidence_of(left_out(0.12, 18, 12.7, 11.2))).sentence;
  EXPECT_THAT(
      bad,
      HasSubstr("hardly overlap (the others show 12 % of one): expect inventions; 84 % of the target views "
                "come from them; take some in between, each with half of what the one beside it shows."));
  const std::string apart = verdict_of(evidence_of(left_out(0.42, 10.9, 12.2, 13.1))).sentence;
  EXPECT_THAT(apart, HasSubstr("; take some in between, or look whether the cameras are theirs."));
  PictureEvidence one;
  EXPECT_EQ(
      verdict_of(one).sentence,
      "One photograph does not tell how far away things are: expect inventions; take a second one, a step to the "
      "side.");
  one.keeps_photographs = true;
  one.kept = 0.44;
  EXPECT_EQ(
      verdict_of(one).sentence,
      "One photograph does not tell how far away things are, the model guesses it; 44 % of the target views come from "
      "that photograph: expect bends and inventions; take a second one, a step to the side.");
  one.unit_log_deviation = 0.1595;
  EXPECT_THAT(
      verdict_of(one).sentence,
      HasSubstr("the model guesses it (27 % nearer or 38 % farther would not surprise); 44 % of the target"));
  PictureEvidence generated = evidence_of(left_out(0.93, 30.1, 29.5, 18.4));
  generated.keeps_photographs = false;
  EXPECT_THAT(verdict_of(generated).sentence, Not(HasSubstr("These pictures are as good")));
}

TEST(PictureVerdict, WarnsOfWhatIsGeneratedOnlyWhereSomethingIs) {
  PictureEvidence evidence = evidence_of(left_out(0.93, 30.1, 29.5, 18.4));
  evidence.usual = {SeenLevel()};
  evidence.usual[0].usual = 1;
  evidence.divergences = {2};
  EXPECT_THAT(verdict_of(evidence).sentence, HasSubstr("do not trust what it generates"));
  evidence.kept = 0.996;
  EXPECT_TRUE(verdict_of(evidence).unfamiliar);
  EXPECT_THAT(verdict_of(evidence).sentence, Not(HasSubstr("do not trust")));
  evidence.keeps_photographs = false;
  EXPECT_THAT(verdict_of(evidence).sentence, HasSubstr("do not trust"));
}

TEST(PictureVerdict, ViewsFarBehindTheOthersAreNamed) {
  PictureEvidence evidence = evidence_of(left_out(0.93, 26, 25, 18.4));
  evidence.views = {{"view_04", 20.9}, {"view_05", 27}, {"view_06", 21.1}, {"view_07", 14}};
  // What is expected of the photographs that were left out is 2 dB too high.
  for (LeftOutPhotograph& one : evidence.left_out) one.expected = 27;
  EXPECT_THAT(verdict_of(evidence).sentence,
              HasSubstr("; about 19 to 25 dB can be expected of the views, only 12 dB of view_07."));
  evidence.views[3].psnr = 20.9;
  EXPECT_THAT(verdict_of(evidence).sentence, HasSubstr("; about 19 to 25 dB can be expected of the views."));
  evidence.views.assign(8, {"path", 15});
  for (size_t i = 0; i < 5; ++i) evidence.views.push_back({"end", 1.0 + static_cast<double>(i)});
  EXPECT_THAT(verdict_of(evidence).sentence,
              HasSubstr("; about 13 dB can be expected of the views, only -1 to 3 dB of 5 of 13."));
  EXPECT_NEAR(expected_views(evidence)[0].psnr, 13, 1e-9);
  // Where inventions are to be expected of all, none is named; nothing is said where nothing tells.
  evidence.left_out = {left_out(0.12, 18, 12.7, 11.2)};
  EXPECT_THAT(verdict_of(evidence).sentence, Not(HasSubstr("expected of the views")));
  evidence.left_out.clear();
  EXPECT_TRUE(expected_views(evidence).empty());
}

TEST(PictureVerdict, ViewsBeyondThePhotographsAreNotAsGoodAsThese) {
  // Photographs side by side predict each other far better than expected; one view lies beside them, one beyond.
  PictureEvidence evidence = evidence_of(left_out(0.92, 35, 31, 18.4));
  for (LeftOutPhotograph& one : evidence.left_out) one.expected = 23;
  evidence.views = {{"beside", 22, 0.8}, {"beyond", 20, 0.5}};
  EXPECT_NEAR(expected_views(evidence)[0].psnr, 30, 1e-9);
  EXPECT_NEAR(expected_views(evidence)[1].psnr, 20, 1e-9);
  evidence.views[1].kept = 0.92 * 0.725;  // half way between
  EXPECT_NEAR(expected_views(evidence)[1].psnr, 24, 1e-9);
  // What was promised too much is taken back everywhere.
  for (LeftOutPhotograph& one : evidence.left_out) one.expected = 33;
  evidence.views[1].kept = 0.5;
  EXPECT_NEAR(expected_views(evidence)[1].psnr, 18, 1e-9);
  for (LeftOutPhotograph& one : evidence.left_out) one.expected = 23;
  evidence.kept = 0.46;
  EXPECT_EQ(
      verdict_of(evidence).sentence,
      "54 % of the target views come from no photograph: expect inventions there; ask for views between the "
      "photographs or take some from there; of each other these tell 35 dB where they show the same, 31 dB in all, 92 % shown; about 30 dB can be expected of the views, only "
      "20 dB of beyond.");
  evidence.kept = 0.56;
  EXPECT_THAT(verdict_of(evidence).sentence, HasSubstr("These pictures are as good as"));
}

TEST(PictureVerdict, AModelNoticesWhatItHasNotSeen) {
  PictureEvidence evidence = evidence_of(left_out(0.93, 30.1, 29.5, 18.4));
  evidence.drawn_rooms_only = true;
  evidence.usual = {{1, 0.02, 0.08, 0.12}};
  evidence.divergences = {0.05};
  evidence.prior = PriorAgreement{5000, 2.5, 0.08, 0.1};
  EXPECT_FALSE(verdict_of(evidence).unfamiliar);
  EXPECT_THAT(verdict_of(evidence).sentence, Not(HasSubstr("drawn rooms")));
  // Its latents, or its depth of another shape than the photographs agree on.
  evidence.divergences = {0.1};
  EXPECT_TRUE(verdict_of(evidence).unfamiliar);
  evidence.divergences = {0.05};
  evidence.prior->spread = 0.33;
  EXPECT_THAT(
      verdict_of(evidence).sentence,
      HasSubstr(
          "this model has seen drawn rooms only and has nothing to say about what no photograph shows"));
  evidence.prior->pixels = 0;  // photographs that agree nowhere say nothing of it
  EXPECT_FALSE(verdict_of(evidence).unfamiliar);
  evidence.divergences = {0.1};
  evidence.drawn_rooms_only = false;
  EXPECT_THAT(verdict_of(evidence).sentence, HasSubstr("unlike what this model was trained on"));
}

}  // namespace
}  // namespace gld
