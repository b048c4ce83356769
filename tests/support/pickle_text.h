#pragma once

#include "gld/files/dtype.h"
#include "gld/files/zip_archive.h"

#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace gld::test {

// Writes pickles opcode by opcode, good ones and hostile ones.
class PickleText {
 public:
  PickleText();  // starts with PROTO 2
  PickleText& op(char opcode);
  PickleText& raw(const std::string& bytes);
  PickleText& text(const std::string& value);
  PickleText& integer(int64_t value);
  PickleText& real(double value);
  PickleText& global(const std::string& module, const std::string& name);
  PickleText& integers(const std::vector<int64_t>& values);  // a tuple
  // Writes a reference to a storage: ("storage", torch.<type>, key, location, elements).
  PickleText& storage(const std::string& type, const std::string& key, int64_t elements,
                      const std::string& location = "cpu");
  // Writes a call of _rebuild_tensor_v2 on float32 data of storage `key`.
  PickleText& tensor(const std::string& key, int64_t elements, int64_t offset,
                     const std::vector<int64_t>& shape, const std::vector<int64_t>& strides);
  PickleText& empty_ordered_dictionary();

  std::string stopped() const { return bytes_ + '.'; }

 private:
  std::string bytes_;
};

// The two layouts of PyTorch files around a pickle; storages by key.
std::string torch_zip(const std::string& pickle, const std::map<std::string, std::string>& storages,
                      ZipMethod method = ZipMethod::kStored);
std::string torch_legacy(const std::string& pickle, const std::map<std::string, std::string>& storages,
                         int64_t element_size);

std::string float_bytes(const std::vector<float>& values);

// Returns a safetensors file with that header text and data, right or wrong.
std::string safetensors_text(const std::string& header, const std::string& data);

}  // namespace gld::test
