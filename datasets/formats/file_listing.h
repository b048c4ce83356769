#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace gld {

// Puts "frame_2" before "frame_10": runs of digits compare as numbers.
bool natural_less(const std::string& a, const std::string& b);

// Return whether there is such a file or folder that can be looked at: not of a link that leads to itself, a name that
// is too long, or below a folder that may not be read, where the library's own functions throw.
bool is_file(const std::filesystem::path& path);
bool is_folder(const std::filesystem::path& path);

// Returns image files (datasets/images/image_format.h) directly in folder, in natural order; empty when there is no
// such folder.
std::vector<std::filesystem::path> list_images(const std::filesystem::path& folder);

// Returns files with that extension (".txt") directly in folder, in natural order.
std::vector<std::filesystem::path> list_files(const std::filesystem::path& folder,
                                              const std::string& extension);

// Returns the folders directly in folder, in natural order; hidden ones are left out.
std::vector<std::filesystem::path> list_folders(const std::filesystem::path& folder);

// Returns the last name of a path, also of "scene/" and ".".
std::string folder_name(const std::filesystem::path& folder);

bool is_image_name(const std::filesystem::path& file);

// Returns folder/stem with an ending of an image file, in small letters or capitals, whichever exists; empty when none
// does.
std::filesystem::path find_image(const std::filesystem::path& folder, const std::string& stem);

// Returns the folder of images to use: the one asked for (throws Error when it is not there), else "images", else the
// images_N with the smallest N that holds images; empty when there is none.
std::filesystem::path find_image_folder(const std::filesystem::path& scene, const std::string& asked_for);

// Returns file, if it lies at or below folder after following ".." in the text; throws Error otherwise. This keeps
// listed paths from reaching out of a scene.
std::filesystem::path inside(const std::filesystem::path& folder, const std::string& file,
                             const std::string& where);

}  // namespace gld
