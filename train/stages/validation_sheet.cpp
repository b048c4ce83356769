#include "train/stages/validation_sheet.h"

#include "datasets/images/image_file.h"
#include "datasets/loading/batching.h"
#include "datasets/pictures/contact_sheet.h"

#include <fmt/format.h>

namespace gld {

void draw_validation_sheet(const Validation& validation, const std::filesystem::path& file_without_ending) {
  std::vector<SheetSection> sections;
  for (const PictureRow& row : validation.rows) {
    SheetSection section;
    section.heading = row.name;
    for (const auto& [name, picture] : row.pictures) section.pictures.emplace_back(name, to_image(picture));
    sections.push_back(std::move(section));
  }
  SheetText text;
  text.title = file_without_ending.filename().string();
  for (const auto& [name, value] : validation.values) {
    text.subtitle += fmt::format("{}{} {:.4g}", text.subtitle.empty() ? "" : ", ", name, value);
  }
  SheetLimits limits;
  limits.picture = 160;
  write_png(file_without_ending.string() + ".png", make_picture_sheet(sections, text, limits));
}

}  // namespace gld
