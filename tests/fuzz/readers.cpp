#include "tests/fuzz/readers.h"

#include "datasets/formats/cameras_json.h"
#include "datasets/formats/colmap_model.h"
#include "datasets/formats/re10k_reader.h"
#include "datasets/images/image_file.h"
#include "datasets/video/video_stream.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/files/hdf5_array.h"
#include "gld/files/npy.h"
#include "gld/files/safetensors.h"
#include "gld/files/torch_archive.h"
#include "gld/files/zip_archive.h"

#include <array>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include <unistd.h>

namespace gld::test {
namespace {

const std::string kWhere = "fuzzed file";

// Reads each element through the strides, as a copy would.
uint64_t touch(const TensorEntry& entry) {
  uint64_t sum = 0;
  std::vector<int64_t> index(entry.shape.size(), 0);
  for (int64_t left = entry.element_count(); left > 0; --left) {
    int64_t offset = 0;
    for (size_t axis = 0; axis < index.size(); ++axis) offset += index[axis] * entry.strides[axis];
    const int64_t size = byte_size(entry.dtype);
    for (int64_t byte = 0; byte < size; ++byte) sum += entry.data[offset * size + byte];
    for (size_t axis = index.size(); axis-- > 0;) {
      if (++index[axis] < entry.shape[axis]) break;
      index[axis] = 0;
    }
  }
  return sum;
}

void touch(const ParsedWeights& parsed) {
  volatile uint64_t sum = 0;
  for (const auto& entry : parsed.entries) sum = sum + touch(entry);
}

// A folder in memory for readers that take paths, removed at the end of the process.
class Scratch {
 public:
  Scratch() {
    std::error_code error;
    const std::filesystem::path memory = "/dev/shm";
    const auto base =
        std::filesystem::is_directory(memory, error) ? memory : std::filesystem::temp_directory_path();
    folder_ = base / ("gld_fuzz_" + std::to_string(::getpid()));
    std::filesystem::create_directories(folder_);
  }
  ~Scratch() {
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
  }
  Scratch(const Scratch&) = delete;
  Scratch& operator=(const Scratch&) = delete;

  const std::filesystem::path& folder() const { return folder_; }
  std::filesystem::path write(const std::string& name, const uint8_t* data, size_t size) const {
    std::ofstream stream(folder_ / name, std::ios::binary | std::ios::trunc);
    if (size > 0) stream.write(reinterpret_cast<const char*>(data), static_cast<std::streamsize>(size));
    return folder_ / name;
  }

 private:
  std::filesystem::path folder_;
};

const Scratch& scratch() {
  static const Scratch folder;
  return folder;
}

struct InnerOptions : OptionsGroup {
  int64_t count = 1;
  void visit(FieldVisitor& visitor) override { visitor.integer({"count", "a count"}, count, {0, 10}); }
};

struct AnyOptions : OptionsGroup {
  bool flag = false;
  int64_t integer = 0;
  double real = 0;
  std::string text;
  int choice = 0;
  std::vector<int64_t> integers;
  std::vector<double> reals;
  std::vector<std::string> texts;
  InnerOptions inner;

  void visit(FieldVisitor& visitor) override {
    visitor.boolean({"flag", "a flag"}, flag);
    visitor.integer({"integer", "an integer"}, integer, {-5, 5});
    visitor.real({"real", "a number"}, real, {-5, 5});
    visitor.text({"text", "a text"}, text);
    visitor.choice({"choice", "a choice"}, choice, {"first", "second"});
    visitor.integers({"integers", "integers"}, integers);
    visitor.reals({"reals", "numbers"}, reals);
    visitor.texts({"texts", "texts"}, texts);
    visitor.group({"inner", "a group"}, inner);
  }
};

}  // namespace

void read_as_safetensors(const uint8_t* data, size_t size) {
  try {
    touch(parse_safetensors({data, size}, kWhere));
  } catch (const Error&) {
    return;
  }
}

void read_as_torch_archive(const uint8_t* data, size_t size) {
  try {
    const bool zip = size > 0 && data[0] == 'P';
    touch(zip ? parse_torch_zip({data, size}, kWhere) : parse_torch_legacy({data, size}, kWhere));
  } catch (const Error&) {
    return;
  }
}

void read_as_npy(const uint8_t* data, size_t size) {
  try {
    if (size > 0 && data[0] == 'P') {
      const auto archive = ZipArchive::parse({data, size}, kWhere);
      for (const auto& entry : archive->entries()) {
        const auto bytes = archive->read(entry);
        parse_npy({bytes.data(), bytes.size()}, kWhere).to_doubles();
      }
      return;
    }
    const auto array = parse_npy({data, size}, kWhere);
    array.to_floats();
    array.to_doubles();
    npy_text(array);
  } catch (const Error&) {
    return;
  }
}

void read_as_hdf5(const uint8_t* data, size_t size) {
  try {
    constexpr int64_t kMostElements = 1 << 20;
    const Hdf5Array array = parse_hdf5_array({data, size}, "dataset", kMostElements, kWhere);
    volatile float sum = 0;
    for (const float value : array.values) sum = sum + value;
  } catch (const Error&) {
    return;
  }
}

void read_as_json(const uint8_t* data, size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  try {
    const auto parsed = parse_json(text, kWhere);
    json_text(parsed);
    AnyOptions options;
    load_json(options, parsed, kWhere);
  } catch (const Error&) {
    // Another kind of JSON.
  }
  try {
    cameras_json_text(read_cameras_json(scratch().write("cameras.json", data, size)));
  } catch (const Error&) {
    return;
  }
}

void read_as_yaml(const uint8_t* data, size_t size) {
  try {
    AnyOptions options, again;
    load_yaml_text(options, std::string(reinterpret_cast<const char*>(data), size), kWhere);
    load_yaml_text(again, to_yaml(options), kWhere);
  } catch (const Error&) {
    return;
  }
}

void read_as_image(const uint8_t* data, size_t size) {
  const auto file = scratch().write("image", data, size);
  try {
    read_image(file, ImageOrientation::kUpright);
  } catch (const Error&) {
    // Perhaps it is depth.
  }
  try {
    read_depth_png(file, 1e-3);
  } catch (const Error&) {
    return;
  }
}

void read_as_colmap(const uint8_t* data, size_t size) {
  if (size == 0) return;
  static const std::array<const char*, 3> stems{"cameras", "images", "points3D"};
  const bool binary = data[0] % 6 < 3;
  const size_t changed = data[0] % 3;
  const std::string ending = binary ? ".bin" : ".txt";
  const std::vector<uint8_t> none(binary ? 8 : 0, 0);  // no records
  for (size_t i = 0; i < stems.size(); ++i) {
    scratch().write(stems[i] + ending, i == changed ? data + 1 : none.data(),
                    i == changed ? size - 1 : none.size());
  }
  try {
    const auto model =
        read_colmap_model(scratch().folder(), binary ? ColmapForm::kBinary : ColmapForm::kText);
    for (const auto& [id, camera] : model.cameras) colmap_lens(camera, kWhere);
  } catch (const Error&) {
    return;
  }
}

void read_as_re10k(const uint8_t* data, size_t size) {
  try {
    read_re10k_rows(scratch().write("clip.txt", data, size));
  } catch (const Error&) {
    return;
  }
}

void read_as_ffprobe(const uint8_t* data, size_t size) {
  try {
    const VideoStream stream =
        parse_video_stream(std::string(reinterpret_cast<const char*>(data), size), kWhere);
    // The times of pictures are computed with these.
    if (!(stream.seconds > 0) || !(stream.pictures_a_second > 0)) std::abort();
    if (!std::isfinite(stream.seconds / stream.pictures_a_second * 1000)) std::abort();
  } catch (const Error&) {
    return;
  }
}

}  // namespace gld::test
