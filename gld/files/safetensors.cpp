#include "gld/files/safetensors.h"

#include "gld/base/error.h"
#include "gld/files/dtype.h"

#include <algorithm>
#include <cstring>
#include <optional>
#include <utility>

#include <nlohmann/json.hpp>

namespace gld {
namespace {

using nlohmann::json;

constexpr size_t kLengthBytes = 8;
constexpr size_t kSafetensorsAlignment = 64;

const std::vector<std::pair<const char*, DType>>& dtype_codes() {
  static const std::vector<std::pair<const char*, DType>> codes = {
      {"F64", DType::kFloat64},   {"F32", DType::kFloat32}, {"F16", DType::kFloat16},
      {"BF16", DType::kBFloat16}, {"I64", DType::kInt64},   {"I32", DType::kInt32},
      {"I16", DType::kInt16},     {"I8", DType::kInt8},     {"U64", DType::kUInt64},
      {"U32", DType::kUInt32},    {"U16", DType::kUInt16},  {"U8", DType::kUInt8},
      {"BOOL", DType::kBool}};
  return codes;
}

std::optional<DType> dtype_from_code(const std::string& code) {
  for (const auto& [name, dtype] : dtype_codes()) {
    if (code == name) return dtype;
  }
  return std::nullopt;
}

struct HeaderTensor {
  std::string name;
  std::string dtype;
  std::vector<uint64_t> shape;
  std::vector<uint64_t> offsets;
  bool has_dtype = false;
  bool has_shape = false;
  bool has_offsets = false;
};

// Accepts exactly {"name": {"dtype": "...", "shape": [...], "data_offsets": [a, b]}, "__metadata__": {"k":
// "v"}} and stops at the first event that does not belong there, so that nothing is built from a hostile
// header.
class HeaderReader : public nlohmann::json_sax<json> {
 public:
  explicit HeaderReader(std::string where) : where_(std::move(where)) {}

  std::vector<HeaderTensor> tensors;
  std::map<std::string, std::string> metadata;

  bool null() override { return unexpected("null"); }
  bool boolean(bool) override { return unexpected("a boolean"); }
  bool number_integer(number_integer_t) override { return unexpected("a negative number"); }
  bool number_float(number_float_t, const string_t&) override { return unexpected("a fractional number"); }
  bool binary(binary_t&) override { return unexpected("binary data"); }

  bool number_unsigned(number_unsigned_t value) override {
    if (state_ != State::kArray) return unexpected("a number");
    auto& numbers = field_ == "shape" ? tensors.back().shape : tensors.back().offsets;
    if (numbers.size() == kMaximumRank) return unexpected("more than 64 numbers");
    numbers.push_back(value);
    return true;
  }

  bool string(string_t& value) override {
    if (state_ == State::kMetadata) {
      metadata[field_] = value;
      return true;
    }
    if (state_ != State::kTensor || field_ != "dtype") return unexpected("a string");
    tensors.back().dtype = value;
    tensors.back().has_dtype = true;
    return true;
  }

  bool start_object(std::size_t) override {
    if (state_ == State::kOutside) {
      state_ = State::kTop;
    } else if (state_ == State::kTop) {
      state_ = name_ == "__metadata__" ? State::kMetadata : State::kTensor;
      if (state_ == State::kTensor) {
        tensors.emplace_back();
        tensors.back().name = name_;
      }
    } else {
      return unexpected("an object");
    }
    return true;
  }

  bool key(string_t& value) override {
    if (state_ == State::kTop) {
      name_ = value;
    } else {
      field_ = value;
    }
    if (state_ == State::kTensor && value != "dtype" && value != "shape" && value != "data_offsets") {
      return unexpected("the key " + printable_name(value));
    }
    return true;
  }

  bool end_object() override {
    if (state_ == State::kTensor) {
      const auto& tensor = tensors.back();
      if (!tensor.has_dtype || !tensor.has_shape || !tensor.has_offsets)
        return unexpected("one of them missing");
    }
    state_ = state_ == State::kTop ? State::kOutside : State::kTop;
    return true;
  }

  bool start_array(std::size_t) override {
    if (state_ != State::kTensor || field_ == "dtype") return unexpected("a list");
    auto& seen = field_ == "shape" ? tensors.back().has_shape : tensors.back().has_offsets;
    if (seen) return unexpected("the key " + field_ + " twice");
    seen = true;
    state_ = State::kArray;
    return true;
  }

  bool end_array() override {
    state_ = State::kTensor;
    return true;
  }

  bool parse_error(std::size_t position, const std::string&, const nlohmann::detail::exception&) override {
    fail({where_, "a JSON header", "broken JSON at byte " + std::to_string(position) + " of the header",
          "download or write the file again"});
  }

 private:
  enum class State { kOutside, kTop, kTensor, kMetadata, kArray };

  bool unexpected(const std::string& found) const {
    switch (state_) {
      case State::kOutside:
        fail({where_, "a JSON object as the header", found, "download or write the file again"});
      case State::kTop:
        fail({where_ + ": tensor " + printable_name(name_), "an object with dtype, shape and data_offsets",
              found, "download or write the file again"});
      case State::kMetadata:
        fail({where_ + ": __metadata__", "only strings", found, "write the file again with string metadata"});
      case State::kTensor:
      case State::kArray:
        break;
    }
    fail({where_ + ": tensor " + printable_name(name_),
          "dtype, shape and data_offsets (non-negative integers)", found,
          "download or write the file again"});
  }

  std::string where_;
  State state_ = State::kOutside;
  std::string name_;
  std::string field_;
};

TensorEntry checked_entry(const HeaderTensor& tensor, ByteView data, const std::string& file) {
  const std::string where = file + ": tensor " + printable_name(tensor.name);
  TensorEntry entry;
  entry.name = tensor.name;
  const auto dtype = dtype_from_code(tensor.dtype);
  if (!dtype) {
    fail({where, "a dtype among F64, F32, F16, BF16, I64, I32, I16, I8, U64, U32, U16, U8, BOOL",
          printable_name(tensor.dtype), "convert the tensor to one of these"});
  }
  entry.dtype = *dtype;
  for (const uint64_t size : tensor.shape) {
    // Sizes beyond int64 wrap to negative here, which checked_byte_count refuses.
    entry.shape.push_back(static_cast<int64_t>(size));
  }
  const int64_t bytes = checked_byte_count(entry.shape, entry.dtype);
  if (bytes < 0) {
    fail({where, "a shape whose size fits 63 bits", "sizes that overflow",
          "download or write the file again"});
  }
  if (tensor.offsets.size() != 2 || tensor.offsets[0] > tensor.offsets[1] || tensor.offsets[1] > data.size) {
    std::string found;
    for (const uint64_t offset : tensor.offsets)
      found += (found.empty() ? "" : ", ") + std::to_string(offset);
    fail({where, "data_offsets within the " + std::to_string(data.size) + " data bytes of the file",
          "[" + found + "]", "get the file again, it may be cut short"});
  }
  if (tensor.offsets[1] - tensor.offsets[0] != static_cast<uint64_t>(bytes)) {
    fail({where,
          std::to_string(bytes) + " bytes for shape " + shape_text(entry.shape) + " in " +
              dtype_name(entry.dtype),
          std::to_string(tensor.offsets[1] - tensor.offsets[0]) + " bytes between its data_offsets",
          "download or write the file again"});
  }
  entry.strides = row_major_strides(entry.shape);
  entry.data = data.data + tensor.offsets[0];
  return entry;
}

void check_tiling(const std::vector<TensorEntry>& entries, ByteView data, const std::string& where) {
  std::vector<const TensorEntry*> order;
  for (const auto& entry : entries) {
    if (entry.byte_count() != 0) order.push_back(&entry);
  }
  std::sort(order.begin(), order.end(), [](const auto* a, const auto* b) { return a->data < b->data; });
  const uint8_t* position = data.data;
  const TensorEntry* previous = nullptr;
  for (const auto* entry : order) {
    if (entry->data < position) {
      fail({where + ": tensor " + printable_name(entry->name), "data of its own",
            "an overlap with tensor " + printable_name(previous->name), "download or write the file again"});
    }
    if (entry->data > position) {
      fail({where + ": tensor " + printable_name(entry->name), "data right after the tensor before it",
            "a hole of " + std::to_string(entry->data - position) + " bytes",
            "download or write the file again"});
    }
    position = entry->data + entry->byte_count();
    previous = entry;
  }
  const auto used = static_cast<size_t>(position - data.data);
  if (used != data.size) {
    fail({where, "the tensors to fill the file",
          std::to_string(data.size - used) + " bytes after the last tensor",
          "download or write the file again"});
  }
}

}  // namespace

ParsedWeights parse_safetensors(ByteView file, const std::string& where) {
  if (file.size < kLengthBytes) {
    fail({where, "a safetensors file", "only " + std::to_string(file.size) + " bytes", "get the file again"});
  }
  uint64_t length = 0;
  std::memcpy(&length, file.data, sizeof length);
  if (length > file.size - kLengthBytes) {
    fail({where, "a header within the file's " + std::to_string(file.size) + " bytes",
          "a header length of " + std::to_string(length), "get the file again, it may be cut short"});
  }
  if (length > kMaximumSafetensorsHeader) {
    fail({where, "a header of at most " + std::to_string(kMaximumSafetensorsHeader) + " bytes",
          std::to_string(length) + " bytes", "download or write the file again"});
  }
  const uint8_t* header = file.data + kLengthBytes;
  // A zero byte ends the text for the JSON reader, whatever follows.
  if (std::memchr(header, 0, static_cast<size_t>(length)) != nullptr) {
    fail({where, "a header of JSON text", "a zero byte in it", "download or write the file again"});
  }
  HeaderReader reader(where);
  json::sax_parse(header, header + length, &reader);

  const ByteView data{header + length, file.size - kLengthBytes - static_cast<size_t>(length)};
  ParsedWeights parsed;
  parsed.metadata = std::move(reader.metadata);
  parsed.entries.reserve(reader.tensors.size());
  for (const auto& tensor : reader.tensors) parsed.entries.push_back(checked_entry(tensor, data, where));
  std::sort(parsed.entries.begin(), parsed.entries.end(),
            [](const auto& a, const auto& b) { return a.name < b.name; });
  const auto twice = std::adjacent_find(parsed.entries.begin(), parsed.entries.end(),
                                        [](const auto& a, const auto& b) { return a.name == b.name; });
  if (twice != parsed.entries.end()) {
    fail({where + ": tensor " + printable_name(twice->name), "each name once", "the name twice",
          "write the file again with distinct names"});
  }
  check_tiling(parsed.entries, data, where);
  return parsed;
}

std::string safetensors_header(const std::vector<TensorEntry>& entries,
                               const std::map<std::string, std::string>& metadata) {
  nlohmann::ordered_json header = nlohmann::ordered_json::object();
  if (!metadata.empty()) header["__metadata__"] = metadata;
  int64_t offset = 0;
  for (const auto& entry : entries) {
    if (entry.name == "__metadata__" || header.contains(entry.name)) {
      fail({"safetensors file: tensor " + printable_name(entry.name), "a name of its own",
            "a name already taken", "rename the tensor"});
    }
    std::string code;
    for (const auto& [name, dtype] : dtype_codes()) {
      if (dtype == entry.dtype) code = name;
    }
    const int64_t bytes = checked_byte_count(entry.shape, entry.dtype);
    header[entry.name] = {
        {"dtype", code}, {"shape", entry.shape}, {"data_offsets", {offset, offset + bytes}}};
    offset += bytes;
  }
  std::string text;
  try {
    text = header.dump();
  } catch (const nlohmann::ordered_json::type_error&) {
    fail({"safetensors file", "names and metadata in UTF-8", "other bytes", "rename the tensors"});
  }
  // The format allows trailing spaces in the header; they align the data.
  const size_t unaligned = (kLengthBytes + text.size()) % kSafetensorsAlignment;
  if (unaligned != 0) text.append(kSafetensorsAlignment - unaligned, ' ');
  std::string bytes(kLengthBytes, '\0');
  const uint64_t length = text.size();
  std::memcpy(bytes.data(), &length, sizeof length);
  return bytes + text;
}

}  // namespace gld
