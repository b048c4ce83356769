// What gld sample refuses, and what it says.
#include "datasets/formats/cameras_json.h"
#include "datasets/formats/scene_reader.h"
#include "datasets/formats/scene_writer.h"
#include "datasets/images/image_file.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/base/json_text.h"
#include "gld/tensors/torch_version.h"
#include "gld/tensors/weight_tensors.h"
#include "infer/export/ply_file.h"
#include "infer/forecast/doctor.h"
#include "infer/forecast/machine_rates.h"
#include "infer/sample/unfinished_latents.h"
#include "models/bundle/random_bundle.h"
#include "models/bundle/trained_views.h"
#include "tests/infer/sample/sampling_fixture.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/exported_files.h"
#include "tests/support/refining_bundle.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <utility>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

namespace gld {
namespace {

class SamplingRequests : public test::Sampling {};
using testing::HasSubstr;

TEST_F(SamplingRequests, APointOfTwoNumbersIsRefused) {
  auto asked = options("two_numbers");
  asked.views.targets = {};
  asked.views.path.path = "orbit";
  asked.views.path.orbit_center = {1, 2};
  EXPECT_EQ(test::error_of([&] { check_options(asked, "gld sample"); }),
            "--orbit-center: expected three numbers, x,y,z in the scene, found 2; "
            "write for example --orbit-center 0,0,2.5.");
  asked.views.path.orbit_center = {1, 2, 3};
  asked.views.path.orbit_distance = 2;
  EXPECT_EQ(test::error_of([&] { check_options(asked, "gld sample"); }),
            "--orbit-center, --orbit-distance: expected one of the two, found both; leave out the distance, "
            "which is only for finding the centre.");
}

TEST_F(SamplingRequests, OptionsOfAnOrbitNeedOne) {
  auto asked = options("no_orbit");
  asked.views.targets = {};
  for (const char* key : {"center", "radius", "distance", "degrees"}) {
    asked.named = {"views.path", std::string("views.orbit_") + key};
    for (const char* path : {"spline", "path.json"}) {
      asked.views.path.path = path;
      EXPECT_EQ(test::error_of([&] { asked.check(); }),
                fmt::format("--orbit-{}: expected --path orbit, which it is an option of, found --path {}; "
                            "leave out one of the two.",
                            key, path));
    }
    asked.views.path.path = "orbit";
    EXPECT_NO_THROW(asked.check());
  }
  asked.named = {"views.orbit_radius"};
  asked.views.path.path = "";
  asked.views.targets = {1};
  EXPECT_THAT(test::error_of([&] { asked.check(); }),
              testing::StartsWith("--orbit-radius: expected --path, "));
  // What lies between several photographs is a spline.
  asked.views.targets = {};
  asked.views.sources = {};
  asked.scene.clear();
  asked.photos.files = {(folder_->path() / "scene" / "images").string()};
  asked.photos.cameras = PhotoCameraWay::kRays;
  EXPECT_NO_THROW(asked.check());
  EXPECT_EQ(test::error_of([&] { sample(asked); }),
            "--orbit-radius: expected --path orbit, which it is an option of, found --path spline; leave out "
            "one of the two.");
}

TEST_F(SamplingRequests, PhotographsNeedAModelThatSeesGeometry) {
  auto asked = options("blind");
  asked.scene.clear();
  asked.photos.files = {(folder_->path() / "scene" / "images").string()};
  asked.photos.cameras = PhotoCameraWay::kRays;
  asked.views.sources = {};
  asked.views.targets = {};
  asked.outputs = {"image"};
  BundleOptions blind = small_bundle_options();
  blind.geometry_head = GeometryHeadOptions::none();
  asked.model = (folder_->path() / "blind_model").string();
  write_random_bundle(asked.model, blind, 7);
  EXPECT_EQ(test::error_of([&] { sample(asked); }),
            "--photos: expected a model with a geometry head, which sees the cameras, found " + asked.model +
                "; add --geometry-model DIR with one that has, or let COLMAP find the cameras.");
  // The geometry model then sees the photographs as well as the generated images.
  asked.geometry_model = (test::source_root() / "configs" / "tiny").string();
  asked.photos.lens = PhotoLens::kOwn;
  asked.views.path.frames = 2;
  const auto report = run(asked);
  EXPECT_EQ(report.at("photo_cameras").at("cameras").size(), 6U);
  EXPECT_TRUE(report.at("photo_cameras").at("shared_lenses").empty());
  asked = options("no_photos");
  asked.named = {"photo_lens"};
  EXPECT_EQ(
      test::error_of([&] { asked.check(); }),
      "--photo-lens: expected --photos, which it is an option of, found --scene; leave out one of the two.");
}

// VGGT's camera head is a part that a bundle may lack; nothing is computed before that is said.
TEST_F(SamplingRequests, WhatNeedsAMissingCameraHeadIsRefusedFirst) {
  BundleOptions blind;
  load_yaml(blind, test::source_root() / "configs/ablations/latents/vggt/model.yaml");
  apply_setting(blind, "dpt_head.camera_head=false");
  auto asked = options("no_camera_head");
  asked.model = (folder_->path() / "no_camera_head_model").string();
  asked.size = "112x112";
  save_bundle_options(asked.model, blind);  // without weights, which would be missed next
  const std::string found = asked.model + ", whose VGGT heads have none for cameras; ";
  const auto refusal = [&] { return test::error_of([&] { sample(asked); }); };
  for (const char* output : {"depth", "rays", "points"}) {
    asked.outputs = {output};
    EXPECT_EQ(refusal(),
              "--outputs: expected image or latents of a model without a camera head, found depth, rays or "
              "points of " +
                  found + "add --outputs image, or --geometry-model DIR with a model that sees cameras.");
  }
  asked.outputs = {"points"};
  asked.points.lifting = PointLifting::kPointMaps;
  EXPECT_THAT(refusal(), testing::StartsWith("--outputs: "));
  asked.geometry_model = asked.model;
  EXPECT_THAT(refusal(), testing::StartsWith("--geometry-model: "));
  asked.geometry_model.clear();
  asked.outputs = {"image"};
  EXPECT_THAT(refusal(), HasSubstr("expected a file "));  // which it could do with weights
  asked.scene.clear();
  asked.photos.files = {(folder_->path() / "scene" / "images").string()};
  asked.photos.cameras = PhotoCameraWay::kRays;
  EXPECT_EQ(refusal(), "--photos: expected a model that sees cameras, found " + found +
                           "add --geometry-model DIR with one that has, or let COLMAP find the cameras.");
}

// The geometry model may be told the cameras of the pictures that it looks at, where it has an encoder for them.
TEST_F(SamplingRequests, TheGeometryModelIsToldTheGivenCameras) {
  BundleOptions seeing = small_bundle_options();
  auto asked = options("told");
  asked.geometry_model = (folder_->path() / "seeing_model").string();
  asked.geometry_cameras = GeometryCameras::kGiven;
  asked.outputs = {"image", "depth"};
  write_random_bundle(asked.geometry_model, seeing, 9);
  EXPECT_EQ(
      test::error_of([&] { sample(asked); }),
      "--geometry-cameras given: expected a --geometry-model whose backbone has an encoder for cameras, found " +
          asked.geometry_model +
          ", whose backbone of kind da3 has none; leave the option out, or convert DA3's published file, "
          "which holds one, into a new folder.");
  std::filesystem::remove_all(asked.geometry_model);
  apply_setting(seeing, "backbone.camera_encoder_depth=2");
  apply_setting(seeing, "backbone.camera_encoder_heads=4");
  write_random_bundle(asked.geometry_model, seeing, 9);
  const auto files = [&](const std::string& out, GeometryCameras cameras) {
    asked.out = (folder_->path() / out).string();
    asked.geometry_cameras = cameras;
    EXPECT_EQ(run(asked).at("geometry").contains("cameras"), cameras == GeometryCameras::kGiven);
    return std::pair(test::read_pfm(std::filesystem::path(asked.out) / "depth" / "view_02.pfm").metres,
                     read_file(std::filesystem::path(asked.out) / "rays" / "view_02.npz"));
  };
  asked.outputs = {"image", "depth", "rays"};
  const auto told = files("told", GeometryCameras::kGiven), again = files("again", GeometryCameras::kGiven),
             found = files("found", GeometryCameras::kFound);
  EXPECT_EQ(told.first, again.first);
  EXPECT_NE(told.first, found.first);
  EXPECT_NE(told.second, found.second);
}

// A model whose file was damaged, or whose training diverged, must not give depth of 0 and exit status 0.
TEST_F(SamplingRequests, NumbersThatAreNotFiniteInTheGeometryHeadAreNamed) {
  const auto model = folder_->path() / "broken_head";
  std::filesystem::copy(folder_->path() / "model", model, std::filesystem::copy_options::recursive);
  const auto file = model / "dpt_head.safetensors";
  const auto whole = read_all(file);
  auto asked = options("broken");
  asked.model = model.string();
  asked.overwrite = true;
  int biases = 0, named = 0;
  for (const auto& [name, tensor] : whole) {
    if (name.find("bias") == std::string::npos || ++biases % 15 != 0) continue;
    auto broken = whole;
    broken[name] = tensor.clone();
    broken[name].view({-1})[0] = std::numeric_limits<float>::quiet_NaN();
    save_safetensors(file, broken);
    for (const char* output : {"depth", "points"}) {
      asked.outputs = {output};
      testing::internal::CaptureStdout();
      testing::internal::CaptureStderr();
      std::string error;
      try {
        sample(asked);
      } catch (const Error& thrown) {
        error = thrown.what();
      }
      testing::internal::GetCapturedStdout();
      testing::internal::GetCapturedStderr();
      // Not every number takes part in these outputs; one that does may not give depth that looks known.
      if (error.empty()) {
        const auto report =
            nlohmann::json::parse(read_file(std::filesystem::path(asked.out) / "report.json"));
        if (std::string(output) == "points") {
          EXPECT_EQ(report.at("points").at("unknown_depth"), 0) << name;
          continue;
        }
        const auto depth = test::read_pfm(std::filesystem::path(asked.out) / "depth" / "view_02.pfm");
        for (const float value : depth.metres) ASSERT_TRUE(std::isfinite(value) && value > 0) << name;
        continue;
      }
      ++named;
      EXPECT_THAT(error,
                  testing::MatchesRegex("geometry: expected finite numbers, found [0-9]+ of [0-9]+ values of "
                                        "the predicted [a-z ]+ that are not; check the geometry head's "
                                        "weights with gld inspect and gld verify\\."))
          << name;
    }
  }
  EXPECT_GE(biases, 15);
  EXPECT_GE(named, 3);
}

// Units of a scene are free, up to what a camera's place may be.
TEST_F(SamplingRequests, SceneScalesGiveDepthOrOneSentence) {
  const Scene scene = open_scene(folder_->path() / "scene");
  for (const double scale : {1e-9, 1e10, 1e14, 1e150}) {
    Scene scaled = scene;
    for (Frame& frame : scaled.frames) frame.camera.world_from_camera.translation() *= scale;
    const auto folder = folder_->path() / fmt::format("scale_{:g}", scale);
    if (scale > 1e12) {
      EXPECT_THAT(test::error_of([&] { write_scene(scaled, "cameras-json", folder); }),
                  HasSubstr("units of the origin"))
          << scale;
      continue;
    }
    write_scene(scaled, "cameras-json", folder);
    auto asked = with_shipped_model(options(fmt::format("scaled_{:g}", scale)));
    asked.scene = folder.string();
    asked.outputs = {"depth"};
    const auto report = run(asked);
    const auto depth = test::read_pfm(std::filesystem::path(asked.out) / "depth" / "view_02.pfm");
    for (const float value : depth.metres) ASSERT_TRUE(std::isfinite(value) && value > 0) << scale;
    if (!report.contains("depth_scale")) {
      EXPECT_THAT(report.at("warnings").dump(), HasSubstr("scale of the predicted depth is not known"))
          << scale;
    }
  }
}

TEST_F(SamplingRequests, WrongRequestsGetOneSentence) {
  const auto sentence = [&](const std::function<void(SampleOptions&)>& change) {
    SampleOptions asked = options("refused");
    change(asked);
    return test::error_of([&] {
      asked.check();
      asked.views.check();
      sample(asked);
    });
  };
  EXPECT_EQ(sentence([](SampleOptions& asked) { asked.views.targets = {9}; }),
            "--targets: expected frame numbers from 0 to 5, which is what scene 'scene' has, found 9; "
            "choose among its frames.");
  EXPECT_EQ(sentence([](SampleOptions& asked) { asked.views.sources.clear(); }),
            "--sources: expected at least one source view, found none; add for example --sources 0,3.");
  EXPECT_EQ(sentence([](SampleOptions& asked) {
              asked.views.sources = {1, 1};
            }),
            "--sources: expected each source view once, found frame 1 twice; remove the repetition.");
  EXPECT_EQ(sentence([](SampleOptions& asked) { asked.views.path.path = "orbit"; }),
            "--targets, --path: expected either target frames or a path, found both; "
            "add for example --targets 1,2, or --path orbit.");
  EXPECT_EQ(
      sentence([](SampleOptions& asked) {
        asked.device = "cuda:1";
        asked.memory_limit = 4;
      }),
      "--memory-limit: expected --device cpu, of whose memory it is, found cuda:1; leave one of the two out.");
  EXPECT_EQ(sentence([](SampleOptions& asked) { asked.size = "100x56"; }),
            "--size: expected sides that are multiples of the patch size 14, found 100x56; take 98x56.");
  EXPECT_EQ(
      sentence([](SampleOptions& asked) { asked.size = "big"; }),
      "--size: expected WIDTHxHEIGHT in pixels, sides from 1 to 65536, found 'big'; write for example 504x280.");
  EXPECT_EQ(
      sentence([](SampleOptions& asked) { asked.outputs = {"imagse"}; }),
      "--outputs: expected image, depth, rays, points, latents, splats or page, found 'imagse'; did you mean 'image'?");
  EXPECT_EQ(sentence([](SampleOptions& asked) { asked.device = "tpu"; }),
            "--device: expected cpu, cuda or cuda:N, found 'tpu'; write for example --device cpu.");
  EXPECT_EQ(
      sentence([](SampleOptions& asked) { asked.scene.clear(); }),
      "--scene: expected a folder of images with cameras, found nothing; add for example --scene my_photos, "
      "or --photos my_photos where there are no cameras.");
  EXPECT_EQ(sentence([](SampleOptions& asked) { asked.out.clear(); }),
            "--out: expected a folder to write into, found nothing; add for example --out runs/sample.");
  EXPECT_FALSE(std::filesystem::exists(folder_->path() / "refused"));
}

TEST_F(SamplingRequests, ARunFolderIsWrittenOnceUnlessItIsAskedFor) {
  auto asked = options("twice");
  asked.outputs = {"image", "latents"};
  run(asked);
  const std::filesystem::path out = asked.out;
  EXPECT_THAT(test::error_of([&] { sample(asked); }),
              HasSubstr("found an earlier run of gld sample; choose another --out, or add --overwrite"));
  write_file_atomically(out / "images" / "mine.png", "mine");
  asked.overwrite = true;
  asked.outputs = {"image"};
  run(asked);
  EXPECT_FALSE(std::filesystem::exists(out / "latents.safetensors"));
  EXPECT_TRUE(std::filesystem::exists(out / "images" / "mine.png"));
  EXPECT_TRUE(std::filesystem::exists(out / "images" / "view_02.png"));
}

// A wrong request says so before anything is removed.
TEST_F(SamplingRequests, AMistakeLeavesTheEarlierRunAsItWas) {
  auto asked = options("kept_run");
  asked.outputs = {"image"};
  run(asked);
  asked.overwrite = true;
  asked.views.targets = {9};
  EXPECT_THROW(sample(asked), Error);
  EXPECT_TRUE(std::filesystem::exists(std::filesystem::path(asked.out) / "images" / "view_02.png"));
}

TEST_F(SamplingRequests, AMissingPartIsNamedFirst) {
  const auto model = folder_->path() / "without_head";
  std::filesystem::copy(folder_->path() / "model", model);
  std::filesystem::remove(model / "dpt_head.safetensors");
  auto asked = options("missing_part");
  asked.model = model.string();
  EXPECT_EQ(
      test::error_of([&] { sample(asked); }),
      model.string() +
          ": expected a file dpt_head.safetensors, found none; add the part with gld convert or gld train.");
  EXPECT_FALSE(std::filesystem::exists(asked.out));
  asked.outputs = {"image"};  // which needs none
  run(asked);
}

TEST_F(SamplingRequests, SamplesAreRefinedByModelsThatCan) {
  auto asked = options("refined");
  asked.refine = true;
  EXPECT_EQ(test::error_of([&] { sample(asked); }),
            "--refine: expected a model with a refiner of samples, found none in " +
                small_bundle_options().name +
                "; train one with gld train sample-refiner, or leave --refine out.");
  EXPECT_FALSE(std::filesystem::exists(asked.out));
  write_random_bundle(folder_->path() / "refining", test::small_refining_bundle_options(), 7);
  asked.model = (folder_->path() / "refining").string();
  const auto report = run(asked);
  EXPECT_THAT(stage_names(report), testing::Contains("sample refinement"));
  EXPECT_EQ(report.at("refined_views"), 2);
  EXPECT_THAT(printed_, testing::HasSubstr("; refined"));
  auto quality = asked;
  quality.quality = SamplingQuality::kFast;
  quality.solver = SampleOptions().solver;
  EXPECT_THAT(test::error_of([&] { quality.check(); }), testing::HasSubstr("'refine'"));
  std::filesystem::remove(folder_->path() / "refining/refiner.safetensors");
  asked.overwrite = true;
  EXPECT_THAT(test::error_of([&] { sample(asked); }), testing::HasSubstr("refiner"));
}

TEST_F(SamplingRequests, FramesAreChosenByNumberOrName) {
  const auto frames = open_scene(folder_->path() / "scene").frames;
  auto numbers = options("by_number"), names = options("by_name");
  numbers.outputs = names.outputs = {"image"};
  names.views.sources = {FrameChoice(frames[0].name), FrameChoice(3)};
  names.views.targets = {FrameChoice(frames[1].name), FrameChoice(frames[2].name)};
  EXPECT_EQ(run(names).at("scene"), run(numbers).at("scene"));
  names.views.targets = {FrameChoice(frames[0].name)};
  EXPECT_THAT(test::error_of([&] { sampling_plan_report(names, PlanTiming::kPredicted); }),
              HasSubstr("--targets: expected frames that are not sources"));
  names.views.targets = {FrameChoice("nobody")};
  EXPECT_THAT(test::error_of([&] { sampling_plan_report(names, PlanTiming::kPredicted); }),
              HasSubstr("--targets: expected frames of scene 'scene', found 'nobody', which is none"));
}

TEST_F(SamplingRequests, AScenesNameIsPrintedHarmless) {
  const auto scene = folder_->path() / "red\x1b[31m\nroom";
  std::filesystem::copy(folder_->path() / "scene", scene, std::filesystem::copy_options::recursive);
  auto asked = options("harmless");
  asked.scene = scene.string();
  asked.outputs = {"latents"};
  run(asked);
  EXPECT_EQ(printed_.find('\x1b'), std::string::npos);
  EXPECT_THAT(printed_, HasSubstr("scene red\\x1b[31m\\nroom: 2 source"));
}

TEST_F(SamplingRequests, WhatWouldHaveNoEffectIsRefused) {
  const auto sentence = [&](const std::function<void(SampleOptions&)>& change) {
    SampleOptions asked = options("refused");
    change(asked);
    return test::error_of([&] { check_options(asked, "gld sample"); });
  };
  // Each is asked for alone, with the defaults and images only.
  for (const char* key :
       {"solver.schedule_file", "solver.shift", "solver.last_time", "solver.tolerance",
        "solver.max_evaluations", "solver.diffusion", "solver.diffusion_strength", "solver.noise_seed",
        "points.max_points", "points.lifting", "scale_from", "geometry_model", "geometry_cameras"}) {
    EXPECT_THAT(sentence([&](SampleOptions& asked) {
                  asked.outputs = {"image"};
                  asked.named = {key};
                }),
                HasSubstr(", without which nothing looks at it, found none; add it, or leave --"))
        << key;
  }
  EXPECT_EQ(
      sentence([](SampleOptions& asked) {
        asked.guidance.guidance_scale = 1;
        asked.named = {"guidance.guidance_interval"};
      }),
      "--guidance-interval: expected a --guidance-scale other than 1, without which nothing looks at it, found "
      "none; add it, or leave --guidance-interval out.");
  SampleOptions looked_at = options("refused");
  looked_at.named = {"points.max_points", "scale_from", "guidance.guidance_interval", "solver.first_time"};
  EXPECT_NO_THROW(check_options(looked_at, "gld sample"));
  EXPECT_EQ(
      sentence([](SampleOptions& asked) {
        asked.named = {"views.targets", "views.frames"};
      }),
      "--frames: expected --path, which it is an option of, found --targets; leave out one of the two.");
  // By the name of its flag, where --tolerance is another option.
  EXPECT_EQ(
      sentence([](SampleOptions& asked) { asked.named = {"solver.tolerance"}; }),
      "--solver.tolerance: expected an adaptive --solver, without which nothing looks at it, found none; add it, "
      "or leave --solver.tolerance out.");
  EXPECT_THAT(
      sentence([](SampleOptions& asked) {
        asked.solver.solver = SolverKind::kDormandPrince;
        asked.named = {"solver.evaluations"};
      }),
      testing::StartsWith("--evaluations: expected a --solver of fixed steps, without which nothing looks"));
  EXPECT_EQ(sentence([](SampleOptions& asked) {
              asked.outputs = {"image", "image"};
            }),
            "--outputs: expected every output once, found 'image' twice; leave out one of the two.");
  EXPECT_EQ(
      sentence([](SampleOptions& asked) { asked.outputs = {"page"}; }),
      "--outputs: expected beside page an output that it can show, found none; add for example --outputs image,page.");
  EXPECT_EQ(sentence([](SampleOptions& asked) {
              asked.views.targets = {1, 1};
            }),
            "--targets: expected each target view once, found frame 1 twice; remove the repetition.");
  EXPECT_EQ(sentence([](SampleOptions& asked) { asked.views.targets = {3}; }),
            "--targets: expected frames that are not sources, found frame 3, which is a source; leave it out "
            "of one of the two.");
  EXPECT_EQ(sentence([](SampleOptions& asked) { asked.resume = asked.overwrite = true; }),
            "--resume, --overwrite: expected one of the two, found both; --resume goes on with the run, "
            "--overwrite removes it.");
}

}  // namespace
}  // namespace gld
