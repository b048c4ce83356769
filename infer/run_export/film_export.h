#pragma once

#include "gld/report/provenance.h"
#include "infer/run_export/film.h"

#include <filesystem>

namespace gld {

// Writes a WebP animation of the film, lossy, going on for ever, with the texts as XMP. Writing is atomic.
void export_webp(const std::filesystem::path& file, const Film& film, const TextItems& texts);

// Finds the program ffmpeg on the PATH. Throws an Error of one sentence where there is none.
std::filesystem::path require_ffmpeg();

// Writes an MP4 file of the film made by that program: H.264, yuv420p, BT.709, sides rounded up to even ones by showing
// the last column or row twice, the texts as a JSON comment. It has one thread, so that the same film gives the same
// bytes. Writing is atomic. Throws Error where ffmpeg fails, with the place of what it printed, and Interrupted on
// Ctrl-C.
void export_mp4(const std::filesystem::path& file, const Film& film, const TextItems& texts,
                const std::filesystem::path& ffmpeg);

}  // namespace gld
