#include "gld/files/pickle_tensors.h"

#include "gld/base/error.h"
#include "gld/files/dtype.h"
#include "gld/files/weight_file.h"

#include <utility>

namespace gld {
namespace {

struct StorageType {
  const char* name;
  DType dtype;
};

constexpr StorageType kStorageTypes[] = {
    {"DoubleStorage", DType::kFloat64}, {"FloatStorage", DType::kFloat32},
    {"HalfStorage", DType::kFloat16},   {"BFloat16Storage", DType::kBFloat16},
    {"LongStorage", DType::kInt64},     {"IntStorage", DType::kInt32},
    {"ShortStorage", DType::kInt16},    {"CharStorage", DType::kInt8},
    {"ByteStorage", DType::kUInt8},     {"BoolStorage", DType::kBool}};

const std::string& text_of(const PickleObjects& objects, PickleId id, const char* what,
                           const PickleSite& site) {
  if (objects.kind(id) != PickleKind::kText) site.broken(describe(objects.kind(id)) + " as " + what);
  return objects.text(id);
}

int64_t count_of(const PickleObjects& objects, PickleId id, const char* what, const PickleSite& site) {
  if (objects.kind(id) != PickleKind::kInteger) site.broken(describe(objects.kind(id)) + " as " + what);
  if (objects.integer(id) < 0) site.broken("a negative " + std::string(what));
  return objects.integer(id);
}

std::vector<int64_t> counts_of(const PickleObjects& objects, PickleId id, const char* what,
                               const PickleSite& site) {
  if (objects.kind(id) != PickleKind::kList) site.broken(describe(objects.kind(id)) + " as " + what);
  const auto& items = objects.items(id);
  if (items.size() > kMaximumRank) site.broken("a tensor of more than 64 dimensions");
  std::vector<int64_t> counts;
  counts.reserve(items.size());
  for (const PickleId item : items) counts.push_back(count_of(objects, item, what, site));
  return counts;
}

// Returns whether the element with the largest index lies below `available`, and false when the index overflows.
bool reaches_only(const PickleTensor& tensor, int64_t available) {
  int64_t last = tensor.offset;
  for (size_t axis = 0; axis < tensor.shape.size(); ++axis) {
    int64_t reach = 0;
    if (__builtin_mul_overflow(tensor.shape[axis] - 1, tensor.strides[axis], &reach) ||
        __builtin_add_overflow(last, reach, &last)) {
      return false;
    }
  }
  return last < available;
}

}  // namespace

void PickleSite::broken(const std::string& found) const {
  fail({where, "a whole pickle", found + " at byte " + std::to_string(position),
        "download or save the file again"});
}

void PickleSite::refuse(const std::string& name) const {
  fail({where, "only tensors, numbers, strings, lists and dictionaries",
        printable_name(name) + ", which could run code", "save only the state_dict() of the model"});
}

PickleGlobal pickle_global(const std::string& module, const std::string& name, const PickleSite& site) {
  if (module == "collections" && name == "OrderedDict") return PickleGlobal::kOrderedDict;
  if (module == "torch._utils") {
    if (name == "_rebuild_tensor" || name == "_rebuild_tensor_v2") return PickleGlobal::kRebuildTensor;
    if (name == "_rebuild_parameter") return PickleGlobal::kRebuildParameter;
  }
  if (module == "torch" || module == "torch.cuda") {
    auto code = static_cast<int64_t>(PickleGlobal::kFirstStorage);
    for (const auto& type : kStorageTypes) {
      if (name == type.name) return static_cast<PickleGlobal>(code);
      ++code;
    }
  }
  site.refuse(module + "." + name);
}

PickleStorage pickle_storage(const PickleObjects& objects, PickleId reference, const PickleSite& site) {
  constexpr auto kFirst = static_cast<int64_t>(PickleGlobal::kFirstStorage);
  if (objects.kind(reference) != PickleKind::kList) site.broken("a reference that is no tuple");
  const auto& items = objects.items(reference);
  if (items.size() < 5 || text_of(objects, items[0], "a reference's type", site) != "storage") {
    site.broken("a reference to something else than a storage");
  }
  if (objects.kind(items[1]) != PickleKind::kGlobal || objects.integer(items[1]) < kFirst) {
    site.broken("a storage without a type");
  }
  PickleStorage storage;
  storage.dtype = kStorageTypes[objects.integer(items[1]) - kFirst].dtype;
  storage.key = text_of(objects, items[2], "a storage's key", site);
  // Every tensor keeps a copy of its key; PyTorch's are numbers.
  constexpr size_t kLongestKey = 200;
  if (storage.key.size() > kLongestKey)
    site.broken("a storage's key of " + std::to_string(storage.key.size()) + " bytes");
  storage.elements = count_of(objects, items[4], "number of elements", site);
  storage.view_elements = storage.elements;
  if (items.size() > 5 && objects.kind(items[5]) != PickleKind::kNone) {
    if (objects.kind(items[5]) != PickleKind::kList || objects.items(items[5]).size() != 3) {
      site.broken("a broken storage view");
    }
    const auto& view = objects.items(items[5]);
    storage.offset = count_of(objects, view[1], "storage offset", site);
    storage.view_elements = count_of(objects, view[2], "number of elements", site);
    if (storage.offset > storage.elements || storage.view_elements > storage.elements - storage.offset) {
      site.broken("a view beyond its storage");
    }
  }
  return storage;
}

PickleTensor pickle_tensor(const PickleObjects& objects, const std::vector<PickleId>& arguments,
                           const PickleSite& site) {
  if (arguments.size() < 4 || objects.kind(arguments[0]) != PickleKind::kStorage) {
    site.broken("a tensor without storage");
  }
  PickleTensor tensor;
  tensor.storage = objects.storage(arguments[0]);
  tensor.offset = count_of(objects, arguments[1], "storage offset", site);
  tensor.shape = counts_of(objects, arguments[2], "size", site);
  tensor.strides = counts_of(objects, arguments[3], "stride", site);
  if (tensor.shape.size() != tensor.strides.size())
    site.broken("a tensor whose sizes and strides differ in number");
  const int64_t bytes = checked_byte_count(tensor.shape, tensor.storage.dtype);
  if (bytes < 0) site.broken("a tensor whose size overflows");
  const int64_t elements = bytes / byte_size(tensor.storage.dtype);
  const int64_t available = tensor.storage.view_elements;
  if (tensor.offset > available || (elements != 0 && !reaches_only(tensor, available))) {
    site.broken("a tensor of shape " + shape_text(tensor.shape) + " that reaches beyond its storage of " +
                std::to_string(available) + " elements");
  }
  if (elements > available) {
    site.broken("a tensor of shape " + shape_text(tensor.shape) + " expanded from a storage of " +
                std::to_string(available) + " elements");
  }
  tensor.offset += tensor.storage.offset;
  return tensor;
}

}  // namespace gld
