#include "datasets/video/video_frames.h"

#include "datasets/images/image_file.h"
#include "gld/base/atomic_file.h"
#include "gld/base/child_process.h"
#include "gld/base/work_folder.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>
#include <cstdlib>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using testing::ElementsAre;
using testing::HasSubstr;

constexpr int kFrames = 24, kRate = 8, kWidth = 64, kHeight = 48;

// Frame i is as bright as i says; the sharp ones have a pattern of single pixels on it.
Image frame(int i, bool sharp) {
  Image image(kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const int value = 20 + 8 * i + (sharp && (x / 2 + y / 2) % 2 == 0 ? 12 : 0);
      for (int c = 0; c < 3; ++c) {
        image.pixel(x, y)[c] = static_cast<uint8_t>(value);
      }
    }
  }
  return image;
}

class VideoFrames : public testing::Test {
 protected:
  void ffmpeg(std::vector<std::string> arguments) const {
    std::vector<std::string> command{found_program("ffmpeg").string(), "-nostdin", "-loglevel", "error",
                                     "-y"};
    command.insert(command.end(), arguments.begin(), arguments.end());
    const auto log = folder_.path() / "ffmpeg.log";
    ASSERT_EQ(run_program(command, log, "test"), 0) << read_file(log);
  }

  // The video is without loss, so that the brightness of a frame tells which one it is.
  std::filesystem::path video(const std::string& name, const std::vector<int>& sharp) const {
    for (int i = 0; i < kFrames; ++i) {
      const bool is_sharp = std::find(sharp.begin(), sharp.end(), i) != sharp.end();
      write_png(folder_.path() / fmt::format("{:02}.png", i), frame(i, is_sharp));
    }
    auto file = folder_.path() / name;
    ffmpeg({"-framerate", std::to_string(kRate), "-i", (folder_.path() / "%02d.png").string(), "-c:v", "ffv1",
            file.string()});
    return file;
  }

  std::filesystem::path frames_folder() const {
    auto folder = folder_.path() / "frames";
    std::filesystem::create_directories(folder);
    return folder;
  }

  test::TemporaryFolder folder_;
};

TEST_F(VideoFrames, AreTheSharpestOfEachStretch) {
  const auto file = video("a walk.mkv", {2, 13, 20});
  const auto frames = sharpest_frames(file, 3, frames_folder());
  std::vector<std::string> names;
  std::vector<int> numbers;
  for (const auto& found : frames) {
    names.push_back(found.filename().string());
    const Image image = read_image(found);
    EXPECT_EQ(image.width, kWidth);
    numbers.push_back((image.pixel(2, 0)[0] - 20) / 8);  // beside a pattern's pixel
  }
  EXPECT_THAT(numbers, ElementsAre(2, 13, 20));
  EXPECT_THAT(names, ElementsAre("a walk_0000250ms.png", "a walk_0001625ms.png", "a walk_0002500ms.png"));
}

TEST_F(VideoFrames, OfAShortVideoAreAllThatItHas) {
  const auto file = video("short.mkv", {});
  EXPECT_EQ(sharpest_frames(file, 60, frames_folder()).size(), static_cast<size_t>(kFrames));
}

TEST_F(VideoFrames, OfNoVideoAreRefusedInASentence) {
  const auto empty = folder_.path() / "empty.mp4";
  write_file_atomically(empty, "");
  EXPECT_THAT(error_of([&] { sharpest_frames(empty, 3, frames_folder()); }),
              testing::AllOf(HasSubstr("empty.mp4: expected a video that ffmpeg reads, found exit status"),
                             HasSubstr("of ffprobe; what it printed is in")));
  const auto sound = folder_.path() / "sound.mp4";
  ffmpeg({"-f", "lavfi", "-i", "sine=duration=1", sound.string()});
  EXPECT_THAT(error_of([&] { sharpest_frames(sound, 3, frames_folder()); }),
              HasSubstr("sound.mp4: expected a video, found a file without pictures; check the name"));
  const std::string whole = read_file(video("whole.mkv", {}));
  const auto cut = folder_.path() / "cut.mkv";
  write_file_atomically(cut, whole.substr(0, 200));
  EXPECT_THAT(error_of([&] { sharpest_frames(cut, 3, frames_folder()); }),
              HasSubstr("cut.mkv: expected a video"));
}

// Whatever the program of that name on the PATH writes.
TEST_F(VideoFrames, OfAnFfprobeThatSaysNothingAreRefusedInASentence) {
  const auto file = video("walk.mkv", {});
  const auto programs = folder_.path() / "programs";
  std::filesystem::create_directories(programs);
  write_file_atomically(
      programs / "ffprobe",
      "#!/bin/sh\nwhile [ \"$1\" != -o ]; do shift; done\nprintf '{\"streams\": [' > \"$2\"\n");
  std::filesystem::permissions(programs / "ffprobe", std::filesystem::perms::owner_all);
  const char* before = std::getenv("PATH");
  const std::string path = before == nullptr ? "" : before;
  ::setenv("PATH", (programs.string() + ":" + path).c_str(), 1);
  const std::string refused = error_of([&] { sharpest_frames(file, 3, frames_folder()); });
  ::setenv("PATH", path.c_str(), 1);
  EXPECT_EQ(
      refused,
      file.string() +
          ": expected ffprobe to describe it as JSON, found text that is none (a syntax error); install FFmpeg again "
          "(apt install ffmpeg), or give single pictures.");
}

// A list names another file: it is not opened, though it is there and would do.
TEST_F(VideoFrames, OpensNothingButTheFile) {
  const auto there = video("there.mkv", {});
  EXPECT_EQ(sharpest_frames(there, 2, frames_folder()).size(), 2U);
  const auto list = folder_.path() / "list.mp4";
  for (const std::string& text :
       {std::string("#EXTM3U\n#EXT-X-TARGETDURATION:3\n#EXTINF:3,\nthere.mkv\n#EXT-X-ENDLIST\n"),
        std::string("ffconcat version 1.0\nfile there.mkv\n")}) {
    write_file_atomically(list, text);
    EXPECT_THAT(error_of([&] { sharpest_frames(list, 3, frames_folder()); }),
                HasSubstr("list.mp4: expected a video that ffmpeg reads"))
        << text;
  }
}

TEST(VideoNames, EndLikeAVideo) {
  EXPECT_TRUE(is_video_name("a/IMG_0012.MOV"));
  EXPECT_TRUE(is_video_name("clip.mp4"));
  EXPECT_FALSE(is_video_name("clip.mp4/photo.jpg"));
  EXPECT_FALSE(is_video_name("clip"));
}

}  // namespace
}  // namespace gld
