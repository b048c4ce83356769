#include "datasets/registration/colmap_registration.h"

#include "datasets/formats/colmap_model.h"
#include "datasets/images/image_file.h"
#include "gld/base/atomic_file.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <cstdlib>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using testing::HasSubstr;
using testing::MatchesRegex;

// This uses a program that stands in for COLMAP; what COLMAP itself finds is tested with the label shared.
class ColmapRegistration : public testing::Test {
 protected:
  ColmapRegistration() {
    for (int i = 0; i < 3; ++i) {
      UnregisteredPhotograph photograph;
      photograph.name = "photo_" + std::to_string(i);
      photograph.file = folder_.path() / (photograph.name + ".png");
      photograph.width = 16;
      photograph.height = 12;
      photograph.focal_length = 0.9;
      write_png(photograph.file, Image(16, 12));
      photographs_.push_back(photograph);
    }
  }
  ColmapRegistrationOptions standing_in(const std::string& script) {
    ColmapRegistrationOptions options;
    options.program = folder_.path() / "colmap";
    write_file_atomically(options.program, "#!/bin/sh\n" + script);
    std::filesystem::permissions(options.program, std::filesystem::perms::owner_all);
    return options;
  }
  std::string refusal(const ColmapRegistrationOptions& options) {
    return test::error_of([&] { register_by_colmap(photographs_, options, "--photo-cameras"); });
  }

  test::TemporaryFolder folder_;
  std::vector<UnregisteredPhotograph> photographs_;
};

TEST_F(ColmapRegistration, ReadsTheLargestModelAndNamesWhatIsNotInIt) {
  ColmapModel model;
  model.cameras[1] = {"SIMPLE_RADIAL", 16, 12, {14, 8, 6, -0.1}};
  for (const char* name : {"000000.png", "000002.png"}) {
    ColmapImage image;
    image.camera_id = 1;
    image.name = name;
    image.translation = model.images.empty() ? Eigen::Vector3d(0, 0, 1) : Eigen::Vector3d(-2, 0, 1);
    model.images.push_back(image);
  }
  model.points_in_world = {{0, 0, 3}};
  const auto made = folder_.path() / "made";
  std::filesystem::create_directory(made);
  write_colmap_model(made, model, ColmapForm::kBinary);
  const auto asked = folder_.path() / "asked.txt";
  const auto options =
      standing_in("echo \"$@\" >>" + asked.string() +
                  "\nif [ \"$1\" = mapper ]; then\n  while [ \"$1\" != --output_path ]; do shift; done\n"
                  "  cp -r " +
                  made.string() + " \"$2/0\"\nfi\n");
  const Registration found = register_by_colmap(photographs_, options, "--photo-cameras");
  EXPECT_EQ(found.way, "colmap");
  EXPECT_EQ(found.registered(), 2);
  EXPECT_TRUE(found.photographs[0].registered);
  EXPECT_EQ(found.photographs[1].reason, "COLMAP finds no camera that fits with the others'");
  EXPECT_EQ(found.photographs[2].camera.lens.k1, -0.1);
  EXPECT_EQ(found.photographs[2].camera.intrinsics(0, 0), 14);
  EXPECT_EQ(found.points_in_world.size(), 1U);
  ASSERT_EQ(found.lenses.size(), 1U);
  EXPECT_EQ(found.lenses[0].exif_focal_length, 0.9);
  const std::string commands = read_file(asked);
  EXPECT_THAT(commands, HasSubstr("--ImageReader.camera_params 14.400000,8,6,0"));
  EXPECT_THAT(commands, HasSubstr("--SiftExtraction.use_gpu 0"));
  EXPECT_THAT(commands, HasSubstr("exhaustive_matcher --database_path"));
}

// COLMAP 3.13 has other names for what is not of SIFT alone.
TEST_F(ColmapRegistration, OptionsAreNamedAsItsOwnHelpNamesThem) {
  const auto asked = folder_.path() / "asked.txt";
  const auto newer = standing_in(
      "if [ \"$2\" = --help ]; then\n  echo '  --FeatureExtraction.use_gpu arg (=1)'\n"
      "  echo '  --FeatureMatching.num_threads arg (=-1)'\n  exit 0\nfi\n"
      "echo \"$@\" >>" +
      asked.string() + "\n");
  refusal(newer);  // it finds nothing
  const std::string commands = read_file(asked);
  EXPECT_THAT(commands, HasSubstr("--FeatureExtraction.use_gpu 0 --SiftExtraction.num_threads"));
  EXPECT_THAT(commands, HasSubstr("--SiftMatching.use_gpu 0 --FeatureMatching.num_threads"));
}

TEST_F(ColmapRegistration, AFailureThatNobodyAskedForLeavesNothingBehind) {
  auto failing = standing_in("echo no; echo never; exit 3\n");
  failing.keeps_failures = false;
  EXPECT_EQ(
      refusal(failing),
      "--photo-cameras: expected COLMAP's feature_extractor to succeed, found exit status 3; it printed at last: "
      "never; take --photo-cameras features.");
}

TEST_F(ColmapRegistration, SaysInASentenceWhatWentWrong) {
  const auto failing = standing_in("echo no; exit 3\n");
  const std::string refused = refusal(failing);
  EXPECT_THAT(
      refused,
      MatchesRegex("--photo-cameras: expected COLMAP's feature_extractor to succeed, found exit status "
                   "3; what it printed is in .*/colmap.log; see there, or take --photo-cameras "
                   "features."));
  const size_t begin = refused.find("is in ") + 6;
  const std::filesystem::path log = refused.substr(begin, refused.find(';', begin) - begin);
  EXPECT_EQ(read_file(log), "no\n");
  std::filesystem::remove_all(log.parent_path());
  auto sleeping = standing_in("exec sleep 60\n");
  sleeping.timeout = 0.2;
  const std::string late = refusal(sleeping);
  EXPECT_THAT(late,
              HasSubstr("expected COLMAP's feature_extractor to end within 0.2 s, found it still running"));
  const size_t place = late.find("is in ") + 6;
  std::filesystem::remove_all(
      std::filesystem::path(late.substr(place, late.find(';', place) - place)).parent_path());
  // Nothing fits: no model is written.
  EXPECT_THAT(refusal(standing_in("exit 0\n")),
              HasSubstr("found none of 3 that fit together (photo_0: COLMAP finds no"));
  photographs_.resize(1);
  EXPECT_THAT(refusal(failing), HasSubstr("expected two photographs or more"));
}

TEST_F(ColmapRegistration, IsFoundOnThePath) {
  const auto options = standing_in("exit 0\n");
  const char* before = std::getenv("PATH");
  const std::string path = before == nullptr ? "" : before;
  ::setenv("PATH", ("/nowhere::" + folder_.path().string()).c_str(), 1);
  EXPECT_EQ(found_colmap(), options.program);
  ::setenv("PATH", "/nowhere", 1);
  EXPECT_TRUE(found_colmap().empty());
  ::setenv("PATH", path.c_str(), 1);
}

}  // namespace
}  // namespace gld
