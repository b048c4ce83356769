#include "gld/files/npy.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/files/weight_file.h"
#include "gld/files/zip_archive.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <optional>

namespace gld {
namespace {

const std::string kMagic = "\x93NUMPY";
constexpr size_t kPrefixSize = 8;  // magic and version
constexpr size_t kLongestHeader = 65536;
constexpr size_t kNpyAlignment = 64;
const std::string kExtension = ".npy";

struct NamedType {
  const char* code;  // kind and bytes
  DType dtype;
};

constexpr NamedType kTypes[] = {{"f8", DType::kFloat64}, {"f4", DType::kFloat32}, {"f2", DType::kFloat16},
                                {"i8", DType::kInt64},   {"i4", DType::kInt32},   {"i2", DType::kInt16},
                                {"i1", DType::kInt8},    {"u8", DType::kUInt64},  {"u4", DType::kUInt32},
                                {"u2", DType::kUInt16},  {"u1", DType::kUInt8},   {"b1", DType::kBool}};

struct Header {
  std::string descr;
  bool fortran_order = false;
  std::vector<int64_t> shape;
};

// The header is a Python dictionary literal with exactly three keys; anything else is refused.
class HeaderParser {
 public:
  HeaderParser(std::string text, std::string where) : text_(std::move(text)), where_(std::move(where)) {}

  Header parse() {
    Header header;
    bool has_descr = false, has_order = false, has_shape = false;
    expect('{');
    while (!accept('}')) {
      const std::string key = quoted();
      expect(':');
      if (key == "descr" && !has_descr) {
        skip_spaces();
        if (position_ < text_.size() && (text_[position_] == '[' || text_[position_] == '(')) {
          fail({where_, "an array of numbers", "an array of records",
                "save its fields as arrays of their own"});
        }
        header.descr = quoted();
        has_descr = true;
      } else if (key == "fortran_order" && !has_order) {
        header.fortran_order = truth();
        has_order = true;
      } else if (key == "shape" && !has_shape) {
        header.shape = tuple();
        has_shape = true;
      } else {
        fail_broken();
      }
      if (!accept(',')) {
        expect('}');
        break;
      }
    }
    skip_spaces();
    if (position_ != text_.size() || !has_descr || !has_order || !has_shape) fail_broken();
    return header;
  }

 private:
  [[noreturn]] void fail_broken() const {
    fail({where_, "a header with descr, fortran_order and shape", printable_name(text_),
          "save the array again"});
  }

  void skip_spaces() {
    while (position_ < text_.size() && (text_[position_] == ' ' || text_[position_] == '\n')) ++position_;
  }

  bool accept(char character) {
    skip_spaces();
    if (position_ == text_.size() || text_[position_] != character) return false;
    ++position_;
    return true;
  }

  void expect(char character) {
    if (!accept(character)) fail_broken();
  }

  std::string quoted() {
    skip_spaces();
    if (position_ == text_.size() || (text_[position_] != '\'' && text_[position_] != '"')) fail_broken();
    const size_t end = text_.find(text_[position_], position_ + 1);
    if (end == std::string::npos) fail_broken();
    std::string value = text_.substr(position_ + 1, end - position_ - 1);
    position_ = end + 1;
    return value;
  }

  bool truth() {
    skip_spaces();
    for (const bool value : {true, false}) {
      const std::string word = value ? "True" : "False";
      if (text_.compare(position_, word.size(), word) == 0) {
        position_ += word.size();
        return value;
      }
    }
    fail_broken();
  }

  int64_t integer() {
    skip_spaces();
    int64_t value = 0;
    const size_t start = position_;
    while (position_ < text_.size() && text_[position_] >= '0' && text_[position_] <= '9') {
      if (value > (std::numeric_limits<int64_t>::max() - 9) / 10) {
        fail({where_, "sizes that fit 63 bits", "a larger one", "save the array again"});
      }
      value = 10 * value + (text_[position_++] - '0');
    }
    if (position_ == start) fail_broken();
    if (position_ < text_.size() && text_[position_] == 'L') ++position_;  // Python 2's long integers
    return value;
  }

  std::vector<int64_t> tuple() {
    std::vector<int64_t> values;
    expect('(');
    while (!accept(')')) {
      if (values.size() == kMaximumRank) fail_broken();
      values.push_back(integer());
      if (!accept(',')) {
        expect(')');
        break;
      }
    }
    return values;
  }

  std::string text_;
  std::string where_;
  size_t position_ = 0;
};

DType dtype_of(const std::string& descr, const std::string& where, bool& swapped) {
  for (const auto& type : kTypes) {
    if (descr.size() == 3 && descr.compare(1, 2, type.code) == 0 &&
        std::strchr("<>|=", descr[0]) != nullptr) {
      swapped = descr[0] == '>' && byte_size(type.dtype) > 1;
      return type.dtype;
    }
  }
  fail({where, "an array of real numbers, integers or booleans", "NumPy type " + printable_name(descr),
        "save the array with another dtype"});
}

void swap_bytes(std::vector<uint8_t>& bytes, size_t size) {
  for (size_t start = 0; start + size <= bytes.size(); start += size) {
    std::reverse(bytes.begin() + static_cast<std::ptrdiff_t>(start),
                 bytes.begin() + static_cast<std::ptrdiff_t>(start + size));
  }
}

std::vector<uint8_t> row_major_from_fortran(const uint8_t* data, const std::vector<int64_t>& shape,
                                            size_t count, size_t size) {
  std::vector<uint8_t> bytes(count * size);
  std::vector<int64_t> index(shape.size(), 0);
  const auto strides = row_major_strides(shape);
  int64_t target = 0;
  for (size_t element = 0; element < count; ++element) {
    std::memcpy(bytes.data() + static_cast<size_t>(target) * size, data + element * size, size);
    for (size_t axis = 0; axis < shape.size(); ++axis) {
      target += strides[axis];
      if (++index[axis] < shape[axis]) break;
      target -= strides[axis] * shape[axis];
      index[axis] = 0;
    }
  }
  return bytes;
}

template <class T>
T element(const NpyArray& array, size_t index) {
  T value;
  std::memcpy(&value, array.bytes.data() + index * sizeof(T), sizeof(T));
  return value;
}

// Calls visit(value) with every element in its own type.
template <class Visit>
void for_each(const NpyArray& array, Visit visit) {
  const auto count = static_cast<size_t>(array.element_count());
  for (size_t i = 0; i < count; ++i) {
    switch (array.dtype) {
      case DType::kFloat64:
        visit(element<double>(array, i));
        break;
      case DType::kFloat32:
        visit(element<float>(array, i));
        break;
      case DType::kFloat16:
        visit(float_from_half(element<uint16_t>(array, i)));
        break;
      case DType::kBFloat16:
        visit(float_from_bfloat16(element<uint16_t>(array, i)));
        break;
      case DType::kInt64:
        visit(element<int64_t>(array, i));
        break;
      case DType::kInt32:
        visit(element<int32_t>(array, i));
        break;
      case DType::kInt16:
        visit(element<int16_t>(array, i));
        break;
      case DType::kInt8:
        visit(element<int8_t>(array, i));
        break;
      case DType::kUInt64:
        visit(element<uint64_t>(array, i));
        break;
      case DType::kUInt32:
        visit(element<uint32_t>(array, i));
        break;
      case DType::kUInt16:
        visit(element<uint16_t>(array, i));
        break;
      case DType::kUInt8:
        visit(element<uint8_t>(array, i));
        break;
      case DType::kBool:
        visit(static_cast<uint8_t>(array.bytes[i] != 0 ? 1 : 0));
        break;
    }
  }
}

template <class T>
NpyArray array_from(DType dtype, const std::vector<int64_t>& shape, const T* values) {
  NpyArray array;
  array.dtype = dtype;
  array.shape = shape;
  array.bytes.resize(static_cast<size_t>(array.element_count()) * sizeof(T));
  if (!array.bytes.empty()) std::memcpy(array.bytes.data(), values, array.bytes.size());
  return array;
}

void check_array_size(uint64_t bytes, uint64_t most_values, const std::string& where) {
  if (bytes <= kPrefixSize + sizeof(uint32_t) + kLongestHeader ||
      bytes - kPrefixSize - sizeof(uint32_t) - kLongestHeader <= most_values) {
    return;
  }
  fail({where, "an array of at most " + std::to_string(most_values) + " bytes", std::to_string(bytes),
        "check that it is the right file"});
}

std::string array_list(const std::vector<std::string>& names) {
  std::string text;
  for (const auto& name : names) text += (text.empty() ? "" : ", ") + printable_name(name);
  return text.empty() ? "no arrays" : text;
}

}  // namespace

int64_t NpyArray::element_count() const {
  int64_t count = 1;
  for (const int64_t size : shape) count *= size;
  return count;
}

std::vector<double> NpyArray::to_doubles() const {
  std::vector<double> values;
  values.reserve(static_cast<size_t>(element_count()));
  for_each(*this, [&](auto value) { values.push_back(static_cast<double>(value)); });
  return values;
}

std::vector<float> NpyArray::to_floats() const {
  std::vector<float> values;
  values.reserve(static_cast<size_t>(element_count()));
  for_each(*this, [&](auto value) { values.push_back(static_cast<float>(value)); });
  return values;
}

NpyArray npy_from_floats(const std::vector<int64_t>& shape, const float* values) {
  return array_from(DType::kFloat32, shape, values);
}

NpyArray npy_from_doubles(const std::vector<int64_t>& shape, const double* values) {
  return array_from(DType::kFloat64, shape, values);
}

NpyArray parse_npy(ByteView file, const std::string& where) {
  if (file.size < kPrefixSize + 2 || std::memcmp(file.data, kMagic.data(), kMagic.size()) != 0) {
    fail({where, "a NumPy array file", "other bytes at its start", "save the array with numpy.save"});
  }
  const int version = file.data[kMagic.size()];
  if (version < 1 || version > 3) {
    fail({where, "a NumPy file of version 1 to 3", "version " + std::to_string(version),
          "save the array again"});
  }
  const size_t length_bytes = version == 1 ? 2 : 4;
  if (file.size < kPrefixSize + length_bytes) {
    fail({where, "a whole NumPy file", "only " + std::to_string(file.size) + " bytes",
          "save the array again"});
  }
  uint32_t length = 0;
  std::memcpy(&length, file.data + kPrefixSize, length_bytes);
  const size_t start = kPrefixSize + length_bytes;
  if (length > kLongestHeader || length > file.size - start) {
    fail({where, "a header within the file and of at most " + std::to_string(kLongestHeader) + " bytes",
          std::to_string(length) + " bytes", "save the array again"});
  }
  const Header header =
      HeaderParser(std::string(reinterpret_cast<const char*>(file.data + start), length), where).parse();
  NpyArray array;
  bool swapped = false;
  array.dtype = dtype_of(header.descr, where, swapped);
  array.shape = header.shape;
  const int64_t bytes = checked_byte_count(array.shape, array.dtype);
  const size_t available = file.size - start - length;
  if (bytes < 0 || static_cast<uint64_t>(bytes) != available) {
    fail({where,
          (bytes < 0 ? "a size that fits 63 bits" : std::to_string(bytes) + " bytes") + " for shape " +
              shape_text(array.shape) + " in " + dtype_name(array.dtype),
          std::to_string(available) + " bytes of data", "save the array again, the file may be truncated"});
  }
  const uint8_t* data = file.data + start + length;
  const auto size = static_cast<size_t>(byte_size(array.dtype));
  if (header.fortran_order && array.shape.size() > 1) {
    array.bytes = row_major_from_fortran(data, array.shape, available / size, size);
  } else {
    array.bytes.assign(data, data + available);
  }
  if (swapped) swap_bytes(array.bytes, size);
  return array;
}

NpyArray read_npy(const std::filesystem::path& file, uint64_t most_bytes) {
  const auto mapping = MappedFile::open(file);
  check_array_size(mapping->bytes().size, most_bytes, file.string());
  return parse_npy(mapping->bytes(), file.string());
}

std::string npy_text(const NpyArray& array) {
  std::string code;
  for (const auto& type : kTypes) {
    if (type.dtype == array.dtype) code = type.code;
  }
  if (code.empty()) {
    fail({"NumPy file", "a dtype that NumPy has", dtype_name(array.dtype),
          "convert the array to float32 first"});
  }
  std::string shape;
  for (const int64_t size : array.shape) shape += std::to_string(size) + ", ";
  if (array.shape.size() > 1) shape.resize(shape.size() - 2);
  if (array.shape.size() == 1) shape.pop_back();
  std::string header = "{'descr': '" + std::string(byte_size(array.dtype) == 1 ? "|" : "<") + code +
                       "', 'fortran_order': False, 'shape': (" + shape + "), }";
  const size_t unpadded = kPrefixSize + 2 + header.size() + 1;
  header.append((kNpyAlignment - unpadded % kNpyAlignment) % kNpyAlignment, ' ');
  header += '\n';
  std::string text = kMagic + std::string("\x01\x00", 2);
  const auto length = static_cast<uint16_t>(header.size());
  text.append(reinterpret_cast<const char*>(&length), sizeof length);
  text += header;
  text.append(reinterpret_cast<const char*>(array.bytes.data()), array.bytes.size());
  return text;
}

void write_npy(const std::filesystem::path& file, const NpyArray& array) {
  write_file_atomically(file, npy_text(array));
}

NpzFile NpzFile::open(const std::filesystem::path& file) {
  NpzFile npz;
  npz.path_ = file;
  npz.archive_ = ZipArchive::open(file);
  for (const auto& entry : npz.archive_->entries()) {
    const auto& name = entry.name;
    if (name.size() > kExtension.size() &&
        name.compare(name.size() - kExtension.size(), kExtension.size(), kExtension) == 0) {
      npz.names_.push_back(name.substr(0, name.size() - kExtension.size()));
    }
  }
  return npz;
}

bool NpzFile::has(const std::string& name) const {
  return std::find(names_.begin(), names_.end(), name) != names_.end();
}

NpyArray NpzFile::read(const std::string& name, uint64_t most_bytes) const {
  const auto* entry = archive_->find(name + kExtension);
  if (entry == nullptr) {
    fail({path_.string(), "an array named " + printable_name(name), array_list(names_), "check the file"});
  }
  const std::string where = path_.string() + ": array " + printable_name(name);
  check_array_size(entry->size, most_bytes, where);
  const auto bytes = archive_->read(*entry);
  return parse_npy({bytes.data(), bytes.size()}, where);
}

void write_npz(const std::filesystem::path& file, const std::map<std::string, NpyArray>& arrays) {
  std::map<std::string, std::string> entries;
  for (const auto& [name, array] : arrays) entries[name + kExtension] = npy_text(array);
  write_zip(file, entries, ZipMethod::kStored);
}

}  // namespace gld
