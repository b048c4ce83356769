#include "tests/support/pickle_text.h"

#include <cstring>

namespace gld::test {
namespace {

template <class T>
std::string bytes_of(T value) {
  return {reinterpret_cast<const char*>(&value), sizeof value};
}

}  // namespace

PickleText::PickleText() : bytes_("\x80\x02") {}

PickleText& PickleText::op(char opcode) {
  bytes_ += opcode;
  return *this;
}

PickleText& PickleText::raw(const std::string& bytes) {
  bytes_ += bytes;
  return *this;
}

PickleText& PickleText::text(const std::string& value) {
  bytes_ += 'X' + bytes_of(static_cast<uint32_t>(value.size())) + value;
  return *this;
}

PickleText& PickleText::integer(int64_t value) {
  bytes_ += std::string("\x8a\x08") + bytes_of(value);
  return *this;
}

PickleText& PickleText::real(double value) {
  const std::string little = bytes_of(value);
  bytes_ += 'G' + std::string(little.rbegin(), little.rend());
  return *this;
}

PickleText& PickleText::global(const std::string& module, const std::string& name) {
  bytes_ += 'c' + module + '\n' + name + '\n';
  return *this;
}

PickleText& PickleText::integers(const std::vector<int64_t>& values) {
  op('(');
  for (const int64_t value : values) integer(value);
  return op('t');
}

PickleText& PickleText::storage(const std::string& type, const std::string& key, int64_t elements,
                                const std::string& location) {
  return op('(').text("storage").global("torch", type).text(key).text(location).integer(elements).raw("tQ");
}

PickleText& PickleText::tensor(const std::string& key, int64_t elements, int64_t offset,
                               const std::vector<int64_t>& shape, const std::vector<int64_t>& strides) {
  global("torch._utils", "_rebuild_tensor_v2").op('(').storage("FloatStorage", key, elements).integer(offset);
  return integers(shape).integers(strides).raw("\x89").empty_ordered_dictionary().raw("tR");
}

PickleText& PickleText::empty_ordered_dictionary() { return global("collections", "OrderedDict").raw(")R"); }

std::string torch_zip(const std::string& pickle, const std::map<std::string, std::string>& storages,
                      ZipMethod method) {
  std::map<std::string, std::string> entries = {
      {"archive/data.pkl", pickle}, {"archive/version", "3\n"}, {"archive/byteorder", "little"}};
  for (const auto& [key, bytes] : storages) entries["archive/data/" + key] = bytes;
  return zip_text(entries, method, "test");
}

std::string torch_legacy(const std::string& pickle, const std::map<std::string, std::string>& storages,
                         int64_t element_size) {
  // 0x1950a86a20f9469cfc6c, the layout's magic number, as LONG1 of ten bytes.
  std::string file = std::string("\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.", 15);
  file += PickleText().integer(1001).stopped();
  file += PickleText().op('}').op('(').text("little_endian").raw("\x88u").stopped();
  file += pickle;
  PickleText keys;
  keys.op(']').op('(');
  for (const auto& storage : storages) keys.text(storage.first);
  file += keys.op('e').stopped();
  for (const auto& storage : storages) {
    file += bytes_of(static_cast<int64_t>(storage.second.size()) / element_size) + storage.second;
  }
  return file;
}

std::string float_bytes(const std::vector<float>& values) {
  return {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(float)};
}

std::string safetensors_text(const std::string& header, const std::string& data) {
  return bytes_of(static_cast<uint64_t>(header.size())) + header + data;
}

}  // namespace gld::test
