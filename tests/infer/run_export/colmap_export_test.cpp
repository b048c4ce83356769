#include "infer/run_export/colmap_export.h"

#include "datasets/formats/colmap_binary.h"
#include "datasets/formats/scene_reader.h"
#include "infer/run_export/export_provenance.h"
#include "tests/infer/run_export/drawn_run.h"
#include "tests/support/run_program.h"
#include "tests/support/temporary_folder.h"

#include <map>
#include <sstream>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::DrawnRun;
using test::TemporaryFolder;
using ::testing::HasSubstr;

class ColmapExport : public ::testing::Test {
 protected:
  ColmapCounts exported(const DrawnRun& drawn) {
    views_ = test::write_drawn_run(folder_.path() / "run", drawn);
    const FinishedRun run = open_finished_run(folder_.path() / "run");
    if (!run.cloud.empty()) cloud_ = read_ply(run.cloud).cloud;
    std::filesystem::create_directory(out());
    return export_colmap(out(), run, cloud_, export_provenance(run, "{}"));
  }
  std::filesystem::path out() const { return folder_.path() / "colmap"; }
  std::filesystem::path binary() const { return out() / "sparse" / "0"; }

  const TemporaryFolder folder_;
  std::vector<test::DrawnView> views_;
  PointCloud cloud_;
};

Eigen::Vector2d projected(const Camera& camera, const Eigen::Vector3d& x_in_world) {
  const Eigen::Vector3d x = camera.camera_from_world() * x_in_world;
  return (camera.intrinsics * x).hnormalized();
}

// Returns what a file of COLMAP's text form says, by number.
std::map<int64_t, std::vector<std::string>> numbered_lines(const std::filesystem::path& file) {
  std::map<int64_t, std::vector<std::string>> lines;
  std::istringstream stream(read_file(file));
  for (std::string line; std::getline(stream, line);) {
    if (line.empty() || line[0] == '#') continue;
    std::istringstream words(line);
    std::vector<std::string> fields;
    for (std::string word; words >> word;) fields.push_back(word);
    lines[std::stoll(fields[0])] = fields;
  }
  return lines;
}

// Cameras are those of cameras.json, points are where the cloud has them and are seen where they lie.
TEST_F(ColmapExport, HoldsCamerasPointsAndWhereTheyAreSeen) {
  DrawnRun drawn;
  drawn.tall = 0.8;
  drawn.cut = 5;
  const ColmapCounts counts = exported(drawn);
  EXPECT_EQ(counts.points, cloud_.size());
  EXPECT_GT(counts.points, 1000);
  const Scene scene = open_scene(out());
  ASSERT_EQ(scene.frames.size(), views_.size());
  EXPECT_EQ(scene.points_in_world, cloud_.x_in_world);
  const ColmapSightings sightings = read_colmap_sightings(binary());
  int64_t sighted = 0;
  for (size_t i = 0; i < views_.size(); ++i) {
    const Camera& expected = views_[i].camera;
    EXPECT_LT((scene.frames[i].camera.intrinsics - expected.intrinsics).cwiseAbs().maxCoeff(), 1e-12);
    EXPECT_LT((scene.frames[i].camera.world_from_camera.matrix() - expected.world_from_camera.matrix())
                  .cwiseAbs()
                  .maxCoeff(),
              1e-12);
    EXPECT_EQ(scene.frames[i].image().rgb, views_[i].image.rgb);
    const auto& places = sightings.images.at(view_name(static_cast<int64_t>(i), 4) + ".png");
    sighted += static_cast<int64_t>(places.size());
    for (const ColmapSighting& sighting : places) {
      const Eigen::Vector3d& x = cloud_.x_in_world[sighting.point - 1];
      ASSERT_LT((projected(expected, x) - sighting.position).norm(), 0.01);
      // Nothing is seen through something else.
      const auto column = static_cast<int64_t>(sighting.position.x()),
                 row = static_cast<int64_t>(sighting.position.y());
      float farthest = 0;
      for (int64_t y = std::max<int64_t>(0, row - 1); y <= std::min(row + 1, expected.height - 1); ++y) {
        for (int64_t c = std::max<int64_t>(0, column - 1); c <= std::min(column + 1, expected.width - 1); ++c)
          farthest = std::max(farthest, views_[i].depth.at(c, y));
      }
      ASSERT_LT((expected.camera_from_world() * x).z(), 1.06 * farthest);
    }
  }
  EXPECT_EQ(sighted, counts.sightings);
  // A point was made of a pixel, whose view sees it.
  EXPECT_EQ(counts.seen_nowhere, 0);
  EXPECT_GT(sighted, counts.points);
}

// Colours are those of the cloud; errors are what the depths of views disagree by: that is little of exact depth, and
// not known for points that one view sees.
TEST_F(ColmapExport, GivesPointsColourErrorAndTrack) {
  const ColmapCounts counts = exported({});
  const auto points = numbered_lines(out() / "sparse_txt" / "points3D.txt");
  ASSERT_EQ(static_cast<int64_t>(points.size()), cloud_.size());
  int64_t alone = 0, several = 0;
  double sum = 0;
  for (const auto& [number, fields] : points) {
    const Rgb& colour = cloud_.colours[static_cast<size_t>(number) - 1];
    for (size_t c = 0; c < 3; ++c) ASSERT_EQ(std::stoi(fields[4 + c]), colour[c]);
    const double error = std::stod(fields[7]);
    const size_t track = (fields.size() - 8) / 2;
    if (track == 1) {
      ++alone;
      ASSERT_EQ(error, -1);
    } else {
      ++several;
      ASSERT_GE(error, 0);
      sum += error;
    }
  }
  EXPECT_EQ(alone, counts.seen_once);
  EXPECT_GT(several, 500);
  EXPECT_LT(sum / static_cast<double>(several), 0.5);
  EXPECT_GT(sum, 0);
  EXPECT_THAT(read_file(out() / "sparse_txt" / "images.txt"), HasSubstr("# gld:model 0123456789abcdef\n"));
  EXPECT_THAT(read_file(out() / "sparse_txt" / "cameras.txt"), HasSubstr("# gld:seed 7\n"));
}

// Depth that is off shows as an error, in pixels.
TEST_F(ColmapExport, SaysByHowMuchDepthsDisagree) {
  views_ = test::write_drawn_run(folder_.path() / "run", {});
  FinishedRun run = open_finished_run(folder_.path() / "run");
  cloud_ = read_ply(run.cloud).cloud;
  const auto mean_error = [&](const char* name) {
    const auto place = folder_.path() / name;
    std::filesystem::create_directory(place);
    export_colmap(place, run, cloud_, {});
    double sum = 0;
    int64_t count = 0;
    for (const auto& [number, fields] : numbered_lines(place / "sparse_txt" / "points3D.txt")) {
      if (fields.size() < 12) continue;
      sum += std::stod(fields[7]);
      ++count;
    }
    return sum / static_cast<double>(count);
  };
  const double exact = mean_error("exact");
  run.views[1].depth_unit *= 1.03;
  EXPECT_GT(mean_error("off"), exact + 0.05);
}

// Cameras, images and the places of points are the same, as far as the digits of the text form tell.
void expect_equal_models(const ColmapModel& read, const ColmapModel& expected) {
  ASSERT_EQ(read.images.size(), expected.images.size());
  EXPECT_EQ(read.cameras.size(), expected.cameras.size());
  for (size_t i = 0; i < expected.images.size(); ++i) {
    EXPECT_EQ(read.images[i].name, expected.images[i].name);
    EXPECT_LT((read.images[i].rotation.coeffs() - expected.images[i].rotation.coeffs()).norm(), 1e-12);
    EXPECT_LT((read.images[i].translation - expected.images[i].translation).norm(), 1e-12);
    const ColmapCamera& camera = read.cameras.at(read.images[i].camera_id);
    const ColmapCamera& expected_camera = expected.cameras.at(expected.images[i].camera_id);
    EXPECT_EQ(camera.model, expected_camera.model);
    EXPECT_EQ(camera.width, expected_camera.width);
    EXPECT_EQ(camera.height, expected_camera.height);
    EXPECT_EQ(camera.parameters, expected_camera.parameters);
  }
  ASSERT_EQ(read.points_in_world.size(), expected.points_in_world.size());
  for (size_t i = 0; i < expected.points_in_world.size(); ++i)
    ASSERT_LT((read.points_in_world[i] - expected.points_in_world[i]).norm(), 1e-9);
}

void expect_equal_sightings(const ColmapSightings& read, const ColmapSightings& expected) {
  EXPECT_EQ(read.points_in_world.size(), expected.points_in_world.size());
  ASSERT_EQ(read.images.size(), expected.images.size());
  for (const auto& [name, places] : expected.images) {
    ASSERT_EQ(read.images.at(name).size(), places.size());
    for (size_t i = 0; i < places.size(); ++i) {
      ASSERT_EQ(read.images.at(name)[i].point, places[i].point);
      ASSERT_LT((read.images.at(name)[i].position - places[i].position).norm(), 1e-9);
    }
  }
}

// Of points3D.txt: place, colour, error and track of each point.
void expect_equal_points(const std::filesystem::path& read_from, const std::filesystem::path& expected_from) {
  constexpr size_t kTrack = 8;
  const auto read = numbered_lines(read_from / "points3D.txt");
  const auto expected = numbered_lines(expected_from / "points3D.txt");
  ASSERT_EQ(read.size(), expected.size());
  for (const auto& [number, fields] : expected) {
    const auto& found = read.at(number);
    ASSERT_EQ(found.size(), fields.size()) << number;
    for (size_t i = 0; i < kTrack; ++i)
      ASSERT_NEAR(std::stod(found[i]), std::stod(fields[i]), 1e-9) << number;
    for (size_t i = kTrack; i < fields.size(); ++i) ASSERT_EQ(found[i], fields[i]) << number;
  }
}

// Debian's COLMAP reads both forms, which are one model to it, and writes what we read again.
TEST_F(ColmapExport, IsReadByColmap) {
  const ColmapCounts counts = exported({});
  const auto text = out() / "sparse_txt";
  const ColmapModel ours = read_colmap_model(binary(), ColmapForm::kBinary);
  EXPECT_EQ(ours.points_in_world.size(), static_cast<size_t>(counts.points));
  for (const auto& model : {binary(), text}) {
    SCOPED_TRACE(model);
    const auto analysis = test::run_program("colmap", {"model_analyzer", "--path", model.string()});
    EXPECT_EQ(analysis.status, 0) << analysis.text;
    EXPECT_THAT(analysis.text, HasSubstr("Cameras: 4\n"));
    EXPECT_THAT(analysis.text, HasSubstr("Registered images: 4\n"));
    EXPECT_THAT(analysis.text, HasSubstr("Points: " + std::to_string(counts.points) + "\n"));
    EXPECT_THAT(analysis.text, HasSubstr("Observations: " + std::to_string(counts.sightings) + "\n"));
    for (const auto& [type, form] :
         {std::pair("BIN", ColmapForm::kBinary), std::pair("TXT", ColmapForm::kText)}) {
      SCOPED_TRACE(type);
      const auto converted = folder_.path() / (model.filename().string() + "_" + type);
      std::filesystem::create_directory(converted);
      const auto conversion =
          test::run_program("colmap", {"model_converter", "--input_path", model.string(), "--output_path",
                                       converted.string(), "--output_type", type});
      ASSERT_EQ(conversion.status, 0) << conversion.text;
      expect_equal_models(read_colmap_model(converted, form), ours);
      if (form == ColmapForm::kBinary) {
        expect_equal_sightings(read_colmap_sightings(converted), read_colmap_sightings(binary()));
      } else {
        expect_equal_points(converted, text);
      }
    }
  }
}

// One view, and no cloud at all.
TEST_F(ColmapExport, HoldsOneViewWithoutPoints) {
  DrawnRun drawn;
  drawn.views = 2;
  drawn.points = false;
  drawn.depth = false;
  const ColmapCounts counts = exported(drawn);
  EXPECT_EQ(counts.points, 0);
  EXPECT_EQ(open_scene(out()).frames.size(), 2U);
  for (const auto& model : {binary(), out() / "sparse_txt"}) {
    const auto analysis = test::run_program("colmap", {"model_analyzer", "--path", model.string()});
    EXPECT_EQ(analysis.status, 0) << analysis.text;
    EXPECT_THAT(analysis.text, HasSubstr("Points: 0\n"));
  }
}

}  // namespace
}  // namespace gld
