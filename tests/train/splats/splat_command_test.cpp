#include "train/splats/splat_command.h"

#include "datasets/formats/cameras_json.h"
#include "datasets/formats/scene_reader.h"
#include "datasets/formats/scene_writer.h"
#include "datasets/images/image_file.h"
#include "datasets/splats/matched_start.h"
#include "datasets/splats/splat_picture.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "gld/base/interrupt.h"
#include "gld/cameras/resized_camera.h"
#include "gld/splatting/splat_ply.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "train/splats/splat_checkpoint.h"

#include <algorithm>
#include <chrono>
#include <csignal>
#include <filesystem>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

namespace gld {
namespace {

using test::error_of;
using test::TemporaryFolder;

SyntheticOptions small_rooms() {
  SyntheticOptions options;
  options.scene_count = 1;
  options.frames = 10;
  options.width = options.height = 64;
  return options;
}

SplatCommandOptions quick(const std::filesystem::path& scene, const std::filesystem::path& out) {
  SplatCommandOptions options;
  options.scene = scene.string();
  options.out = out.string();
  options.held_out = 2;
  options.fit.steps = 60;
  options.fit.density.most_gaussians = 6000;
  options.threads = 2;
  return options;
}

nlohmann::json report_of(const std::filesystem::path& run) {
  return nlohmann::json::parse(read_file(run / "report.json"));
}

class FittedSplats : public testing::Test {
 protected:
  void SetUp() override { write_scene(make_synthetic_scene(small_rooms(), 0), "cameras-json", scene()); }
  std::filesystem::path scene() const { return folder_.path() / "scene"; }
  std::filesystem::path out(const std::string& name = "run") const { return folder_.path() / name; }

 private:
  TemporaryFolder folder_;
};

TEST_F(FittedSplats, OfADrawnRoomImproves) {
  SplatCommandOptions options = quick(scene(), out("start"));
  options.fit.steps = 0;
  run_splat_fit(options);
  const auto start = report_of(out("start"));
  options.fit.steps = 120;
  options.out = out("fit").string();
  run_splat_fit(options);
  const auto fit = report_of(out("fit"));
  EXPECT_EQ(fit["views"]["fitted"], 8);
  EXPECT_EQ(fit["views"]["held_out"], 2);
  // Measured depth alone shows the room; fitting makes it sharp. What comes out is known only by trying: 19 and 24 dB.
  EXPECT_GT(start["held_out_psnr"].get<double>(), 12);
  EXPECT_GT(fit["held_out_psnr"].get<double>(), start["held_out_psnr"].get<double>() + 2);
  EXPECT_GT(fit["fitted_psnr"].get<double>(), fit["held_out_psnr"].get<double>() - 1);
  // What is written is what was measured.
  const GaussianSet set = read_splat_ply(out("fit") / kSplatFile);
  EXPECT_EQ(set.size(), fit["gaussians"]["at_last"].get<int64_t>());
  EXPECT_EQ(read_cameras_json(out("fit") / "cameras.json").records.size(), 10U);
  KernelSettings settings;
  const Scene of_folder = open_scene(scene());
  const SplatFitViews views = load_fit_views(of_folder, fit_size(of_folder, options.side), 2, settings);
  ProjectionOptions projection;
  projection.near = fit["near"].get<double>();
  const auto decibels = view_decibels(views.held_out, set, projection, settings);
  // Means are floats of the world in the file, which moves them by 1e-7 of the room.
  EXPECT_NEAR((decibels[0] + decibels[1]) / 2, fit["held_out_psnr"].get<double>(), 1e-3);
}

TEST_F(FittedSplats, BytesDoNotDependOnThreads) {
  SplatCommandOptions options = quick(scene(), out("one"));
  options.fit.steps = 25;
  options.fit.degree_every = 10;
  options.fit.density.densify = Densification::kPublished;
  options.fit.density.first_step = 10;
  options.fit.density.every = 5;
  options.fit.density.reset_every = 20;
  options.fit.density.most_gaussians = 3000;
  options.threads = 1;
  run_splat_fit(options);
  options.out = out("eight").string();
  options.threads = 8;
  run_splat_fit(options);
  EXPECT_EQ(read_file(out("one") / kSplatFile), read_file(out("eight") / kSplatFile));
  EXPECT_LE(read_splat_ply(out("one") / kSplatFile).size(), 3000);
}

SplatCommandOptions long_fit(const std::filesystem::path& scene, const std::filesystem::path& out) {
  SplatCommandOptions options = quick(scene, out);
  options.fit.steps = 240;
  options.fit.degree_every = 30;
  options.fit.density.densify = Densification::kPublished;
  options.fit.density.first_step = 10;
  options.fit.density.every = 15;
  options.fit.density.most_gaussians = 2500;
  options.checkpoint_every = 7;
  // Of OpenMP's threads none lives on in a forked process.
  options.threads = 1;
  return options;
}

// Killed at whatever moment, a run goes on to the bytes of one that was not.
TEST_F(FittedSplats, KilledGoesOnToTheSameBytes) {
  SplatCommandOptions options = long_fit(scene(), out("killed"));
  int64_t killed = 0;
  for (int times = 0; times < 3; ++times) {
    const auto checkpoint = out("killed") / kSplatCheckpointFile;
    const auto at = [&] {
      return std::filesystem::exists(checkpoint) ? read_splat_checkpoint(checkpoint).fit.step : 0;
    };
    const int64_t before = at();
    const pid_t child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      run_splat_fit(options);
      _exit(0);
    }
    options.resume = true;
    int status = 0;
    for (int waited = 0; waited < 5000 && at() <= before && ::waitpid(child, &status, WNOHANG) == 0; ++waited)
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    // Somewhere between two checkpoints, or while one is written.
    std::this_thread::sleep_for(std::chrono::milliseconds(5 * times));
    ::kill(child, SIGKILL);
    ::waitpid(child, &status, 0);
    killed += WIFSIGNALED(status) ? 1 : 0;
    EXPECT_GT(at(), before);
    EXPECT_FALSE(std::filesystem::exists(out("killed") / kSplatFile));
  }
  EXPECT_EQ(killed, 3);
  run_splat_fit(options);
  EXPECT_FALSE(std::filesystem::exists(out("killed") / kSplatCheckpointFile));
  run_splat_fit(long_fit(scene(), out("whole")));
  EXPECT_EQ(read_file(out("killed") / kSplatFile), read_file(out("whole") / kSplatFile));
  const auto killed_report = report_of(out("killed")), whole_report = report_of(out("whole"));
  for (const char* key : {"held_out_psnr", "fitted_psnr", "gaussians", "steps", "near"})
    EXPECT_EQ(killed_report[key], whole_report[key]) << key;
  EXPECT_EQ(
      error_of([&] { run_splat_fit(options); }),
      out("killed").string() +
          ": expected a run that was stopped or killed, found one that is finished; choose another --out, or "
          "add --overwrite in the place of --resume.");
}

// Runs a fit in a process whose files can have so many bytes, as on a disk that is full: what it ends with.
std::string said_with_files_of(int64_t bytes, const SplatCommandOptions& options) {
  int pipe_ends[2];
  EXPECT_EQ(::pipe(pipe_ends), 0);
  const pid_t child = ::fork();
  if (child == 0) {
    install_interrupt_handler(
        StopDeadline::kSafePoint);  // as commands do: a file that may not grow is no end
    const rlimit limit{static_cast<rlim_t>(bytes), static_cast<rlim_t>(bytes)};
    ::setrlimit(RLIMIT_FSIZE, &limit);
    const std::string said = error_of([&] { run_splat_fit(options); });
    const bool written = ::write(pipe_ends[1], said.data(), said.size()) == static_cast<ssize_t>(said.size());
    _exit(written ? 0 : 1);
  }
  ::close(pipe_ends[1]);
  std::string said;
  char buffer[4096];
  for (ssize_t count = 0; (count = ::read(pipe_ends[0], buffer, sizeof(buffer))) > 0;)
    said.append(buffer, static_cast<size_t>(count));
  ::close(pipe_ends[0]);
  int status = 0;
  ::waitpid(child, &status, 0);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0) << status;
  return said;
}

// A disk that is full ends a fit with a sentence that names the file, nothing is there by half, and with room again the
// run goes on to the same bytes.
TEST_F(FittedSplats, FullDiskLeavesWhatThereWasAndGoesOn) {
  const SplatCommandOptions options = long_fit(scene(), out("full"));
  const auto ply = out("full") / kSplatFile, checkpoint = out("full") / kSplatCheckpointFile;
  const auto failed = [&](const std::filesystem::path& file, const std::string& said) {
    EXPECT_EQ(said.find(file.string() + ": expected to write "), 0U) << said;
    EXPECT_NE(said.find(" bytes, found an error: File too large; free some space or check the folder's "
                        "permissions."),
              std::string::npos)
        << said;
    for (const auto& entry : std::filesystem::directory_iterator(out("full")))
      EXPECT_EQ(entry.path().filename().string().find(".partial-"), std::string::npos) << entry.path();
  };
  // Nothing as large as a checkpoint has room.
  failed(checkpoint, said_with_files_of(50'000, options));
  EXPECT_FALSE(std::filesystem::exists(checkpoint));
  EXPECT_FALSE(std::filesystem::exists(ply));
  // Harmonics of rising degree make a checkpoint larger: there is room at first, and then none any more.
  SplatCommandOptions first = options;
  first.overwrite = true;
  first.checkpoint_every = 1;
  failed(checkpoint, said_with_files_of(900'000, first));
  const int64_t kept = read_splat_checkpoint(checkpoint).fit.step;
  EXPECT_GT(kept, 0);
  EXPECT_LT(kept, options.fit.steps);
  SplatCommandOptions resumed = options;
  resumed.resume = true;
  run_splat_fit(resumed);
  run_splat_fit(long_fit(scene(), out("whole")));
  EXPECT_EQ(read_file(ply), read_file(out("whole") / kSplatFile));
}

TEST_F(FittedSplats, NoByteOfACheckpointCanChange) {
  SplatCheckpoint checkpoint;
  checkpoint.fit.set = zero_gaussians(3, 1);
  for (size_t i = 0; i < 3; ++i) checkpoint.fit.set.rotations[4 * i] = 1;
  checkpoint.fit.set.channels = 2;
  checkpoint.fit.set.features = {1, 2, 3, 4, 5, 6};
  checkpoint.fit.set.origin = {0.1, -1e6, 1.0 / 3};
  checkpoint.fit.moments = splat_moments(checkpoint.fit.set);
  checkpoint.fit.moments.second.means[4] = 1e-30F;
  checkpoint.fit.statistics = {{0.5F, 1, 2}, {1, 0, 7}};
  checkpoint.fit.step = 12;
  checkpoint.seconds = 0.1;
  checkpoint.rows = {{int64_t{10}, 0.1, std::string()}};
  const auto file = out();
  write_splat_checkpoint(file, checkpoint);
  const SplatCheckpoint read = read_splat_checkpoint(file);
  EXPECT_EQ(read.fit.step, 12);
  EXPECT_EQ(read.fit.set.origin, checkpoint.fit.set.origin);
  EXPECT_EQ(read.fit.set.features, checkpoint.fit.set.features);
  EXPECT_EQ(read.fit.moments.first.channels, 2);
  EXPECT_EQ(read.fit.moments.second.means, checkpoint.fit.moments.second.means);
  EXPECT_EQ(read.fit.statistics.seen, checkpoint.fit.statistics.seen);
  EXPECT_EQ(read.rows, checkpoint.rows);
  const std::string bytes = read_file(file);
  const std::string sentence =
      file.string() +
      ": expected a checkpoint as gld splat fit wrote it, found other bytes; remove it: the fit then begins anew.";
  for (size_t i = 0; i < bytes.size(); i += 3) {
    std::string changed = bytes;
    changed[i] = static_cast<char>(changed[i] ^ 1);
    write_file_atomically(file, changed);
    EXPECT_EQ(error_of([&] { read_splat_checkpoint(file); }), sentence) << i;
    write_file_atomically(file, bytes.substr(0, i));
    EXPECT_EQ(error_of([&] { read_splat_checkpoint(file); }), sentence) << i;
  }
}

TEST_F(FittedSplats, ResumesNothingElse) {
  SplatCommandOptions options = long_fit(scene(), out());
  options.fit.steps = 14;
  run_splat_fit(options);
  // As if it had been killed before its report.
  std::filesystem::remove(out() / "report.json");
  SplatCheckpoint checkpoint;
  checkpoint.fit.set = read_splat_ply(out() / kSplatFile);
  checkpoint.fit.moments = splat_moments(checkpoint.fit.set);
  checkpoint.views = "those of another scene";
  write_splat_checkpoint(out() / kSplatCheckpointFile, checkpoint);
  options.resume = true;
  EXPECT_EQ(error_of([&] { run_splat_fit(options); }),
            (out() / kSplatCheckpointFile).string() +
                ": expected the pictures and cameras that the run began with, found others in " +
                options.scene + "; put those back, or begin anew with --overwrite.");
  options.fit.rates.colour = 0.5;
  EXPECT_NE(error_of([&] { run_splat_fit(options); }).find("fit.rates.colour"), std::string::npos);
  options.overwrite = true;
  EXPECT_EQ(
      error_of([&] { run_splat_fit(options); }),
      "--resume, --overwrite: expected one of the two, found both; --resume goes on with the run, --overwrite "
      "removes it.");
}

TEST_F(FittedSplats, StartsFromSparsePointsWithoutDepth) {
  Scene scene = open_scene(this->scene());
  const SplatFitViews views = load_fit_views(scene, fit_size(scene, 64), 0, {});
  std::vector<Eigen::Vector3d> points;
  for (const SplatPicture& picture : views.pictures) {
    for (int64_t i = 3; i < 64; i += 7) {
      const double depth = picture.depth.at(i, 40);
      points.push_back(picture.camera.world_from_camera *
                       (picture.camera.intrinsics.inverse() *
                        Eigen::Vector3d(static_cast<double>(i) + 0.5, 40.5, 1) * depth));
    }
  }
  std::vector<SplatPicture> without = views.pictures;
  for (SplatPicture& picture : without) picture.depth = {};
  const SceneReach reach = scene_reach(without, points);
  SplatStartOptions start;
  start.from = start_of(without, points, SplatStartFrom::kAuto, "scene");
  EXPECT_EQ(start.from, SplatStartFrom::kPoints);
  const GaussianSet set = start_gaussians(without, points, reach, 1000, start, "scene");
  EXPECT_EQ(set.size(), static_cast<int64_t>(points.size()));
  check_gaussians(set, "start");
  EXPECT_LE(start_gaussians(without, points, reach, 10, start, "scene").size(), 10);
  // Points may be wanted where there is depth as well.
  EXPECT_EQ(start_of(views.pictures, points, SplatStartFrom::kAuto, "scene"), SplatStartFrom::kDepth);
  EXPECT_EQ(start_of(views.pictures, points, SplatStartFrom::kPoints, "scene"), SplatStartFrom::kPoints);
  const std::string cure =
      "give the scene depth files or pictures that overlap, taken with steps to the side, reconstruct it with "
      "COLMAP, or fit a run of gld sample --outputs image,depth.";
  EXPECT_EQ(
      error_of([&] { start_of({without.front()}, {}, SplatStartFrom::kAuto, "rooms/a"); }),
      "rooms/a: expected measured or predicted depth, sparse points, or several pictures to start from, "
      "found none; " +
          cure);
  EXPECT_EQ(error_of([&] { start_of(without, points, SplatStartFrom::kDepth, "rooms/a"); }),
            "rooms/a: expected pixels of known depth to start from, found none; " + cure);
  EXPECT_EQ(error_of([&] { start_of(without, {}, SplatStartFrom::kPoints, "rooms/a"); }),
            "rooms/a: expected sparse points to start from, found none; " + cure);
  EXPECT_EQ(error_of([&] { start_of({without.front()}, points, SplatStartFrom::kMatch, "rooms/a"); }),
            "rooms/a: expected several pictures to start from, found one; " + cure);
}

// Pictures alone, with their cameras: the start lies where the room does, and pictures that show one place from one
// place tell nothing.
TEST_F(FittedSplats, StartsFromWhatPicturesAgreeOn) {
  const Scene scene = open_scene(this->scene());
  const SplatFitViews views = load_fit_views(scene, fit_size(scene, 64), 0, {});
  std::vector<SplatPicture> without = views.pictures;
  for (SplatPicture& picture : without) picture.depth = {};
  SplatFitOptions options;
  const SplatFit fit = begin_splat_fit(without, {}, options, "scene", {});
  EXPECT_EQ(fit.start, SplatStartFrom::kMatch);
  EXPECT_GT(fit.set.size(), 1000);
  const std::vector<SplatPicture> matched = with_matched_depth(without, {}, {});
  std::vector<double> errors;
  for (size_t i = 0; i < matched.size(); ++i) {
    const DepthMap &found = matched[i].depth, &truth = views.pictures[i].depth;
    ASSERT_EQ(found.width, truth.width);
    for (size_t pixel = 0; pixel < found.metres.size(); ++pixel) {
      if (is_known_depth(found.metres[pixel]) && is_known_depth(truth.metres[pixel]))
        errors.push_back(std::abs(found.metres[pixel] / truth.metres[pixel] - 1));
    }
  }
  ASSERT_GT(errors.size(), 1000U);
  std::nth_element(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2),
                   errors.end());
  EXPECT_LT(errors[errors.size() / 2], 0.03);

  SplatFitOptions never;
  EXPECT_EQ(
      error_of([&] {
        begin_splat_fit({without.front(), without.front()}, {}, never, "rooms/a", {});
      }),
      "rooms/a: expected pixels whose depth the pictures agree on to start from, found none; give the scene depth "
      "files or pictures that overlap, taken with steps to the side, reconstruct it with COLMAP, or fit a run of "
      "gld sample --outputs image,depth.");
}

// The depth is as gld sample --size photographs leaves it.
TEST_F(FittedSplats, StartsFromDepthThatIsSmallerThanItsPictures) {
  CameraList cameras = read_cameras_json(scene() / "cameras.json");
  CameraList of_depth = cameras;
  for (size_t i = 0; i < cameras.records.size(); ++i) {
    CameraRecord& record = cameras.records[i];
    const Image picture = read_image(scene() / record.image);
    Image large(2 * picture.width, 2 * picture.height);
    for (int64_t y = 0; y < large.height; ++y) {
      for (int64_t x = 0; x < large.width; ++x)
        std::copy_n(picture.pixel(x / 2, y / 2), 3, large.pixel(x, y));
    }
    write_png(scene() / record.image, large);
    record.camera = resized_camera(record.camera, large.width, large.height);
    record.depth.clear();
    record.depth_unit = 0;
    of_depth.records[i].image.clear();
  }
  write_cameras_json(scene() / "cameras.json", cameras);
  EXPECT_FALSE(open_scene(scene()).frames[0].has_depth());
  write_cameras_json(scene() / kDepthCamerasFile, of_depth);
  const Scene read = open_scene(scene());
  const DepthMap depth = read.frames[0].depth();
  EXPECT_EQ(depth.width, cameras.records[0].camera.width);
  for (int64_t x = 0; x < depth.width; ++x) EXPECT_EQ(depth.at(x, 9), depth.at(x / 2 * 2, 8)) << x;
  SplatCommandOptions options = quick(scene(), out());
  testing::internal::CaptureStdout();
  run_splat_fit(options);
  EXPECT_THAT(testing::internal::GetCapturedStdout(),
              testing::ContainsRegex("about .* for 60 steps, and [0-9]+ MB for pictures and Gaussians\n"));
  EXPECT_GT(report_of(out()).at("fitted_psnr"), 18);
  // Depth under another camera is no depth of the picture.
  of_depth.records[1].camera.intrinsics(0, 2) += 1;
  write_cameras_json(scene() / kDepthCamerasFile, of_depth);
  EXPECT_EQ(
      error_of([&] { open_scene(scene()); }),
      (scene() / kDepthCamerasFile).string() + " " + of_depth.records[1].name +
          ": expected the camera of the picture in another size, found one that is 2 pixels and 0 of the unit "
          "beside it; remove the file, or write both from one camera.");
}

TEST_F(FittedSplats, RefusesWhatHasNoRoomInMemory) {
  const Scene of_folder = open_scene(scene());
  SplatFitOptions options;
  options.density.most_gaussians = 50000;
  const SplatWork work = scene_fit_work(of_folder, {100, 80}, 2, options);
  EXPECT_EQ(work.views, static_cast<int64_t>(of_folder.frames.size()) - 2);
  EXPECT_EQ(work.gaussians, 50000);
  const SplatWork small = scene_fit_work(of_folder, {10, 8}, 2, options);
  EXPECT_EQ(small.gaussians, small.views * 80);
  const int64_t bytes = splat_fit_bytes(work, options);
  EXPECT_GT(bytes, int64_t{4} * 50000 * (14 + 45) * 4);
  EXPECT_NO_THROW(require_memory_for_fit(work, options, bytes, "rooms/a"));
  EXPECT_NO_THROW(require_memory_for_fit(work, options, 0, "rooms/a"));
  EXPECT_THAT(
      error_of([&] { require_memory_for_fit(work, options, bytes - 1, "rooms/a"); }),
      testing::MatchesRegex(
          "rooms/a: expected 0[.][0-9] GB of memory for 8 views of 100x80 and up to 50000 Gaussians, "
          "found 0[.][0-9] GB that are free; make --side or --most-gaussians smaller, or the views fewer[.]"));
}

TEST_F(FittedSplats, RefusesWhatItCannotFit) {
  SplatCommandOptions options = quick(scene(), out());
  options.held_out = 10;
  EXPECT_EQ(
      error_of([&] { run_splat_fit(options); }),
      "--held-out: expected less than the scene's 10 views with a picture, found 10; keep fewer of them apart.");
  EXPECT_FALSE(std::filesystem::exists(out()));
  options.held_out = 0;
  options.run = scene().string();
  EXPECT_EQ(error_of([&] { run_splat_fit(options); }),
            "gld splat fit: expected --scene or --run, found both; name one of them.");
}

}  // namespace
}  // namespace gld
