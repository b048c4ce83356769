#include "infer/run_export/film_export.h"

#include "datasets/images/image_file.h"
#include "gld/base/work_folder.h"
#include "infer/run_export/export_provenance.h"
#include "tests/infer/run_export/drawn_run.h"
#include "tests/support/error_of.h"
#include "tests/support/run_program.h"
#include "tests/support/temporary_folder.h"
#include "tests/support/webp_frames.h"

#include <algorithm>
#include <cstdlib>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::DrawnRun;
using test::error_of;
using test::TemporaryFolder;
using ::testing::HasSubstr;
using ::testing::MatchesRegex;

// dB. Films keep two differences of the three colours at half the resolution: that is most of what they lose.
constexpr double kLeastOfAllColours = 35;

class FilmExport : public ::testing::Test {
 protected:
  static constexpr int64_t kPlainRoom = 0;
  // It has a ball striped violet and green, of whose edges half the resolution leaves 27 dB, however well they are
  // encoded: of the first twelve rooms that is the least by far, the next one has 34.
  static constexpr int64_t kStripedRoom = 3;

  // Large enough that half the resolution of colours is enough of them in most rooms.
  Film film_of(DrawnRun drawn, int64_t room = kPlainRoom) {
    drawn.room = room;
    drawn.width = 256;
    drawn.height = 192;
    const auto place = folder_.path() / "run";
    std::filesystem::remove_all(place);
    test::write_drawn_run(place, drawn);
    run_ = open_finished_run(place);
    FilmOptions options;
    options.views_a_second = 5;
    Film film = make_film(run_, options, folder_.path());
    texts_ = film_provenance(run_, film, export_provenance(run_, R"({"between":0})"));
    return film;
  }
  // Returns what ffmpeg reads in a video, as pictures.
  std::vector<Image> decoded(const std::filesystem::path& video) const {
    const auto place = folder_.path() / "decoded";
    std::filesystem::remove_all(place);
    std::filesystem::create_directory(place);
    const auto run = test::run_program(
        "ffmpeg", {"-nostdin", "-loglevel", "error", "-i", video.string(), "-vf",
                   "scale=in_color_matrix=bt709:in_range=tv:flags=accurate_rnd+full_chroma_int+bicubic",
                   "-pix_fmt", "rgb24", (place / "%03d.png").string()});
    EXPECT_EQ(run.status, 0) << run.text;
    std::vector<Image> frames;
    for (int i = 1; std::filesystem::exists(place / fmt::format("{:03}.png", i)); ++i)
      frames.push_back(read_image(place / fmt::format("{:03}.png", i)));
    return frames;
  }

  static Image shown(const Film& film, size_t i) { return read_image(film.frames[film.shown[i]].file); }

  const TemporaryFolder folder_;
  FinishedRun run_;
  TextItems texts_;
};

TEST_F(FilmExport, WritesWebp) {
  const Film film = film_of({});
  const auto file = folder_.path() / "path.webp";
  export_webp(file, film, texts_);
  const std::string bytes = read_file(file);
  const test::WebpFrames read = test::webp_frames(bytes);
  ASSERT_EQ(read.frames.size(), 4U);
  EXPECT_EQ(read.ends_ms, (std::vector<int>{200, 400, 600, 800}));
  for (size_t i = 0; i < 4; ++i)
    EXPECT_GT(test::psnr_of(read.frames[i], shown(film, i)), kLeastOfAllColours) << i;
  EXPECT_THAT(read.xmp, HasSubstr("<gld:model>0123456789abcdef</gld:model>"));
  EXPECT_THAT(read.xmp, HasSubstr("<gld:frame_views>view_01, view_02, view_03, view_02</gld:frame_views>"));
  export_webp(file, film, texts_);
  EXPECT_EQ(read_file(file), bytes);
}

TEST_F(FilmExport, WritesMp4) {
  const Film film = film_of({});
  const auto file = folder_.path() / "path.mp4";
  export_mp4(file, film, texts_, require_ffmpeg());
  const auto probe = test::run_program(
      "ffprobe",
      {"-v", "error", "-count_frames", "-show_entries",
       "stream=codec_name,pix_fmt,width,height,r_frame_rate,nb_read_frames,color_space:format_tags=comment",
       "-of", "json", file.string()});
  ASSERT_EQ(probe.status, 0) << probe.text;
  const auto json = nlohmann::json::parse(probe.text);
  ASSERT_EQ(json.at("streams").size(), 1U);
  const auto& stream = json.at("streams")[0];
  EXPECT_EQ(stream.at("codec_name"), "h264");
  EXPECT_EQ(stream.at("pix_fmt"), "yuv420p");
  EXPECT_EQ(stream.at("width"), 256);
  EXPECT_EQ(stream.at("height"), 192);
  EXPECT_EQ(stream.at("r_frame_rate"), "5/1");
  EXPECT_EQ(stream.at("nb_read_frames"), "4");
  EXPECT_EQ(stream.at("color_space"), "bt709");
  const auto comment = nlohmann::json::parse(json.at("format").at("tags").at("comment").get<std::string>());
  EXPECT_EQ(comment.at("gld:model"), "0123456789abcdef");
  EXPECT_EQ(comment.at("gld:seed"), "7");
  const std::vector<Image> frames = decoded(file);
  ASSERT_EQ(frames.size(), 4U);
  for (size_t i = 0; i < 4; ++i) EXPECT_GT(test::psnr_of(frames[i], shown(film, i)), kLeastOfAllColours) << i;
  const std::string bytes = read_file(file);
  export_mp4(file, film, texts_, require_ffmpeg());
  EXPECT_EQ(read_file(file), bytes);
}

// H.264 wants even sides: the last column and row are shown twice.
TEST_F(FilmExport, RoundsOddSidesUp) {
  DrawnRun drawn;
  drawn.cut = 3;
  const Film film = film_of(drawn);
  ASSERT_EQ(film.width, 253);
  ASSERT_EQ(film.height, 189);
  const auto file = folder_.path() / "path.mp4";
  export_mp4(file, film, texts_, require_ffmpeg());
  const std::vector<Image> frames = decoded(file);
  ASSERT_EQ(frames.size(), 4U);
  ASSERT_EQ(frames[0].width, 254);
  ASSERT_EQ(frames[0].height, 190);
  const Image picture = read_image(film.frames[0].file);
  Image expected(254, 190);
  for (int64_t y = 0; y < 190; ++y) {
    for (int64_t x = 0; x < 254; ++x) {
      const uint8_t* pixel = picture.pixel(std::min<int64_t>(x, 252), std::min<int64_t>(y, 188));
      std::copy(pixel, pixel + 3, expected.pixel(x, y));
    }
  }
  EXPECT_GT(test::psnr_of(frames[0], expected), kLeastOfAllColours);
}

// Brightness has the whole resolution, whatever colours do.
TEST_F(FilmExport, KeepsBrightnessAtEdgesOfColours) {
  const Film film = film_of({}, kStripedRoom);
  const auto webp = folder_.path() / "path.webp", mp4 = folder_.path() / "path.mp4";
  export_webp(webp, film, texts_);
  export_mp4(mp4, film, texts_, require_ffmpeg());
  for (const std::vector<Image>& frames : {test::webp_frames(read_file(webp)).frames, decoded(mp4)}) {
    ASSERT_EQ(frames.size(), 4U);
    for (size_t i = 0; i < 4; ++i) EXPECT_GT(test::brightness_psnr_of(frames[i], shown(film, i)), 35) << i;
  }
}

TEST_F(FilmExport, SaysInASentenceWhatFfmpegDoes) {
  const Film film = film_of({});
  const auto file = folder_.path() / "path.mp4", program = folder_.path() / "failing";
  write_file_atomically(program, "#!/bin/sh\necho no codec\nexit 3\n");
  std::filesystem::permissions(program, std::filesystem::perms::owner_all);
  const std::string refused = error_of([&] { export_mp4(file, film, texts_, program); });
  EXPECT_THAT(refused,
              MatchesRegex("--as mp4: expected ffmpeg to succeed, found exit status 3; what it printed is in "
                           ".*/ffmpeg.log; see there, or leave mp4 out."));
  const size_t begin = refused.find("is in ") + 6;
  const std::filesystem::path log = refused.substr(begin, refused.find(';', begin) - begin);
  EXPECT_EQ(read_file(log), "no codec\n");
  std::filesystem::remove_all(log.parent_path());
  EXPECT_FALSE(std::filesystem::exists(file));
  const char* before = std::getenv("PATH");
  const std::string path = before == nullptr ? "" : before;
  ::setenv("PATH", "/nowhere", 1);
  EXPECT_EQ(
      error_of([] { require_ffmpeg(); }),
      "--as mp4: expected the program ffmpeg on the PATH, found none; install it (apt install ffmpeg), or leave "
      "mp4 out.");
  ::setenv("PATH", path.c_str(), 1);
}

}  // namespace
}  // namespace gld
