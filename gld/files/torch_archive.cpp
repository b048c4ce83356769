#include "gld/files/torch_archive.h"

#include "gld/base/error.h"
#include "gld/files/pickle.h"
#include "gld/files/zip_archive.h"

#include <algorithm>
#include <cstring>
#include <set>
#include <utility>

namespace gld {
namespace {

constexpr size_t kDeepestNesting = 64;
constexpr size_t kMostFlattened = 200'000;
constexpr uint64_t kLargestPickle = uint64_t{64} << 20;
// Weights hardly compress; more than this is a bomb.
constexpr uint64_t kLargestExpansion = 16;
const std::string kPickleName = "data.pkl";
const std::string kLegacyMagic = "0x1950a86a20f9469cfc6c";
constexpr int64_t kLegacyProtocol = 1001;

[[noreturn]] void fail_broken_archive(const std::string& where, const std::string& found) {
  fail({where, "a PyTorch file", found, "download or save the file again"});
}

struct Flattened {
  std::vector<std::pair<std::string, const PickleTensor*>> tensors;
  std::map<std::string, ScalarEntry> scalars;
};

class Flattener {
 public:
  Flattener(const PickleObjects& objects, std::string where) : objects_(objects), where_(std::move(where)) {}

  Flattened run() {
    visit(objects_.root(), "", 0);
    return std::move(flattened_);
  }

 private:
  void visit(PickleId id, const std::string& name, size_t depth) {
    if (depth > kDeepestNesting) {
      fail({where_, "objects nested at most " + std::to_string(kDeepestNesting) + " deep",
            "deeper ones (a list may contain itself)", "save only the state_dict() of the model"});
    }
    if (++visited_ > kMostFlattened) {
      fail({where_, "at most " + std::to_string(kMostFlattened) + " objects", "more",
            "save only the state_dict() of the model"});
    }
    switch (objects_.kind(id)) {
      case PickleKind::kNone:
        return;
      case PickleKind::kBoolean:
        return add_scalar(name, objects_.integer(id) != 0);
      case PickleKind::kInteger:
        return add_scalar(name, objects_.integer(id));
      case PickleKind::kReal:
        return add_scalar(name, objects_.real(id));
      case PickleKind::kText:
        spend(objects_.text(id).size());
        return add_scalar(name, objects_.text(id));
      case PickleKind::kList: {
        const auto& items = objects_.items(id);
        for (size_t i = 0; i < items.size(); ++i) visit(items[i], joined(name, std::to_string(i)), depth + 1);
        return;
      }
      case PickleKind::kDictionary: {
        const auto& items = objects_.items(id);
        for (size_t i = 0; i + 1 < items.size(); i += 2)
          visit(items[i + 1], joined(name, key_of(items[i])), depth + 1);
        return;
      }
      case PickleKind::kTensor: {
        const std::string full = name.empty() ? "tensor" : name;
        claim(full);
        flattened_.tensors.emplace_back(full, &objects_.tensor(id));
        return;
      }
      case PickleKind::kStorage:
      case PickleKind::kGlobal:
        break;
    }
    fail({where_ + ": entry " + printable_name(name), "a tensor, number or string",
          describe(objects_.kind(id)), "save only the state_dict() of the model"});
  }

  // Long keys repeated at every level of a shared structure would multiply; all names share one budget.
  std::string joined(const std::string& name, const std::string& key) {
    spend(name.size() + key.size());
    return name.empty() ? key : name + "." + key;
  }

  void spend(size_t bytes) {
    text_bytes_ += bytes;
    if (text_bytes_ > kLargestPickle)
      fail_broken_archive(where_, "names and texts of more than 64 MiB together");
  }

  std::string key_of(PickleId id) const {
    if (objects_.kind(id) == PickleKind::kText) return objects_.text(id);
    if (objects_.kind(id) == PickleKind::kInteger) return std::to_string(objects_.integer(id));
    fail({where_, "dictionary keys that are strings or integers", describe(objects_.kind(id)),
          "save only the state_dict() of the model"});
  }

  void claim(const std::string& name) {
    if (!names_.insert(name).second) {
      fail({where_ + ": entry " + printable_name(name), "each name once", "the name twice",
            "save the file again with distinct names"});
    }
  }

  void add_scalar(const std::string& name, ScalarEntry value) {
    claim(name);
    flattened_.scalars.emplace(name, std::move(value));
  }

  const PickleObjects& objects_;
  std::string where_;
  Flattened flattened_;
  std::set<std::string> names_;
  size_t visited_ = 0;
  uint64_t text_bytes_ = 0;
};

// Turns the tensors of a pickle into entries; `bytes_of` gives the bytes of a storage.
template <class BytesOf>
void add_entries(Flattened flattened, const std::string& where, BytesOf bytes_of, ParsedWeights& parsed) {
  uint64_t copied = 0, total = 0;
  for (const auto& [name, tensor] : flattened.tensors) {
    const std::string tensor_where = where + ": tensor " + printable_name(name);
    const ByteView bytes = bytes_of(tensor->storage, tensor_where);
    const auto element = static_cast<uint64_t>(byte_size(tensor->storage.dtype));
    if (bytes.size / element < static_cast<uint64_t>(tensor->storage.elements)) {
      fail({tensor_where,
            std::to_string(tensor->storage.elements) + " elements of " + dtype_name(tensor->storage.dtype),
            "a storage of " + std::to_string(bytes.size) + " bytes", "download or save the file again"});
    }
    TensorEntry entry;
    entry.name = name;
    entry.dtype = tensor->storage.dtype;
    entry.shape = tensor->shape;
    entry.strides = tensor->strides;
    // An empty tensor may start anywhere, also without any storage.
    if (entry.element_count() != 0) entry.data = bytes.data + static_cast<uint64_t>(tensor->offset) * element;
    total += bytes.size;
    if (!entry.contiguous()) copied += static_cast<uint64_t>(entry.byte_count());
    parsed.entries.push_back(std::move(entry));
  }
  if (copied > total) fail_broken_archive(where, "views that need more memory than the file has");
  std::sort(parsed.entries.begin(), parsed.entries.end(),
            [](const auto& a, const auto& b) { return a.name < b.name; });
  parsed.scalars = std::move(flattened.scalars);
}

const ZipEntry& find_pickle(const ZipArchive& archive, const std::string& where) {
  const ZipEntry* found = nullptr;
  for (const auto& entry : archive.entries()) {
    const size_t slash = entry.name.find('/');
    if (slash == std::string::npos || entry.name.substr(slash + 1) != kPickleName) continue;
    if (found != nullptr) fail_broken_archive(where, "two files named " + kPickleName);
    found = &entry;
  }
  if (found == nullptr) fail_broken_archive(where, "a zip file without " + kPickleName);
  if (found->size > kLargestPickle) fail_broken_archive(where, "a " + kPickleName + " of more than 64 MiB");
  return *found;
}

}  // namespace

ParsedWeights parse_torch_zip(ByteView file, const std::string& where) {
  const auto archive = ZipArchive::parse(file, where);
  const ZipEntry& pickle = find_pickle(*archive, where);
  const std::string folder = pickle.name.substr(0, pickle.name.size() - kPickleName.size());
  if (const auto* order = archive->find(folder + "byteorder")) {
    const ByteView text = order->packed;
    if (order->method == ZipMethod::kStored && text.size == 3 && std::memcmp(text.data, "big", 3) == 0) {
      fail({where, "little-endian data", "big-endian data", "save the file on a little-endian machine"});
    }
  }
  const auto bytes = archive->read(pickle);
  size_t position = 0;
  const auto objects = unpickle({bytes.data(), bytes.size()}, position, where);

  ParsedWeights parsed;
  std::map<std::string, ByteView> unpacked;
  uint64_t unpacked_bytes = 0;
  const auto bytes_of = [&](const PickleStorage& storage, const std::string& tensor_where) {
    const ZipEntry* entry = archive->find(folder + "data/" + storage.key);
    if (entry == nullptr) {
      fail({tensor_where, "a storage named data/" + printable_name(storage.key), "none",
            "download or save the file again"});
    }
    const auto known = unpacked.find(storage.key);
    if (known != unpacked.end()) return known->second;
    if (entry->method == ZipMethod::kStored) {
      archive->check(*entry);
      return unpacked[storage.key] = entry->packed;
    }
    unpacked_bytes += entry->size;
    if (unpacked_bytes / kLargestExpansion > file.size) {
      fail_broken_archive(where,
                          "data that expands more than " + std::to_string(kLargestExpansion) + " times");
    }
    const auto owner = std::make_shared<const std::vector<uint8_t>>(archive->read(*entry));
    parsed.owners.push_back(owner);
    return unpacked[storage.key] = ByteView{owner->data(), owner->size()};
  };
  add_entries(Flattener(objects, where).run(), where, bytes_of, parsed);
  return parsed;
}

ParsedWeights parse_torch_legacy(ByteView file, const std::string& where) {
  // Pickles come first and may not be larger than in the zip layout; the storages are not scanned.
  const ByteView pickles{file.data, static_cast<size_t>(std::min<uint64_t>(file.size, kLargestPickle))};
  size_t position = 0;
  const auto magic = unpickle(pickles, position, where);
  if (magic.kind(magic.root()) != PickleKind::kText || magic.text(magic.root()) != kLegacyMagic) {
    fail_broken_archive(where, "a pickle without PyTorch's magic number");
  }
  const auto protocol = unpickle(pickles, position, where);
  if (protocol.kind(protocol.root()) != PickleKind::kInteger ||
      protocol.integer(protocol.root()) != kLegacyProtocol) {
    fail_broken_archive(where, "another version of the older layout than " + std::to_string(kLegacyProtocol));
  }
  const auto system = Flattener(unpickle(pickles, position, where), where).run();
  const auto endian = system.scalars.find("little_endian");
  if (endian != system.scalars.end() && endian->second == ScalarEntry(false)) {
    fail({where, "little-endian data", "big-endian data", "save the file on a little-endian machine"});
  }
  const auto objects = unpickle(pickles, position, where);
  const auto keys = unpickle(pickles, position, where);
  if (keys.kind(keys.root()) != PickleKind::kList) fail_broken_archive(where, "no list of storages");

  std::map<std::string, DType> dtypes;
  for (const auto& storage : objects.storages()) {
    if (!dtypes.emplace(storage.key, storage.dtype).second && dtypes[storage.key] != storage.dtype) {
      fail_broken_archive(where, "storage " + printable_name(storage.key) + " of two types");
    }
  }
  std::map<std::string, ByteView> storages;
  for (const PickleId id : keys.items(keys.root())) {
    const std::string key = keys.kind(id) == PickleKind::kText ? keys.text(id) : describe(keys.kind(id));
    const std::string name = "storage " + printable_name(key);
    const auto dtype = dtypes.find(key);
    if (dtype == dtypes.end()) fail_broken_archive(where, name + ", which nothing uses");
    int64_t elements = 0;
    if (file.size - position < sizeof elements)
      fail_broken_archive(where, "the end of the file before " + name);
    std::memcpy(&elements, file.data + position, sizeof elements);
    position += sizeof elements;
    const uint64_t element = static_cast<uint64_t>(byte_size(dtype->second));
    if (elements < 0 || static_cast<uint64_t>(elements) > (file.size - position) / element) {
      fail_broken_archive(where, name + " of " + std::to_string(elements) + " elements in the " +
                                     std::to_string(file.size - position) + " bytes that are left");
    }
    const auto size = static_cast<size_t>(static_cast<uint64_t>(elements) * element);
    if (!storages.emplace(key, ByteView{file.data + position, size}).second)
      fail_broken_archive(where, name + " twice");
    position += size;
  }
  if (position != file.size)
    fail_broken_archive(where, std::to_string(file.size - position) + " bytes after the last storage");

  ParsedWeights parsed;
  const auto bytes_of = [&](const PickleStorage& storage, const std::string& tensor_where) {
    const auto found = storages.find(storage.key);
    if (found == storages.end()) {
      fail({tensor_where, "a storage named " + printable_name(storage.key), "none",
            "download or save the file again"});
    }
    return found->second;
  };
  add_entries(Flattener(objects, where).run(), where, bytes_of, parsed);
  return parsed;
}

}  // namespace gld
