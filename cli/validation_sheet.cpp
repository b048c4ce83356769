#include "cli/validation_sheet.h"

#include "datasets/batching.h"
#include "datasets/image_file.h"
#include "infer/contact_sheet.h"

#include <fmt/format.h>

namespace gld {
namespace {

// Pictures of a row whose name is "image" or "source" are given; the others are what the model made.
bool is_given(const std::string& name) { return name == "image" || name == "source"; }

}  // namespace

void draw_validation_sheet(const Validation& validation, const std::filesystem::path& file_without_ending) {
  std::vector<SheetView> views;
  for (const PictureRow& row : validation.rows) {
    for (const auto& [name, picture] : row.pictures) {
      SheetView view;
      view.name = name;
      view.note = row.name;
      view.role = is_given(name) ? SheetRole::kSource : SheetRole::kTarget;
      view.image = to_image(picture);
      views.push_back(std::move(view));
    }
  }
  SheetText text;
  text.title = file_without_ending.filename().string();
  for (const auto& [name, value] : validation.values) {
    text.subtitle += fmt::format("{}{} {:.4g}", text.subtitle.empty() ? "" : ", ", name, value);
  }
  SheetLimits limits;
  limits.picture = 160;
  write_png(file_without_ending.string() + ".png", make_contact_sheet(views, text, limits));
}

}  // namespace gld
