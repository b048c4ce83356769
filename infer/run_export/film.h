#pragma once

#include "gld/cameras/camera.h"
#include "gld/report/provenance.h"
#include "infer/run_export/finished_run.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// A picture of a film: a target view of the run as it is, or one between two of them.
struct FilmFrame {
  size_t view = 0;       // of FinishedRun::views; the one before it
  size_t next_view = 0;  // the one behind it; the same for a view as it is
  double position = 0;   // between the two, from 0 to 1
  double carried = 1;  // the share of pixels that comes from the two views; the rest is filled in from around
  std::filesystem::path file;  // PNG

  bool between() const { return next_view != view; }
};

// The target views of a run in their order, as pictures that move.
struct Film {
  int64_t width = 0;
  int64_t height = 0;
  bool closes = false;  // the last camera stands where the next one would be the first
  int64_t pictures_a_second = 0;
  std::vector<FilmFrame> frames;  // each picture once
  std::vector<size_t> shown;  // frames in the order of showing: once around, or there and back (ping-pong)
};

struct FilmOptions {
  int64_t between = 0;  // pictures between two views, carried by their depth
  int64_t views_a_second = 4;
};

// Returns whether a path comes back to its beginning: from the last camera to the first it is no farther, by distance
// and by angle, than 1.5 times the longest way from one camera to the next. There are three cameras or more.
bool path_closes(const std::vector<Camera>& cameras);

// Returns the numbers of frames in the order of showing: 0, 1, ..., and back without the ends twice where the path does
// not close.
std::vector<size_t> shown_frames(size_t frames, bool closes);

// Throws Error where no target has a picture, sizes differ, or depth is missing for pictures between views.
void check_film(const FinishedRun& run, int64_t between);

// Pictures between the views go into folder; the views' own files are taken as they are. A picture between two views
// has a camera on the spline through all targets (infer/paths/spline_path.h), closed where the path is, and shows what
// the two views show of it by their depth (gld/photogrammetry/photograph_composition.h). Throws the Errors of
// check_film(), and Interrupted on Ctrl-C.
Film make_film(const FinishedRun& run, const FilmOptions& options, const std::filesystem::path& folder);

// Returns for example "1-3, 5-7": the pictures between views, by their number in the order of showing, from 0; it is
// empty where there are none.
std::string carried_frames_text(const Film& film);

// Returns the provenance with "gld:carried_frames" and "gld:frame_views", which say what each picture is.
TextItems film_provenance(const FinishedRun& run, const Film& film, TextItems provenance);

// Returns for the report: rate, seconds, whether it closes, and each picture.
nlohmann::ordered_json film_json(const FinishedRun& run, const Film& film);

}  // namespace gld
