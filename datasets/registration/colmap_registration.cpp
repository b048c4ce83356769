#include "datasets/registration/colmap_registration.h"

#include "datasets/formats/colmap_binary.h"
#include "datasets/formats/colmap_model.h"
#include "datasets/images/image_file.h"
#include "datasets/images/image_format.h"
#include "datasets/images/image_probe.h"
#include "datasets/registration/feature_registration.h"
#include "datasets/registration/registered_lenses.h"
#include "gld/base/atomic_file.h"
#include "gld/base/child_process.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/base/printable_text.h"
#include "gld/base/work_folder.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <fstream>
#include <map>
#include <optional>
#include <thread>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr int kJpegQuality = 97;

// Runs COLMAP's commands one after another.
class ColmapProgram {
 public:
  ColmapProgram(const ColmapRegistrationOptions& options, WorkFolder& folder, const std::string& where)
      : options_(options), folder_(folder), where_(where), start_(std::chrono::steady_clock::now()) {}

  void run(const std::string& command, const std::vector<std::string>& arguments) const {
    std::vector<std::string> words{options_.program.string(), command};
    words.insert(words.end(), arguments.begin(), arguments.end());
    ChildProcess process(words, folder_.log(), -1);
    while (!process.poll()) {
      stop_if_interrupted("while COLMAP registered photographs");
      const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - start_;
      if (taken.count() > options_.timeout) {
        fail({where_, fmt::format("COLMAP's {} to end within {:g} s", command, options_.timeout),
              "it still running; " + last_words(), "take fewer photographs, or --photo-cameras features"});
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    const int status = process.poll()->status;
    if (status == 0) return;
    fail({where_, "COLMAP's " + command + " to succeed",
          fmt::format("exit status {}; {}", status, last_words()),
          options_.keeps_failures ? "see there, or take --photo-cameras features"
                                  : "take --photo-cameras features"});
  }

  // Returns that option under the first of these names that the command's own help has, else under the last: COLMAP
  // 3.13 calls some otherwise than those before.
  std::string option_of(const std::string& command, const std::vector<std::string>& names) const {
    const std::filesystem::path file = folder_.path() / ("help_" + command + ".txt");
    if (!std::filesystem::exists(file)) {
      ChildProcess process({options_.program.string(), command, "--help"}, file, -1);
      while (!process.poll()) {
        stop_if_interrupted("while COLMAP registered photographs");
        const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - start_;
        if (taken.count() > options_.timeout) break;  // which the command itself will say
        std::this_thread::sleep_for(std::chrono::milliseconds(10));
      }
    }
    const std::string help = read_file(file);
    const auto known = std::find_if(names.begin(), names.end(), [&](const std::string& name) {
      return help.find(name) != std::string::npos;
    });
    return "--" + (known == names.end() ? names.back() : *known);
  }

 private:
  std::string last_words() const {
    if (options_.keeps_failures) {
      folder_.keep();
      return "what it printed is in " + folder_.log().string();
    }
    std::ifstream log(folder_.log());
    std::string last;
    for (std::string line; std::getline(log, line);) {
      if (line.find_first_not_of(" \t\r") != std::string::npos) last = line;
    }
    return last.empty() ? "it printed nothing" : "it printed at last: " + printable_text(last);
  }

  const ColmapRegistrationOptions& options_;
  WorkFolder& folder_;
  const std::string& where_;
  std::chrono::steady_clock::time_point start_;
};

// COLMAP takes pictures as they are stored; ours are upright.
std::string put_picture(const UnregisteredPhotograph& photograph, size_t number,
                        const std::filesystem::path& images) {
  const ImageFileInfo header = probe_image_file(photograph.file);
  std::ifstream stream(photograph.file, std::ios::binary);
  std::array<char, 16> start{};
  stream.read(start.data(), start.size());
  const auto format = image_format({start.data(), static_cast<size_t>(stream.gcount())});
  const bool as_it_is =
      header.orientation == 1 && (format == ImageFormat::kJpeg || format == ImageFormat::kPng);
  std::string name =
      fmt::format("{:06}{}", number, as_it_is && format == ImageFormat::kPng ? ".png" : ".jpg");
  if (as_it_is) {
    std::filesystem::create_symlink(std::filesystem::absolute(photograph.file), images / name);
  } else {
    write_jpeg(images / name, read_image(photograph.file, ImageOrientation::kUpright), kJpegQuality);
  }
  return name;
}

// Returns the model with most photographs; COLMAP writes several where they fall apart.
std::filesystem::path largest_model(const std::filesystem::path& folder) {
  std::filesystem::path largest;
  size_t most = 0;
  for (int number = 0;; ++number) {
    const auto model = folder / std::to_string(number);
    if (!std::filesystem::is_regular_file(model / "images.bin")) return largest;
    const size_t images = read_colmap_binary(model).images.size();
    if (images <= most) continue;
    most = images;
    largest = model;
  }
}

Eigen::Vector2d seen_by(const ColmapLens& lens, const Eigen::Vector3d& in_camera) {
  const Eigen::Vector2d p = distorted(lens.lens, in_camera.hnormalized());
  return {lens.intrinsics(0, 0) * p.x() + lens.intrinsics(0, 2),
          lens.intrinsics(1, 1) * p.y() + lens.intrinsics(1, 2)};
}

Registration read_registration(const std::filesystem::path& folder, const std::vector<std::string>& names,
                               const std::vector<UnregisteredPhotograph>& photographs) {
  Registration registration;
  registration.way = "colmap";
  registration.photographs.resize(photographs.size());
  for (RegisteredPhotograph& photograph : registration.photographs) {
    photograph.reason = "COLMAP finds no camera that fits with the others'";
  }
  if (folder.empty()) return registration;
  const ColmapModel model = read_colmap_model(folder, ColmapForm::kBinary);
  const ColmapSightings sightings = read_colmap_sightings(folder);
  for (const auto& [id, point] : sightings.points_in_world) registration.points_in_world.push_back(point);
  std::vector<double> depths;
  double all = 0;
  for (const ColmapImage& image : model.images) {
    const auto named = std::find(names.begin(), names.end(), image.name);
    if (named == names.end()) continue;
    RegisteredPhotograph& found = registration.photographs[static_cast<size_t>(named - names.begin())];
    const ColmapCamera& camera = model.cameras.at(image.camera_id);
    const ColmapLens lens = colmap_lens(camera, folder.string());
    Eigen::Isometry3d camera_from_world = Eigen::Isometry3d::Identity();
    camera_from_world.linear() = image.rotation.normalized().toRotationMatrix();
    camera_from_world.translation() = image.translation;
    found.registered = true;
    found.reason.clear();
    found.world_from_camera = camera_from_world.inverse();
    found.camera.width = camera.width;
    found.camera.height = camera.height;
    found.camera.intrinsics = lens.intrinsics;
    found.camera.lens = lens.lens;
    double square = 0;
    for (const ColmapSighting& sighting : sightings.images.at(image.name)) {
      const Eigen::Vector3d in_camera = camera_from_world * sightings.points_in_world.at(sighting.point);
      square += (seen_by(lens, in_camera) - sighting.position).squaredNorm();
      depths.push_back(in_camera.z());
      ++found.points;
    }
    all += square;
    found.reprojection_error = std::sqrt(square / static_cast<double>(std::max<int64_t>(1, found.points)));
  }
  if (!depths.empty()) registration.reprojection_error = std::sqrt(all / static_cast<double>(depths.size()));
  add_lenses(registration, photographs);
  normalise(registration, std::move(depths));
  return registration;
}

// Focal lengths to begin with, over the longer side, by lens: EXIF's, else what features find. COLMAP's own guess
// of 1.2 ends at any length where a few photographs of a wide lens are all there is.
struct FirstFocalLengths {
  std::map<int64_t, double> of_lens;
  std::vector<std::string> doubts;
};

FirstFocalLengths first_focal_lengths(const std::vector<UnregisteredPhotograph>& photographs,
                                      const ColmapRegistrationOptions& options, const std::string& where) {
  FirstFocalLengths first;
  bool unknown = false;
  for (const UnregisteredPhotograph& photograph : photographs) {
    const double exif = exif_focal_length(photographs, photograph.lens);
    if (exif > 0) first.of_lens[photograph.lens] = exif;
    unknown = unknown || exif == 0;
  }
  if (!unknown) return first;
  FeatureRegistrationOptions by_features;
  by_features.threads = options.threads;
  try {
    const Registration found = register_by_features(photographs, by_features, where);
    for (const RegisteredLens& lens : found.lenses) first.of_lens.emplace(lens.number, lens.focal_length);
    first.doubts = found.doubts;
  } catch (const Error&) {
    // Then COLMAP begins with its own guess.
    first.doubts.emplace_back("EXIF names no focal length, and features alone do not tell it");
  }
  return first;
}

}  // namespace

std::filesystem::path found_colmap() { return found_program("colmap"); }

Registration register_by_colmap(const std::vector<UnregisteredPhotograph>& photographs,
                                const ColmapRegistrationOptions& options, const std::string& where) {
  require_several(photographs, where);
  WorkFolder folder("colmap");
  const auto images = folder.path() / "images", models = folder.path() / "models";
  std::filesystem::create_directory(images);
  std::filesystem::create_directory(models);
  const std::string database = (folder.path() / "database.db").string();
  std::vector<std::string> names;
  for (size_t i = 0; i < photographs.size(); ++i) {
    names.push_back(put_picture(photographs[i], i, images));
  }
  const FirstFocalLengths first = first_focal_lengths(photographs, options, where);
  const ColmapProgram colmap(options, folder, where);
  const std::string threads = std::to_string(options.threads);
  const auto of_extraction = [&](const std::string& name) {
    return colmap.option_of("feature_extractor", {"FeatureExtraction." + name, "SiftExtraction." + name});
  };
  const auto of_matching = [&](const std::string& name) {
    return colmap.option_of("exhaustive_matcher", {"FeatureMatching." + name, "SiftMatching." + name});
  };
  // A camera of COLMAP's has one size: where photographs of one lens have several, each size has its own.
  std::map<std::array<int64_t, 3>, std::vector<size_t>> cameras;
  for (size_t i = 0; i < photographs.size(); ++i) {
    cameras[{photographs[i].lens, photographs[i].width, photographs[i].height}].push_back(i);
  }
  for (const auto& [camera, members] : cameras) {
    std::string list;
    for (const size_t i : members) list += names[i] + "\n";
    const auto file = folder.path() / "list.txt";
    write_file_atomically(file, list);
    std::vector<std::string> arguments{"--database_path",
                                       database,
                                       "--image_path",
                                       images.string(),
                                       "--image_list_path",
                                       file.string(),
                                       "--ImageReader.single_camera",
                                       "1",
                                       "--ImageReader.camera_model",
                                       "SIMPLE_RADIAL",
                                       of_extraction("use_gpu"),
                                       "0",
                                       of_extraction("num_threads"),
                                       threads};
    const UnregisteredPhotograph& photograph = photographs[members.front()];
    const auto focal_length = first.of_lens.find(photograph.lens);
    if (focal_length != first.of_lens.end()) {
      arguments.insert(arguments.end(),
                       {"--ImageReader.camera_params",
                        fmt::format("{:.6f},{},{},0", focal_length->second * photograph.longer_side(),
                                    static_cast<double>(photograph.width) / 2,
                                    static_cast<double>(photograph.height) / 2)});
    }
    colmap.run("feature_extractor", arguments);
  }
  colmap.run("exhaustive_matcher",
             {"--database_path", database, of_matching("use_gpu"), "0", of_matching("num_threads"), threads});
  // A handful of photographs shares fewer points, under smaller angles, than COLMAP asks of collections.
  colmap.run("mapper", {"--database_path",
                        database,
                        "--image_path",
                        images.string(),
                        "--output_path",
                        models.string(),
                        "--Mapper.num_threads",
                        threads,
                        "--Mapper.min_model_size",
                        "2",
                        "--Mapper.init_min_tri_angle",
                        "4",
                        "--Mapper.init_min_num_inliers",
                        "40",
                        "--Mapper.abs_pose_min_num_inliers",
                        "20",
                        "--Mapper.tri_min_angle",
                        "0.75",
                        "--Mapper.filter_min_tri_angle",
                        "0.75"});
  const std::filesystem::path model = largest_model(models);
  // The mapper's fifty iterations may end half way where two photographs have to tell a lens: on one pair of real ones
  // at a focal length 15 % too long, depending on the order in which its threads found points.
  if (!model.empty()) {
    colmap.run("bundle_adjuster", {"--input_path", model.string(), "--output_path", model.string(),
                                   "--BundleAdjustment.max_num_iterations", "500",
                                   "--BundleAdjustment.function_tolerance", "1e-9"});
  }
  Registration registration = read_registration(model, names, photographs);
  require_registered(registration, photographs, where);
  add_doubts(registration);
  registration.doubts.insert(registration.doubts.end(), first.doubts.begin(), first.doubts.end());
  return registration;
}

}  // namespace gld
