#include "gld/files/weight_file.h"

#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/mapped_file.h"
#include "gld/base/printable_text.h"
#include "gld/files/safetensors.h"
#include "gld/files/torch_archive.h"

#include <algorithm>
#include <array>
#include <limits>

namespace gld {
namespace {

constexpr size_t kLongestPrintedName = 120;
constexpr std::array<uint8_t, 4> kZipMagic = {'P', 'K', 3, 4};
constexpr uint8_t kPickleStart = 0x80;  // the PROTO opcode

}  // namespace

int64_t TensorEntry::element_count() const {
  int64_t count = 1;
  for (const int64_t size : shape) count *= size;
  return count;
}

int64_t TensorEntry::byte_count() const { return element_count() * byte_size(dtype); }

bool TensorEntry::contiguous() const {
  const auto expected = row_major_strides(shape);
  for (size_t axis = 0; axis < shape.size(); ++axis) {
    if (shape[axis] == 0) return true;
  }
  for (size_t axis = 0; axis < shape.size(); ++axis) {
    if (shape[axis] != 1 && strides[axis] != expected[axis]) return false;
  }
  return true;
}

int64_t checked_byte_count(const std::vector<int64_t>& shape, DType dtype) {
  int64_t bytes = byte_size(dtype);
  bool empty = false;
  for (const int64_t size : shape) {
    if (size < 0) return -1;
    if (size == 0) empty = true;
    // Checked even when another size is 0, so that no product of some of the sizes overflows elsewhere.
    if (size > 1 && bytes > std::numeric_limits<int64_t>::max() / size) return -1;
    bytes *= std::max<int64_t>(size, 1);
  }
  return empty ? 0 : bytes;
}

std::vector<int64_t> row_major_strides(const std::vector<int64_t>& shape) {
  std::vector<int64_t> strides(shape.size());
  int64_t stride = 1;
  for (size_t axis = shape.size(); axis-- > 0;) {
    strides[axis] = stride;
    stride *= std::max<int64_t>(shape[axis], 1);
  }
  return strides;
}

std::string shape_text(const std::vector<int64_t>& shape) {
  std::string text;
  for (const int64_t size : shape) text += (text.empty() ? "" : ", ") + std::to_string(size);
  return "(" + text + ")";
}

std::string printable_name(const std::string& name) { return printable_text(name, kLongestPrintedName); }

std::shared_ptr<const WeightFile> WeightFile::open(const std::filesystem::path& file) {
  const auto mapping = MappedFile::open(file);
  const ByteView bytes = mapping->bytes();
  const std::string where = file.string();
  std::shared_ptr<WeightFile> weights(new WeightFile);
  weights->path_ = file;
  ParsedWeights parsed;
  if (bytes.size > 8 && bytes.data[8] == '{') {
    weights->format_ = "safetensors";
    parsed = parse_safetensors(bytes, where);
  } else if (bytes.size > kZipMagic.size() && std::equal(kZipMagic.begin(), kZipMagic.end(), bytes.data)) {
    weights->format_ = "PyTorch zip";
    parsed = parse_torch_zip(bytes, where);
    mapping->drop_pages(bytes);  // read once for its checksums, not needed in memory yet
  } else if (bytes.size > 1 && bytes.data[0] == kPickleStart) {
    weights->format_ = "PyTorch legacy";
    parsed = parse_torch_legacy(bytes, where);
  } else {
    fail({where, "a safetensors or PyTorch file", "neither by its first bytes",
          "check that the download is complete and is not a web page or a Git LFS pointer"});
  }
  weights->entries_ = std::move(parsed.entries);
  weights->scalars_ = std::move(parsed.scalars);
  weights->metadata_ = std::move(parsed.metadata);
  weights->owners_ = std::move(parsed.owners);
  weights->mapping_ = mapping;
  return weights;
}

void WeightFile::drop_pages(const TensorEntry& entry) const {
  if (entry.contiguous()) mapping_->drop_pages({entry.data, static_cast<size_t>(entry.byte_count())});
}

const TensorEntry* WeightFile::find(const std::string& name) const {
  const auto found =
      std::lower_bound(entries_.begin(), entries_.end(), name,
                       [](const TensorEntry& entry, const std::string& key) { return entry.name < key; });
  return found != entries_.end() && found->name == name ? &*found : nullptr;
}

const TensorEntry& WeightFile::entry(const std::string& name) const {
  if (const auto* found = find(name)) return *found;
  std::vector<std::string> names;
  names.reserve(entries_.size());
  for (const auto& entry : entries_) names.push_back(entry.name);
  const auto similar = nearest_name(name, names);
  fail(
      {path_.string(), "a tensor named " + printable_name(name), "none",
       similar.empty() ? "list the file with gld inspect" : "did you mean " + printable_name(similar) + "?"});
}

}  // namespace gld
