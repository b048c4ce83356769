#pragma once

#include "datasets/images/image.h"
#include "datasets/pictures/depth_preview.h"

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace gld {

enum class SheetRole { kSource, kTarget };

// One view on a contact sheet. Pictures may be of any size; an empty one is missing.
struct SheetView {
  std::string name;  // "view_03"
  SheetRole role = SheetRole::kSource;
  std::string note;  // beside the name, "21.3 dB"
  Image image;       // a source's photograph, a target's generated picture
  Image truth;       // what a target should look like
  Image depth;       // coloured_depth
};

struct SheetText {
  std::string title;                 // "gld sample, scene 5e040cd0"
  std::vector<std::string> verdict;  // lines under the title, as they are: what the pictures are worth
  std::string subtitle;              // "seed 3, 16 evaluations, ..."
  // Written under the sheet as a colour bar when a view has depth; all views must be coloured by this one range.
  DepthRange depth_range;
  std::string depth_unit;  // "m", or empty
};

// How large a sheet may become; pictures become smaller and wrap into lines to stay inside.
struct SheetLimits {
  int64_t width = 1920;
  int64_t height = 1600;
  int64_t picture = 480;  // longest side of a picture
};

// Puts all pictures of a scene on one page: the sources, then the targets; under each other stands what belongs to one
// view, with the rows labelled at the left. Throws Error when there is no view or no picture.
Image make_contact_sheet(const std::vector<SheetView>& views, const SheetText& text,
                         const SheetLimits& limits = {});

// Pictures that stand beside each other below a heading, each under its name.
struct SheetSection {
  std::string heading;
  std::vector<std::pair<std::string, Image>> pictures;
};

// Puts sections of pictures on one page. Throws Error when there is no picture.
Image make_picture_sheet(const std::vector<SheetSection>& sections, const SheetText& text,
                         const SheetLimits& limits = {});

}  // namespace gld
