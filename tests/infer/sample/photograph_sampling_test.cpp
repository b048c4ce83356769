#include "datasets/formats/cameras_json.h"
#include "datasets/formats/scene_reader.h"
#include "datasets/formats/scene_writer.h"
#include "datasets/images/image_file.h"
#include "datasets/loading/batching.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "gld/metrics/metric_list.h"
#include "infer/paths/camera_path.h"
#include "infer/sample/sampling.h"
#include "tests/infer/sample/sampling_fixture.h"
#include "tests/support/error_of.h"
#include "tests/support/exif_jpeg.h"

#include <cmath>
#include <filesystem>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

using testing::HasSubstr;
using testing::Not;

// What gld sample makes of photographs: cameras found, what they show kept, blended, and what it is worth.
class PhotographSampling : public test::Sampling {
 protected:
  // Returns the folder of a drawn room in twice the size that the shipped model makes.
  static std::filesystem::path large_room(const std::string& name, int64_t frames, int64_t number = 0) {
    SyntheticOptions synthetic;
    synthetic.seed = 910000;
    synthetic.first_scene = number;
    synthetic.frames = frames;
    synthetic.width = synthetic.height = 224;
    write_scene(make_synthetic_scene(synthetic, 0), "cameras-json", folder_->path() / name);
    return folder_->path() / name;
  }
};

TEST_F(PhotographSampling, PhotographsNeedNoCameras) {
  auto asked = with_shipped_model(options("photographs"));
  asked.scene.clear();
  asked.photos.files = {(folder_->path() / "scene" / "images").string()};
  asked.photos.cameras = PhotoCameraWay::kRays;
  asked.views.sources = {};
  asked.views.targets = {};
  asked.views.path.frames = 2;
  asked.outputs = {"image", "depth"};
  asked.named = {"views.frames"};  // as README's command does: a path is what photographs get
  EXPECT_NO_THROW(asked.check());
  const auto report = run(asked);
  EXPECT_EQ(report.at("scene").at("sources"), 6);
  EXPECT_EQ(report.at("scene").at("views").size(), 8U);
  EXPECT_EQ(report.at("photo_cameras").at("cameras").size(), 6U);
  EXPECT_TRUE(report.at("photo_cameras").contains("doubts"));
  EXPECT_THAT(printed_, HasSubstr("cameras estimated from the photographs:"));
  // They are of one size, so one lens took them.
  EXPECT_EQ(report.at("photo_cameras").at("shared_lenses").size(), 1U);
  EXPECT_THAT(printed_, HasSubstr("one lens took 6 of them"));
  // What was estimated is a scene that the same command takes.
  const Scene estimated = open_scene(std::filesystem::path(asked.out) / "photo_scene");
  ASSERT_EQ(estimated.frames.size(), 6U);
  EXPECT_EQ(estimated.frames[0].camera.world_from_camera.matrix(), Eigen::Matrix4d::Identity());
  EXPECT_EQ(estimated.frames[1].camera.intrinsics, estimated.frames[5].camera.intrinsics);
  EXPECT_EQ(estimated.frames[5].image().width, 112);
  EXPECT_EQ(estimated.frames[5].image().height, 112);
  asked.scene = (folder_->path() / "scene").string();
  EXPECT_EQ(
      test::error_of([&] { asked.check(); }),
      "--scene, --photos: expected one of the two, found both; leave out --photos where the scene has cameras.");
  asked.scene.clear();
  asked.photos.files = {(folder_->path() / "model").string()};
  asked.photos.cameras = PhotoCameraWay::kRays;
  asked.out = options("no_photographs").out;
  EXPECT_EQ(
      test::error_of([&] { sample(asked); }),
      asked.photos.files[0] +
          ": expected a photograph, or a folder of them, found none; put JPEG, HEIC, PNG, WebP or TIFF files there.");
  const std::filesystem::path trips = folder_->path() / "trips";
  for (const char* trip : {"lund", "berlin"}) {
    std::filesystem::create_directories(trips / trip);
    write_png(trips / trip / "first.png", Image(8, 8));
  }
  asked.photos.files = {trips.string()};
  EXPECT_EQ(
      test::error_of([&] { sample(asked); }),
      trips.string() +
          ": expected a photograph, or a folder of them, found 2 folders of photographs in it, and no photograph "
          "itself; give the photographs of one place, for example --photos " +
          (trips / "berlin").string() + ".");
}

// In whole multiples of what the models see, and so are the new views.
TEST_F(PhotographSampling, PhotographsWithoutCamerasAreKeptAtTheirOwnSize) {
  SyntheticOptions room;
  room.width = 250;
  room.height = 240;
  room.frames = 3;
  const Scene taken = make_synthetic_scene(room, 0);
  const auto folder = folder_->path() / "large_photographs";
  std::filesystem::create_directories(folder);
  for (const Frame& frame : taken.frames) write_png(folder / (frame.name + ".png"), frame.image());
  auto asked = with_shipped_model(options("large"));
  asked.scene.clear();
  asked.photos.files = {folder.string()};
  asked.photos.cameras = PhotoCameraWay::kRays;
  asked.views.sources = {};
  asked.views.targets = {};
  asked.views.path.frames = 1;
  asked.outputs = {"image"};
  for (const auto& [size, kept] : {std::pair("auto", 112), std::pair("photographs", 224)}) {
    asked.size = size;
    asked.overwrite = true;
    const auto report = run(asked);
    EXPECT_EQ(report.at("scene").at("width"), 112) << size;
    const std::filesystem::path out = asked.out;
    EXPECT_EQ(read_image(out / "images" / "view_03.png").width, kept) << size;
    EXPECT_EQ(read_image(out / "photo_scene" / "frame_00001.png").height, 224) << size;
  }
}

// Its axis meets no other, and its unit is the model's: only the predicted depth tells how far away things are.
TEST_F(PhotographSampling, OnePhotographIsOrbitedAtItsDepth) {
  auto asked = with_shipped_model(options("one_photograph"));
  asked.photos.files = {open_scene(asked.scene).frames.front().image_file.string()};
  asked.photos.cameras = PhotoCameraWay::kRays;
  asked.scene.clear();
  asked.views.sources = {};
  asked.views.targets = {};
  asked.views.path.frames = 2;
  asked.outputs = {"image"};
  const auto report = run(asked);
  // 20 degrees in the place of the usual 60, from one end to the other.
  const auto turned = [&] {
    const auto views = read_cameras_json(std::filesystem::path(asked.out) / "cameras.json").records;
    const auto axis = [&](size_t view) {
      return views.at(view).camera.world_from_camera.linear().col(2).eval();
    };
    return std::acos(axis(1).dot(axis(2))) * 180 / M_PI;
  };
  EXPECT_NEAR(turned(), kOrbitDegreesOfOnePhotograph, 1e-3);
  const double depth = report.at("photo_cameras").at("median_depth");
  EXPECT_GT(std::abs(std::log(depth)), 0.01);  // not the 1 that is assumed where nothing is known
  EXPECT_THAT(printed_,
              HasSubstr(fmt::format(", {:.4g} away: at the depth of what the source cameras see", depth)));
  asked.views.path.path = "orbit";
  asked.views.path.orbit_distance = 7;
  asked.views.path.orbit_degrees = 60;
  asked.overwrite = true;
  run(asked);
  EXPECT_NEAR(turned(), 60, 1e-3);
  EXPECT_THAT(printed_, HasSubstr(", 7 away: "));
}

// A photograph as a telephone writes it: its EXIF says the focal length, or nothing, or what was true before a crop.
TEST_F(PhotographSampling, EXIFSaysTheFocalLength) {
  SyntheticOptions room;
  room.width = room.height = 336;
  room.frames = 1;
  const Frame taken = make_synthetic_scene(room, 0).frames.front();
  const auto folder = folder_->path() / "taken";
  std::filesystem::create_directories(folder);
  const auto file = folder / "photograph.jpg";
  auto asked = with_shipped_model(options("telephone"));
  asked.photos.files = {file.string()};
  asked.scene.clear();
  asked.views.sources = {};
  asked.views.targets = {};
  asked.views.path.frames = 1;
  asked.outputs = {"image"};
  asked.overwrite = true;
  // Over the diagonal of 36x24 mm, in whole millimetres.
  const auto film_diagonal = std::hypot(36.0, 24.0), diagonal = std::hypot(336.0, 336.0);
  const auto truth =
      static_cast<uint16_t>(std::lround(taken.camera.intrinsics(0, 0) / diagonal * film_diagonal));
  for (const uint16_t millimetres : {truth, uint16_t{0}, static_cast<uint16_t>(truth / 3)}) {
    write_jpeg(file, taken.image(), 95);
    if (millimetres != 0) {
      test::ExifEntries exif;
      exif.focal_length_in_35mm_film = millimetres;
      test::add_exif(file, exif);
    }
    const auto report = run(asked);
    const auto camera = report.at("photo_cameras").at("cameras").at(0);
    const double seen = camera.at("seen_focal_length_pixels");
    const double by_exif = millimetres * diagonal / film_diagonal;
    const double used = millimetres != 0 ? by_exif : seen;
    EXPECT_EQ(camera.contains("exif_focal_length_pixels"), millimetres != 0);
    EXPECT_THAT(
        printed_,
        HasSubstr(millimetres != 0
                      ? fmt::format("(focal length {:.0f} px by EXIF; the model sees {:.0f} px)", used, seen)
                      : fmt::format("(the model sees a focal length of {:.0f} px; EXIF names none)", seen)));
    // What the model sees need not be square.
    const auto found = open_scene(std::filesystem::path(asked.out) / "photo_scene").frames.at(0).camera;
    EXPECT_NEAR(std::sqrt(found.intrinsics(0, 0) * found.intrinsics(1, 1)), used, 1e-6 * used);
    const std::string warning = fmt::format(
        "the cameras estimated from the photographs are not sure: by EXIF the focal length of photograph 0 is {:.2f} "
        "times what the model sees, as in pictures that were cropped (without EXIF the model's is taken)",
        used / seen);
    if (millimetres == truth / 3) {
      EXPECT_THAT(report.at("warnings").get<std::vector<std::string>>(), testing::Contains(warning));
    } else {
      EXPECT_THAT(report.at("warnings").dump(), Not(HasSubstr("by EXIF the focal length")));
    }
  }
}

// Its camera and its depth have one unit, the model's, so that it is carried: what it shows is kept and not generated.
TEST_F(PhotographSampling, OnePhotographIsKeptInItsOrbit) {
  auto asked = with_shipped_model(options("kept_photograph"));
  asked.photos.files = {open_scene(asked.scene).frames.front().image_file.string()};
  asked.photos.cameras = PhotoCameraWay::kRays;
  asked.scene.clear();
  asked.views.sources = {};
  asked.views.targets = {};
  asked.views.path.path = "orbit";
  asked.views.path.orbit_degrees = 10;
  asked.views.path.frames = 3;
  asked.outputs = {"image", "depth"};
  const auto report = run(asked);
  EXPECT_THAT(printed_, Not(HasSubstr("nothing is carried")));
  EXPECT_THAT(report.at("verdict").at("sentence"),
              HasSubstr("% of the target views come from that photograph"));
  const std::filesystem::path out = asked.out;
  const auto error = [&](const char* view) {
    const Image taken = open_scene(out / "photo_scene").frames.at(0).image();
    const Image made = read_image(out / "images" / view);
    double sum = 0;
    for (size_t i = 0; i < taken.rgb.size(); ++i) sum += std::abs(int{taken.rgb[i]} - int{made.rgb[i]});
    return sum / (255 * static_cast<double>(taken.rgb.size()));
  };
  // The middle of the orbit is where the photograph was taken; 5 degrees aside it has moved, and is no other place.
  EXPECT_LT(error("view_02.png"), 0.01);
  EXPECT_GT(error("view_01.png"), 0.01);
  EXPECT_LT(error("view_01.png"), 0.15);
  // The scene has the model's unit, as far as the depth of four views together is that of one.
  EXPECT_NEAR(report.at("depth_scale").at("scale").get<double>(), 1, 0.3);
}

// Rooms that are drawn are in metres, and so is the unit that the shipped model guesses: a single source is carried by
// it. Of a scene in another unit nothing is known.
TEST_F(PhotographSampling, OneSourceIsCarriedInAGuessedUnit) {
  auto asked = with_shipped_model(options("one_source"));
  asked.views.sources = {0};
  asked.views.targets = {1};
  asked.outputs = {"image"};
  const auto kept = [](const nlohmann::json& report) {
    return report.at("verdict").at("sentence").get<std::string>().find("come from that photograph") !=
           std::string::npos;
  };
  EXPECT_TRUE(kept(run(asked)));
  EXPECT_THAT(printed_, HasSubstr("the geometry head's, in a unit that the model guesses"));
  const auto cameras = std::filesystem::path(asked.scene) / "cameras.json";
  auto text = read_file(cameras);
  const auto at = text.find("\"metres\"");
  ASSERT_NE(at, std::string::npos);
  const std::string metric = text;
  write_file_atomically(cameras, text.replace(at, 8, "\"scene\""));
  asked.overwrite = true;
  const auto in_another_unit = run(asked);
  write_file_atomically(cameras, metric);
  EXPECT_FALSE(kept(in_another_unit));
  EXPECT_THAT(printed_, HasSubstr("nothing is carried into the target views: one source has no scale"));
}

// It does so beside models that were trained without photographs in target views, whose pictures stay as they are.
TEST_F(PhotographSampling, SaysWhatItIsWorth) {
  auto asked = options("worth");
  asked.views.sources = {0, 2, 4};
  asked.views.targets = {1};
  asked.outputs = {"image"};
  const auto report = run(asked);
  const std::string sentence = report.at("verdict").at("sentence");
  EXPECT_EQ(printed_.find(sentence), printed_.rfind(sentence));  // once
  EXPECT_THAT(printed_, HasSubstr(sentence + "\neach of 3 photographs predicted from the others: "));
  ASSERT_EQ(report.at("leave_one_out").size(), 3U);
  for (const auto& one : report.at("leave_one_out")) {
    EXPECT_EQ(one.at("from").size(), 2U);
    EXPECT_GT(one.at("psnr").get<double>(), 5);
    EXPECT_LE(one.at("covered").get<double>(), 1);
  }
  EXPECT_EQ(report.at("verdict").at("latent_divergence").size(), 2U);
  EXPECT_FALSE(report.at("verdict").contains("usual_latent_divergence"));  // this bundle does not say it
}

// The shipped model keeps photographs; its target is a part of what the second source shows.
TEST_F(PhotographSampling, WhatPhotographsShowWholeIsNotGenerated) {
  const auto scene = large_room("video", 24, 19);
  auto asked = with_shipped_model(options("whole"));
  asked.scene = scene.string();
  asked.views.sources = {2, 4, 6};
  asked.outputs = {"image"};
  asked.size = kPhotographSize;
  asked.solver.evaluations = 2;
  const auto path = folder_->path() / "path.json";
  CameraList list;
  const auto frames = open_scene(scene).frames;
  const std::vector<double> zooms{2.0, 0.5, 0.52, 0.54, 0.56, 0.58};
  for (size_t i = 0; i < zooms.size(); ++i) {
    const double zoom = zooms[i];
    CameraRecord record;
    record.name = i == 0 ? "near" : fmt::format("wide_{}", i);
    record.camera = frames[4].camera;
    record.camera.intrinsics(0, 0) *= zoom;
    record.camera.intrinsics(1, 1) *= zoom;
    list.records.push_back(record);
  }
  write_cameras_json(path, list);
  asked.views.targets.clear();
  asked.views.path.path = path.string();
  const auto report = run(asked);
  ASSERT_EQ(report.at("photographs").at("carried_only").size(), 1U) << report.at("photographs").dump();
  EXPECT_THAT(printed_, HasSubstr("that saved "));
  const std::string more_views = "The model was trained on scenes of 4 views, this one has 9.";
  EXPECT_THAT(report.at("warnings").dump(), HasSubstr(more_views));
  // Pictures have the photographs' size, and cameras.json describes them.
  const Scene made = open_scene(asked.out);
  for (const Frame& frame : made.frames) EXPECT_EQ(frame.camera.width, 224);
  EXPECT_EQ(read_image(std::filesystem::path(asked.out) / "images" / "view_04.png").width, 224);

  auto all = asked;
  all.out = (folder_->path() / "whole_generated").string();
  all.photograph_use.generate_complete = true;
  EXPECT_EQ(run(all).at("photographs").at("carried_only").size(), 0U);

  // Nothing is generated, so that it does not matter what the model was trained on.
  for (size_t i = 1; i < list.records.size(); ++i) {
    list.records[i] = list.records[0];
    list.records[i].name = fmt::format("near_{}", i);
  }
  write_cameras_json(path, list);
  auto carried = asked;
  carried.out = (folder_->path() / "whole_carried").string();
  const auto of_photographs = run(carried);
  EXPECT_EQ(of_photographs.at("photographs").at("carried_only").size(), zooms.size());
  EXPECT_THAT(of_photographs.at("warnings").dump(), testing::Not(HasSubstr(more_views)));
}

// At the model's size a picture may look better than it is: what is written is compared as it is written.
TEST_F(PhotographSampling, PicturesOfThePhotographsSizeAreComparedInThatSize) {
  const auto folder = large_room("large_scene", 4);
  auto asked = with_shipped_model(options("large_run"));
  asked.scene = folder.string();
  asked.views.sources = {0, 3};
  asked.views.targets = {1, 2};
  asked.outputs = {"image"};
  asked.solver.evaluations = 2;
  asked.size = kPhotographSize;
  const auto report = run(asked);
  const auto frames = open_scene(folder).frames;
  const auto psnr_of = [](const Image& truth, const Image& picture) {
    return measure_images(metric_named("psnr"), to_tensor(truth).unsqueeze(0),
                          to_tensor(picture).unsqueeze(0))
        .mean();
  };
  for (const size_t target : {1, 2}) {
    const auto& row = report.at("against_truth").at(target - 1);
    const auto& large = row.at("large");
    EXPECT_EQ(large.at("width"), 224);
    EXPECT_EQ(large.at("height"), 224);
    const Image truth = frames[target].image();
    const auto name = fmt::format("view_{:02}.png", target + 1);
    const Image written = read_image(std::filesystem::path(asked.out) / "images" / name);
    EXPECT_NEAR(large.at("psnr").get<double>(), psnr_of(truth, written), 1e-3);
    const Image nearest = frames[target == 1 ? 0 : 3].image();
    EXPECT_NEAR(large.at("psnr_nearest_source").get<double>(), psnr_of(truth, nearest), 1e-3);
    EXPECT_GT(large.at("psnr").get<double>(), large.at("psnr_nearest_source").get<double>());
    EXPECT_GT(row.at("psnr").get<double>(), row.at("psnr_nearest_source").get<double>());
    EXPECT_NE(row.at("psnr"), large.at("psnr"));
    for (const char* metric : {"psnr_seen", "ssim", "sharpness"})
      EXPECT_TRUE(large.contains(metric)) << metric;
  }
  asked.size = "auto";
  asked.out = (folder_->path() / "small_run").string();
  EXPECT_FALSE(run(asked).at("against_truth").at(0).contains("large"));
}

TEST_F(PhotographSampling, PhotographsAreBlendedByTheModelOrByRule) {
  auto blended = with_shipped_model(options("blended"));
  blended.outputs = {"image"};
  blended.solver.evaluations = 2;
  auto by_rule = blended;
  by_rule.out = (folder_->path() / "by_rule").string();
  by_rule.photograph_use.compose = PhotographOptions::ComposeChoice::kPhotographs;
  const auto first = run(blended), second = run(by_rule);
  const auto reason = [](const nlohmann::json& report) {
    for (const auto& stage : report.at("plan")) {
      if (stage.at("stage") == "composition") return stage.at("reason").get<std::string>();
    }
    return std::string();
  };
  EXPECT_THAT(reason(first), HasSubstr("blended by the model"));
  EXPECT_THAT(reason(second), Not(HasSubstr("blended by the model")));
  // About as much of the pictures is kept; its colours are others.
  const auto kept = [](const nlohmann::json& report) {
    return report.at("photographs").at("kept").at(0).at("share").get<double>();
  };
  EXPECT_GT(kept(first), 0.1);
  EXPECT_NEAR(kept(first), kept(second), 0.2);
  const auto picture = [](const SampleOptions& of) {
    return read_image(std::filesystem::path(of.out) / "images" / "view_02.png").rgb;
  };
  EXPECT_NE(picture(blended), picture(by_rule));
  // What photographs show and what they do not, apart.
  for (const auto& view : first.at("against_truth")) {
    const double seen = view.at("psnr_seen"), unseen = view.at("psnr_unseen"), all = view.at("psnr");
    EXPECT_GT(seen, unseen + 1);
    EXPECT_TRUE(unseen < all && all < seen) << unseen << ' ' << all << ' ' << seen;
  }
}

TEST_F(PhotographSampling, DepthIsMendedByTheModelOrAsPhotographsAndHeadSayIt) {
  auto mended = with_shipped_model(options("mended"));
  mended.outputs = {"image"};
  mended.solver.evaluations = 2;
  auto fused = mended;
  fused.out = (folder_->path() / "fused").string();
  fused.photograph_use.source_depth = PhotographOptions::DepthChoice::kFused;
  const auto first = run(mended), second = run(fused);
  const auto reason = [](const nlohmann::json& report) {
    for (const auto& stage : report.at("plan")) {
      if (stage.at("stage") == "source depth") return stage.at("reason").get<std::string>();
    }
    return std::string();
  };
  EXPECT_THAT(reason(first), HasSubstr("mended by a network"));
  EXPECT_THAT(reason(second), Not(HasSubstr("mended by a network")));
  const auto picture = [](const SampleOptions& of) {
    return read_image(std::filesystem::path(of.out) / "images" / "view_02.png").rgb;
  };
  EXPECT_NE(picture(mended), picture(fused));
}

// The truth tells: what is carried by depth that is off lands beside where it belongs.
TEST_F(PhotographSampling, DepthThatIsOffCarriesPhotographsElsewhere) {
  auto asked = with_shipped_model(options("depth_as_it_is"));
  asked.outputs = {"image"};
  asked.solver.evaluations = 2;
  auto off = asked;
  off.out = (folder_->path() / "depth_off").string();
  off.photograph_use.depth_error = 0.3;
  const auto psnr = [](const nlohmann::json& report) {
    return report.at("against_truth").at(0).at("psnr").get<double>();
  };
  EXPECT_GT(psnr(run(asked)), psnr(run(off)) + 1);
}

}  // namespace
}  // namespace gld
