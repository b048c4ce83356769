#include "infer/run_export/film.h"

#include "datasets/images/image_file.h"
#include "infer/paths/orbit_path.h"
#include "tests/infer/run_export/drawn_run.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "tests/support/webp_frames.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::DrawnRun;
using test::error_of;
using test::TemporaryFolder;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

std::vector<Camera> orbit(int64_t frames, double degrees) {
  Camera camera;
  camera.width = 48;
  camera.height = 36;
  camera.intrinsics << 40, 0, 24, 0, 40, 18, 0, 0, 1;
  OrbitShape shape;
  shape.frames = frames;
  shape.degrees = degrees;
  shape.fallback_distance = 3;
  return orbit_cameras({camera}, shape);
}

TEST(Film, KnowsWhetherAPathCloses) {
  EXPECT_TRUE(path_closes(orbit(12, 360)));
  EXPECT_FALSE(path_closes(orbit(12, 60)));
  EXPECT_FALSE(path_closes(orbit(12, 300)));
  EXPECT_FALSE(path_closes(orbit(3, 60)));
  EXPECT_FALSE(path_closes(orbit(2, 60)));
  EXPECT_FALSE(path_closes({}));
  // The camera is back at the place, looking elsewhere.
  std::vector<Camera> turned = orbit(12, 360);
  for (size_t i = 0; i < turned.size(); ++i) {
    turned[i].world_from_camera.linear() =
        Eigen::AngleAxisd(0.1 * static_cast<double>(i), Eigen::Vector3d::UnitY()).toRotationMatrix();
  }
  EXPECT_FALSE(path_closes(turned));
}

TEST(Film, GoesThereAndBack) {
  EXPECT_THAT(shown_frames(4, false), ElementsAre(0, 1, 2, 3, 2, 1));
  EXPECT_THAT(shown_frames(4, true), ElementsAre(0, 1, 2, 3));
  EXPECT_THAT(shown_frames(2, false), ElementsAre(0, 1));
  EXPECT_THAT(shown_frames(1, false), ElementsAre(0));
}

class FilmOfARun : public ::testing::Test {
 protected:
  FinishedRun run(const DrawnRun& drawn) {
    views_ = test::write_drawn_run(folder_.path() / "run", drawn);
    return open_finished_run(folder_.path() / "run");
  }
  const TemporaryFolder folder_;
  std::vector<test::DrawnView> views_;
};

TEST_F(FilmOfARun, ShowsTheTargetsAsTheyAre) {
  const FinishedRun finished = run({});
  const Film film = make_film(finished, {}, folder_.path());
  EXPECT_EQ(film.width, 48);
  EXPECT_EQ(film.pictures_a_second, 4);
  ASSERT_EQ(film.frames.size(), 3U);
  for (size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(film.frames[i].file, finished.views[i + 1].image);
    EXPECT_FALSE(film.frames[i].between());
  }
  EXPECT_EQ(carried_frames_text(film), "");
  EXPECT_EQ(film_provenance(finished, film, {}).back().first, "gld:frame_views");
}

// Halfway between a view and itself all is carried from where it was; frames between views are marked.
TEST_F(FilmOfARun, CarriesPicturesBetweenViews) {
  DrawnRun drawn;
  drawn.views = 3;
  FinishedRun finished = run(drawn);
  // The third view stands where the second one does, but for a hundredth: what is between them is both.
  finished.views[2].camera = finished.views[1].camera;
  finished.views[2].depth_camera = finished.views[1].depth_camera;
  finished.views[2].camera.world_from_camera.translation() +=
      0.01 * finished.views[1].camera.world_from_camera.linear().col(0);
  finished.views[2].image = finished.views[1].image;
  finished.views[2].depth = finished.views[1].depth;
  FilmOptions options;
  options.between = 2;
  const Film film = make_film(finished, options, folder_.path());
  EXPECT_FALSE(film.closes);
  EXPECT_EQ(film.pictures_a_second, 12);
  ASSERT_EQ(film.frames.size(), 4U);
  EXPECT_THAT(film.shown, ElementsAre(0, 1, 2, 3, 2, 1));
  EXPECT_EQ(carried_frames_text(film), "1-2, 4-5");
  for (const size_t i : {1U, 2U}) {
    EXPECT_TRUE(film.frames[i].between());
    EXPECT_GT(film.frames[i].carried, 0.9);
    EXPECT_NEAR(film.frames[i].position, static_cast<double>(i) / 3, 1e-12);
    EXPECT_GT(test::psnr_of(read_image(film.frames[i].file), views_[1].image), 22);
  }
  const auto json = film_json(finished, film);
  EXPECT_EQ(json.at("pictures"), 6);
  EXPECT_EQ(json.at("seconds"), 0.5);
  EXPECT_EQ(json.at("frames")[1].at("between").dump(), R"(["view_01","view_02"])");
  EXPECT_EQ(json.at("frames")[3].at("view"), "view_02");
  const TextItems texts = film_provenance(finished, film, {{"gld:seed", "7"}});
  EXPECT_THAT(texts, ElementsAre(::testing::Pair("gld:seed", "7"),
                                 ::testing::Pair("gld:frame_views", "view_01, view_02"),
                                 ::testing::Pair("gld:carried_frames", "1-2, 4-5")));
}

// A closed path has pictures between its last view and its first.
TEST_F(FilmOfARun, GoesOnceAroundWhereThePathCloses) {
  DrawnRun drawn;
  drawn.views = 5;
  FinishedRun finished = run(drawn);
  const std::vector<Camera> cameras = orbit(4, 360);
  for (size_t i = 0; i < 4; ++i) {
    finished.views[i + 1].camera = cameras[i];
    finished.views[i + 1].depth_camera = cameras[i];
  }
  FilmOptions options;
  options.between = 1;
  const Film film = make_film(finished, options, folder_.path());
  EXPECT_TRUE(film.closes);
  ASSERT_EQ(film.frames.size(), 8U);
  EXPECT_EQ(film.frames[7].view, 4U);
  EXPECT_EQ(film.frames[7].next_view, 1U);
  EXPECT_EQ(film.shown.size(), 8U);
  EXPECT_EQ(carried_frames_text(film), "1, 3, 5, 7");
}

TEST_F(FilmOfARun, SaysInASentenceWhatIsMissing) {
  DrawnRun drawn;
  drawn.target_images = false;
  const std::string place = (folder_.path() / "run").string();
  EXPECT_EQ(
      error_of([&] { check_film(run(drawn), 0); }),
      place +
          ": expected pictures of target views, found none; sample with --outputs image,depth,points, or leave "
          "webp and mp4 out.");
  drawn.target_images = true;
  drawn.depth = false;
  std::filesystem::remove_all(folder_.path() / "run");
  FinishedRun finished = run(drawn);
  check_film(finished, 0);
  EXPECT_EQ(
      error_of([&] { check_film(finished, 1); }),
      "--between: expected depth of the target views, which carries pictures between them, found none of "
      "view_01 in " +
          place + "; sample with --outputs image,depth,points, or leave --between out.");
  finished.views[2].camera.width = 50;
  EXPECT_THAT(error_of([&] { check_film(finished, 0); }),
              HasSubstr("expected target views of one size, 48x36, found 50x36 of view_02"));
}

}  // namespace
}  // namespace gld
