#include "datasets/formats/file_listing.h"

#include "datasets/images/image_format.h"
#include "gld/base/error.h"

#include <algorithm>
#include <cctype>
#include <cstdlib>

namespace gld {
namespace {

bool is_digit(char c) { return std::isdigit(static_cast<unsigned char>(c)) != 0; }

std::string lower(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return text;
}

std::string upper(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](unsigned char c) { return static_cast<char>(std::toupper(c)); });
  return text;
}

template <class Accept>
std::vector<std::filesystem::path> listed(const std::filesystem::path& folder, const Accept& accept) {
  std::vector<std::filesystem::path> found;
  std::error_code error;
  for (std::filesystem::directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    if (entry->path().filename().string().front() != '.' && accept(*entry)) found.push_back(entry->path());
  }
  std::sort(found.begin(), found.end(), [](const std::filesystem::path& a, const std::filesystem::path& b) {
    return natural_less(a.filename().string(), b.filename().string());
  });
  return found;
}

}  // namespace

bool is_file(const std::filesystem::path& path) {
  std::error_code error;
  return std::filesystem::is_regular_file(path, error);
}

bool is_folder(const std::filesystem::path& path) {
  std::error_code error;
  return std::filesystem::is_directory(path, error);
}

bool natural_less(const std::string& a, const std::string& b) {
  size_t i = 0;
  size_t j = 0;
  while (i < a.size() && j < b.size()) {
    if (!is_digit(a[i]) || !is_digit(b[j])) {
      if (a[i] != b[j]) return a[i] < b[j];
      ++i;
      ++j;
      continue;
    }
    size_t a_end = i;
    size_t b_end = j;
    while (a_end < a.size() && is_digit(a[a_end])) ++a_end;
    while (b_end < b.size() && is_digit(b[b_end])) ++b_end;
    while (i + 1 < a_end && a[i] == '0') ++i;
    while (j + 1 < b_end && b[j] == '0') ++j;
    if (a_end - i != b_end - j) return a_end - i < b_end - j;
    const int order = a.compare(i, a_end - i, b, j, b_end - j);
    if (order != 0) return order < 0;
    i = a_end;
    j = b_end;
  }
  if (a.size() - i != b.size() - j) return a.size() - i < b.size() - j;
  return a < b;  // equal as numbers: leading zeros decide, so that the order is total
}

std::string folder_name(const std::filesystem::path& folder) {
  const auto absolute = std::filesystem::absolute(folder).lexically_normal();
  return (absolute.has_filename() ? absolute : absolute.parent_path()).filename().string();
}

bool is_image_name(const std::filesystem::path& file) {
  const std::string extension = lower(file.extension().string());
  const auto& extensions = image_extensions();
  return std::find(extensions.begin(), extensions.end(), extension) != extensions.end();
}

std::vector<std::filesystem::path> list_images(const std::filesystem::path& folder) {
  return listed(folder, [](const std::filesystem::directory_entry& entry) {
    return is_image_name(entry.path()) && is_file(entry.path());
  });
}

std::vector<std::filesystem::path> list_files(const std::filesystem::path& folder,
                                              const std::string& extension) {
  return listed(folder, [&](const std::filesystem::directory_entry& entry) {
    return entry.path().extension() == extension && is_file(entry.path());
  });
}

std::vector<std::filesystem::path> list_folders(const std::filesystem::path& folder) {
  return listed(folder,
                [](const std::filesystem::directory_entry& entry) { return is_folder(entry.path()); });
}

std::filesystem::path find_image(const std::filesystem::path& folder, const std::string& stem) {
  for (const auto& change : {lower, upper}) {
    for (const std::string& extension : image_extensions()) {
      std::filesystem::path file = folder / (stem + change(extension));
      if (is_file(file)) return file;
    }
  }
  return {};
}

std::filesystem::path find_image_folder(const std::filesystem::path& scene, const std::string& asked_for) {
  if (!asked_for.empty()) {
    std::filesystem::path folder = inside(scene, asked_for, "--image-folder");
    if (!is_folder(folder)) {
      fail({folder.string(), "a folder of images", "nothing", "choose another --image-folder"});
    }
    return folder;
  }
  if (!list_images(scene / "images").empty()) return scene / "images";
  std::filesystem::path best;
  long best_downscale = 0;
  for (const auto& folder : list_folders(scene)) {
    const std::string name = folder.filename().string();
    if (name.rfind("images_", 0) != 0) continue;
    const long downscale = std::strtol(name.c_str() + 7, nullptr, 10);
    if (downscale <= 0 || (best_downscale != 0 && downscale >= best_downscale) ||
        list_images(folder).empty()) {
      continue;
    }
    best = folder;
    best_downscale = downscale;
  }
  return best;
}

std::filesystem::path inside(const std::filesystem::path& folder, const std::string& file,
                             const std::string& where) {
  const std::filesystem::path relative = std::filesystem::path(file).lexically_normal();
  if (file.empty() || file.find('\0') != std::string::npos || relative.is_absolute() ||
      (!relative.empty() && *relative.begin() == "..")) {
    fail({where, "a path inside the scene's folder", "\"" + file + "\"",
          "make the path relative to the scene"});
  }
  return folder / relative;
}

}  // namespace gld
