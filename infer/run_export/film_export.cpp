#include "infer/run_export/film_export.h"

#include "datasets/images/image_file.h"
#include "datasets/images/webp_animation.h"
#include "datasets/video/ffmpeg.h"
#include "gld/base/atomic_file.h"
#include "gld/base/child_process.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/base/json_text.h"
#include "gld/base/work_folder.h"
#include "infer/run_export/export_provenance.h"

#include <algorithm>
#include <string>
#include <vector>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr double kWebpQuality = 92;
constexpr const char* kX264Rate =
    "10";  // constant rate factor: half the resolution of colours costs more than this

Image even_sides(const Image& image) {
  Image even(image.width + image.width % 2, image.height + image.height % 2);
  for (int64_t y = 0; y < even.height; ++y) {
    for (int64_t x = 0; x < even.width; ++x) {
      const uint8_t* from = image.pixel(std::min(x, image.width - 1), std::min(y, image.height - 1));
      std::copy(from, from + 3, even.pixel(x, y));
    }
  }
  return even;
}

// Puts the film's pictures there in the order of showing, as ffmpeg takes them: 000000.png, ...
void put_pictures(const Film& film, const std::filesystem::path& folder) {
  const bool even = film.width % 2 == 0 && film.height % 2 == 0;
  std::vector<std::filesystem::path> files;
  for (size_t i = 0; i < film.frames.size(); ++i) {
    files.push_back(std::filesystem::absolute(film.frames[i].file));
    if (even) continue;
    files.back() = folder / fmt::format("even_{:06}.png", i);
    write_png(files.back(), even_sides(read_image(film.frames[i].file)));
  }
  for (size_t i = 0; i < film.shown.size(); ++i)
    std::filesystem::create_symlink(files[film.shown[i]], folder / fmt::format("{:06}.png", i));
}

// Returns a path in which ffmpeg looks for numbers.
std::string as_pattern(const std::filesystem::path& folder) {
  std::string pattern;
  for (const char letter : folder.string()) pattern += letter == '%' ? "%%" : std::string(1, letter);
  return pattern + "/%06d.png";
}

std::string json_of(const TextItems& texts) {
  nlohmann::ordered_json json;
  for (const auto& [name, text] : texts) json[name] = text;
  return json_text(json);
}

}  // namespace

void export_webp(const std::filesystem::path& file, const Film& film, const TextItems& texts) {
  WebpAnimation animation(film.width, film.height, kWebpQuality);
  const auto milliseconds = [&](size_t frame) {
    const auto rate = static_cast<uint64_t>(film.pictures_a_second);
    return static_cast<int64_t>((1000 * frame + rate / 2) / rate);
  };
  for (size_t i = 0; i < film.shown.size(); ++i) {
    stop_if_interrupted(fmt::format("{} of {} pictures were encoded", i, film.shown.size()));
    animation.add(read_image(film.frames[film.shown[i]].file), milliseconds(i));
  }
  write_file_atomically(file, animation.finish(milliseconds(film.shown.size()), xmp_packet(texts)));
}

std::filesystem::path require_ffmpeg() {
  auto program = found_program("ffmpeg");
  if (program.empty()) {
    fail({"--as mp4", "the program ffmpeg on the PATH", "none",
          "install it (apt install ffmpeg), or leave mp4 out"});
  }
  return program;
}

void export_mp4(const std::filesystem::path& file, const Film& film, const TextItems& texts,
                const std::filesystem::path& ffmpeg) {
  WorkFolder folder("ffmpeg");
  put_pictures(film, folder.path());
  AtomicFile written(file);
  std::vector<std::string> command = ffmpeg_command(ffmpeg);
  const std::vector<std::string> film_options{
      "-f",
      "image2",
      "-framerate",
      std::to_string(film.pictures_a_second),
      "-start_number",
      "0",
      "-i",
      as_pattern(folder.path()),
      "-vf",
      "scale=out_color_matrix=bt709:out_range=tv:flags=area+accurate_rnd+full_chroma_inp,format=yuv420p",
      "-c:v",
      "libx264",
      "-preset",
      "medium",
      "-crf",
      kX264Rate,
      "-threads",
      "1",
      "-colorspace",
      "bt709",
      "-color_primaries",
      "bt709",
      "-color_trc",
      "iec61966-2-1",
      "-color_range",
      "tv",
      "-fflags",
      "+bitexact",
      "-flags:v",
      "+bitexact",
      "-map_metadata",
      "-1",
      "-metadata",
      "comment=" + json_of(texts),
      "-movflags",
      "+faststart",
      std::filesystem::absolute(written.temporary()).string()};
  command.insert(command.end(), film_options.begin(), film_options.end());
  if (const int status = run_program(command, folder.log(), "while ffmpeg made " + file.string());
      status != 0) {
    folder.keep();
    fail({"--as mp4", "ffmpeg to succeed",
          fmt::format("exit status {}; what it printed is in {}", status, folder.log().string()),
          "see there, or leave mp4 out"});
  }
  written.commit();
}

}  // namespace gld
