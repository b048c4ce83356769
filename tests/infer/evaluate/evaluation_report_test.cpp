#include "infer/evaluate/evaluation_report.h"

#include "gld/metrics/metric_list.h"
#include "infer/evaluate/scene_record.h"
#include "tests/support/csv_cells.h"
#include "tests/support/error_of.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::csv_cells;
using testing::HasSubstr;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// Returns a scene whose columns have these values; the others are absent.
SceneEvaluation scene_with(const std::string& name, const std::map<std::string, double>& values) {
  SceneEvaluation scene;
  scene.scene = name;
  for (const EvaluationColumn& column : evaluation_columns()) {
    const auto found = values.find(column.name);
    scene.numbers.push_back(found == values.end() ? SceneNumber{kNaN, "it was not measured"}
                                                  : SceneNumber{found->second, ""});
  }
  return scene;
}

SceneEvaluation scene(const std::string& name, double sample_psnr) {
  return scene_with(name, {{"sample_psnr", sample_psnr},
                           {"mean_prediction_psnr", 21.0},
                           {"psnr_nearest_source", 14.0},
                           {"psnr_mean_source", 15.5},
                           {"psnr_mean_color", 19.0},
                           {"sample_sharpness", 0.5}});
}

TEST(EvaluationReport, HasBothPredictionsOfEveryMetricOfImages) {
  std::vector<std::string> names;
  for (const EvaluationColumn& column : evaluation_columns()) names.push_back(column.name);
  for (const Metric& metric : metric_list()) {
    if (!of_every_predictor(metric)) continue;
    for (const std::string& name : {"sample_" + metric.name, "mean_prediction_" + metric.name,
                                    metric.name + "_nearest_source", "reconstruction_" + metric.name}) {
      EXPECT_THAT(names, testing::Contains(name));
    }
  }
  for (const char* name :
       {"psnr_mean_source", "psnr_mean_color", "depth_abs_rel_unscaled", "rotation_error", "sample_psnr_seen",
        "sample_psnr_unseen", "fill_psnr_unseen", "warped_sources_psnr", "reconstructed_fill_psnr",
        "sample_energy_score", "sample_energy_score_unseen", "sample_energy_score_features",
        "fill_energy_score_features_unseen", "energy_score_nearest_source"}) {
    EXPECT_THAT(names, testing::Contains(name));
  }
  EXPECT_THAT(names, testing::Not(testing::Contains("psnr")));
}

TEST(EvaluationReport, TheTableLeavesAbsentNumbersEmpty) {
  auto first = scene("room_1", 18.25);
  const std::string csv = evaluation_csv({first});
  std::istringstream text(csv);
  std::string header, row;
  std::getline(text, header);
  std::getline(text, row);
  const auto names = csv_cells(header), values = csv_cells(row);
  ASSERT_EQ(values.size(), names.size());
  std::map<std::string, std::string> by_name;
  for (size_t i = 0; i < names.size(); ++i) by_name[names[i]] = values[i];
  EXPECT_EQ(by_name.at("scene"), "room_1");
  EXPECT_EQ(by_name.at("sample_psnr"), "18.250000");
  EXPECT_EQ(by_name.at("mean_prediction_psnr"), "21.000000");
  EXPECT_EQ(by_name.at("depth_abs_rel_unscaled"), "");
  EXPECT_EQ(by_name.at("sample_beats_mean_source"), "1");
  EXPECT_EQ(by_name.at("sample_beats_mean_color"), "0");
}

TEST(EvaluationReport, CountsWhereSamplesBeatTheTrivialPredictors) {
  const auto summary = evaluation_summary({scene("a", 18.0), scene("b", 20.0), scene("c", 13.0)});
  EXPECT_EQ(summary.at("better_than_every_trivial"), 1);
  EXPECT_EQ(summary.at("sample_beats").at("nearest_source"), 2);
  EXPECT_EQ(summary.at("sample_beats").at("mean_source"), 2);
  EXPECT_EQ(summary.at("sample_beats").at("mean_color"), 1);
  EXPECT_EQ(summary.at("best_trivial_predictor"), "psnr_mean_color");
  EXPECT_NEAR(summary.at("sample_margin_over_best_trivial_db").get<double>(), 17 - 19, 1e-12);
  EXPECT_NEAR(summary.at("mean_prediction_margin_over_best_trivial_db").get<double>(), 2, 1e-12);
  EXPECT_THAT(evaluation_text(summary), HasSubstr("better than every trivial predictor in 1 of 3 scenes"));
}

TEST(EvaluationReport, CountsWhereSamplesWinAgainstEachRival) {
  const auto room = [](const char* name, double sample, double fill, double fill_psnr) {
    return scene_with(name, {{"sample_psnr", 20},
                             {"fill_psnr", fill_psnr},
                             {"sample_energy_score", sample},
                             {"fill_energy_score", fill},
                             {"energy_score_mean_color", 0.3}});
  };
  std::vector<SceneEvaluation> scenes{room("a", 0.05, 0.06, 21), room("b", 0.05, 0.04, 21),
                                      room("c", 0.05, 0.05, 19), room("d", 0.05, kNaN, kNaN)};
  for (SceneEvaluation& scene : scenes) scene.samples = 4;
  const auto summary = evaluation_summary(scenes);
  const auto& wins = summary.at("sample_wins");
  EXPECT_EQ(wins.at("energy_score").at("fill"),
            (nlohmann::ordered_json{{"won", 1}, {"scenes", 3}}));  // less is better
  EXPECT_EQ(wins.at("psnr").at("fill"), (nlohmann::ordered_json{{"won", 1}, {"scenes", 3}}));
  EXPECT_EQ(wins.at("energy_score").at("mean_color"), (nlohmann::ordered_json{{"won", 4}, {"scenes", 4}}));
  EXPECT_EQ(wins.at("energy_score_features_unseen").at("reconstructed_fill"),
            (nlohmann::ordered_json{{"won", 0}, {"scenes", 0}}));
  EXPECT_EQ(summary.at("energy_score").at("samples"), 4);
  EXPECT_EQ(summary.at("energy_score").at("formula"), "E|x - y| - E|x - x'| / 2");
  const std::string text = evaluation_text(summary);
  EXPECT_THAT(text, HasSubstr("| fill"));
  EXPECT_THAT(text, HasSubstr("1 of 3"));
  EXPECT_THAT(text, HasSubstr("unbiased over pairs of different samples"));
  // Of one sample there is no pair.
  scenes[2].samples = 1;
  EXPECT_THAT(
      evaluation_text(evaluation_summary(scenes)),
      HasSubstr("energy scores of samples: |x - y| (1 a scene), of one sample a scene its distance alone"));

  std::istringstream csv(evaluation_csv(scenes));
  std::string header, row;
  std::getline(csv, header);
  const auto names = csv_cells(header);
  const auto column = static_cast<size_t>(
      std::find(names.begin(), names.end(), "sample_wins_energy_score_fill") - names.begin());
  std::vector<std::string> found;
  while (std::getline(csv, row)) {
    ASSERT_EQ(csv_cells(row).size(), names.size());
    found.push_back(csv_cells(row).at(column));
  }
  EXPECT_EQ(found, (std::vector<std::string>{"1", "0", "0", ""}));
}

TEST(EvaluationReport, AMeanSaysWhatItIsOf) {
  auto perfect = scene("b", std::numeric_limits<double>::infinity());
  const auto summary = evaluation_summary({scene("a", 18.0), perfect, scene("c", 20.0)});
  const auto& psnr = summary.at("means").at("sample_psnr");
  EXPECT_NEAR(psnr.at("mean").get<double>(), 19.0, 1e-12);
  EXPECT_NEAR(psnr.at("deviation").get<double>(), 1, 1e-12);
  EXPECT_EQ(psnr.at("scenes"), 2);
  EXPECT_EQ(psnr.at("infinite"), 1);
  EXPECT_EQ(psnr.at("unit"), "dB");
  EXPECT_EQ(psnr.at("better"), "higher");
  const auto& depth = summary.at("means").at("depth_abs_rel_unscaled");
  EXPECT_TRUE(depth.at("mean").is_null());
  EXPECT_EQ(depth.at("scenes"), 0);
  EXPECT_EQ(depth.at("absent").at("it was not measured"), 3);
  EXPECT_THAT(evaluation_text(summary), HasSubstr("absent in 3 of 3 scenes, it was not measured"));
}

TEST(EvaluationReport, AnIntervalIsDrawnOverScenesAndAbsentForOne) {
  const auto three = evaluation_summary({scene("a", 18.0), scene("b", 19.0), scene("c", 23.0)}).at("means");
  const auto& interval = three.at("sample_psnr").at("interval_95");
  EXPECT_GE(interval.at(0).get<double>(), 18);
  EXPECT_LT(interval.at(0).get<double>(), 20);
  EXPECT_GT(interval.at(1).get<double>(), 20);
  EXPECT_LE(interval.at(1).get<double>(), 23);
  EXPECT_FALSE(three.at("sample_psnr").contains("confidence_95"));  // one interval
  EXPECT_TRUE(
      evaluation_summary({scene("a", 18.0)}).at("means").at("sample_psnr").at("interval_95").at(0).is_null());
}

TEST(EvaluationReport, ARowATargetLeavesOutWhatIsOfTheScene) {
  auto measured = scene("a, \"b\"", 18.0);
  measured.samples = 2;
  measured.sources = {"f0"};
  measured.targets = {"f1", "f2"};
  const auto& columns = evaluation_columns();
  for (size_t i = 0; i < columns.size(); ++i) {
    if (columns[i].name == "sample_psnr") measured.numbers[i].of_targets = {{17, kNaN}, {18, 19}};
    if (columns[i].name == "mean_prediction_psnr") measured.numbers[i].of_targets = {{20, 21}};
  }
  EXPECT_EQ(targets_csv({measured}),
            "scene,sources,sample,target,sample_psnr,mean_prediction_psnr\n"
            "\"a, \"\"b\"\"\",1,0,f1,17.000000,20.000000\n"
            "\"a, \"\"b\"\"\",1,0,f2,,21.000000\n"
            "\"a, \"\"b\"\"\",1,1,f1,18.000000,\n"
            "\"a, \"\"b\"\"\",1,1,f2,19.000000,\n");
}

TEST(EvaluationReport, PicturesAreOfMetricsThatSeveralScenesHave) {
  std::vector<std::string> names;
  for (const auto& picture : metric_pictures({scene("a", 18.0), scene("b", 19.0)}))
    names.push_back(picture.name);
  EXPECT_THAT(names, testing::Contains("psnr"));
  EXPECT_THAT(names, testing::Not(testing::Contains("ate")));  // absent in both
  EXPECT_TRUE(metric_pictures({scene("a", 18.0)}).empty());
}

TEST(SceneRecord, ReadsBackEqual) {
  auto measured = scene("a", std::numeric_limits<double>::infinity());
  measured.samples = 3;
  measured.sources = {"f0", "f9"};
  measured.targets = {"f1"};
  measured.numbers[0].of_targets = {{1.0 / 3}, {kNaN}, {-std::numeric_limits<double>::infinity()}};
  measured.numbers[0].absent_samples = 1;
  const auto text = scene_record(measured).dump();
  const auto found = scene_from_record(nlohmann::json::parse(text), "here");
  EXPECT_EQ(scene_record(found).dump(), text);
  EXPECT_EQ(found.number("sample_psnr").value, std::numeric_limits<double>::infinity());
  EXPECT_TRUE(std::isnan(found.number("ate").value));
  EXPECT_EQ(found.number("ate").absent, "it was not measured");
  EXPECT_THAT(test::error_of([] { scene_from_record(nlohmann::json::parse("{}"), "scenes/0.json"); }),
              HasSubstr("scenes/0.json: expected a scene that gld eval has measured"));
}

}  // namespace
}  // namespace gld
