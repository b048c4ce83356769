#include "gld/files/pickle.h"

#include "gld/files/pickle_tensors.h"

#include <cstring>
#include <limits>
#include <unordered_map>
#include <utility>

namespace gld {
namespace {

constexpr size_t kMostObjects = 2'000'000;
constexpr size_t kMostStackEntries = 1'000'000;
// A copy of a list costs two bytes of the file and as much memory as the list: all lists share these budgets.
constexpr size_t kMostListItems = 8'000'000;
constexpr size_t kMostTensors = 200'000;

// Opcodes of pickle protocols 2 to 5 that describe data (Python's pickletools documents them).
enum Opcode : uint8_t {
  kMark = '(',
  kStop = '.',
  kPop = '0',
  kPopMark = '1',
  kDup = '2',
  kNone = 'N',
  kBinFloat = 'G',
  kBinInt = 'J',
  kBinInt1 = 'K',
  kBinInt2 = 'M',
  kBinString = 'T',
  kShortBinString = 'U',
  kBinUnicode = 'X',
  kBinBytes = 'B',
  kShortBinBytes = 'C',
  kAppend = 'a',
  kAppends = 'e',
  kBuild = 'b',
  kGlobal = 'c',
  kDict = 'd',
  kEmptyDict = '}',
  kBinGet = 'h',
  kLongBinGet = 'j',
  kList = 'l',
  kEmptyList = ']',
  kBinPut = 'q',
  kLongBinPut = 'r',
  kSetItem = 's',
  kSetItems = 'u',
  kTuple = 't',
  kEmptyTuple = ')',
  kReduce = 'R',
  kBinPersistentId = 'Q',
  kProto = 0x80,
  kTuple1 = 0x85,
  kTuple2 = 0x86,
  kTuple3 = 0x87,
  kNewTrue = 0x88,
  kNewFalse = 0x89,
  kLong1 = 0x8a,
  kLong4 = 0x8b,
  kShortBinUnicode = 0x8c,
  kBinUnicode8 = 0x8d,
  kBinBytes8 = 0x8e,
  kStackGlobal = 0x93,
  kMemoize = 0x94,
  kFrame = 0x95,
};

}  // namespace

class Unpickler {
 public:
  Unpickler(ByteView bytes, size_t position, std::string where)
      : bytes_(bytes), position_(position), where_(std::move(where)) {}

  PickleObjects run() {
    while (step()) {
    }
    if (stack_.size() != 1 || !marks_.empty()) broken("objects left over");
    objects_.root_ = stack_.back();
    return std::move(objects_);
  }

  size_t position() const { return position_; }

 private:
  using Node = PickleObjects::Node;

  PickleSite site() const { return {where_, position_}; }

  [[noreturn]] void broken(const std::string& found) const { site().broken(found); }

  const uint8_t* take(uint64_t count) {
    if (count > bytes_.size - position_) broken("the end of the data");
    const uint8_t* start = bytes_.data + position_;
    position_ += static_cast<size_t>(count);
    return start;
  }

  template <class T>
  T number() {
    T value;
    std::memcpy(&value, take(sizeof value), sizeof value);
    return value;
  }

  std::string line() {
    const auto* start = bytes_.data + position_;
    const void* end = bytes_.size == position_ ? nullptr : std::memchr(start, '\n', bytes_.size - position_);
    if (end == nullptr) broken("the end of the data");
    const auto length = static_cast<size_t>(static_cast<const uint8_t*>(end) - start);
    take(length + 1);
    return {reinterpret_cast<const char*>(start), length};
  }

  void push(PickleId id) {
    if (stack_.size() == kMostStackEntries) broken("more than a million objects on the stack");
    stack_.push_back(id);
  }

  PickleId add(const Node& node) {
    if (objects_.nodes_.size() == kMostObjects) broken("more than two million objects");
    objects_.nodes_.push_back(node);
    return static_cast<PickleId>(objects_.nodes_.size() - 1);
  }

  void push_scalar(PickleKind kind, int64_t value) {
    Node node;
    node.kind = kind;
    node.integer = value;
    push(add(node));
  }

  PickleId add_indexed(PickleKind kind, size_t index) {
    Node node;
    node.kind = kind;
    node.index = index;
    return add(node);
  }

  void push_text(std::string text) {
    objects_.texts_.push_back(std::move(text));
    push(add_indexed(PickleKind::kText, objects_.texts_.size() - 1));
  }

  void push_text_of(uint64_t size) {
    const uint8_t* start = take(size);
    push_text(std::string(reinterpret_cast<const char*>(start), static_cast<size_t>(size)));
  }

  void count_items(size_t count) {
    if (count > kMostListItems - list_items_) broken("more than eight million items in lists");
    list_items_ += count;
  }

  void push_list(PickleKind kind, std::vector<PickleId> items) {
    count_items(items.size());
    objects_.lists_.push_back(std::move(items));
    push(add_indexed(kind, objects_.lists_.size() - 1));
  }

  // Returns the bottom of what may be popped: the newest mark.
  size_t floor() const { return marks_.empty() ? 0 : marks_.back(); }

  PickleId pop() {
    if (stack_.size() == floor()) broken("an empty stack");
    const PickleId id = stack_.back();
    stack_.pop_back();
    return id;
  }

  PickleId top() const {
    if (stack_.size() == floor()) broken("an empty stack");
    return stack_.back();
  }

  std::vector<PickleId> pop_to_mark() {
    if (marks_.empty()) broken("no mark");
    const auto first = stack_.begin() + static_cast<std::ptrdiff_t>(marks_.back());
    std::vector<PickleId> items(first, stack_.end());
    stack_.erase(first, stack_.end());
    marks_.pop_back();
    return items;
  }

  void push_tuple_of(size_t count) {
    std::vector<PickleId> items(count);
    for (size_t i = count; i-- > 0;) items[i] = pop();
    push_list(PickleKind::kList, std::move(items));
  }

  std::vector<PickleId>& container(PickleId id, PickleKind kind) {
    if (objects_.kind(id) != kind) broken(describe(objects_.kind(id)) + " in place of " + describe(kind));
    return objects_.lists_[objects_.nodes_[id].index];
  }

  void append(const std::vector<PickleId>& items) {
    auto& list = container(top(), PickleKind::kList);
    count_items(items.size());
    list.insert(list.end(), items.begin(), items.end());
  }

  void set_items(const std::vector<PickleId>& items) {
    if (items.size() % 2 != 0) broken("a key without a value");
    auto& dictionary = container(top(), PickleKind::kDictionary);
    count_items(items.size());
    dictionary.insert(dictionary.end(), items.begin(), items.end());
  }

  void put(size_t index) {
    if (memo_.size() == kMostStackEntries) broken("more than a million remembered objects");
    memo_[index] = top();
  }

  void get(size_t index) {
    const auto found = memo_.find(index);
    if (found == memo_.end()) broken("an object that was never remembered");
    push(found->second);
  }

  void push_long(uint64_t size) {
    const uint8_t* data = take(size);
    if (size <= sizeof(int64_t)) {
      // The bytes are two's complement, sign-extended from the last byte.
      uint64_t value = size != 0 && (data[size - 1] & 0x80) != 0 ? ~uint64_t{0} : 0;
      std::memcpy(&value, data, static_cast<size_t>(size));
      push_scalar(PickleKind::kInteger, static_cast<int64_t>(value));
      return;
    }
    static const char digits[] = "0123456789abcdef";
    std::string text = "0x";
    for (uint64_t i = size; i-- > 0;) {
      text += digits[data[i] >> 4];
      text += digits[data[i] & 15];
    }
    push_text(std::move(text));
  }

  void push_real() {
    const uint8_t* data = take(sizeof(double));
    uint64_t bits = 0;
    for (size_t i = 0; i < sizeof bits; ++i) bits = bits << 8 | data[i];  // big-endian
    Node node;
    node.kind = PickleKind::kReal;
    std::memcpy(&node.real, &bits, sizeof bits);
    push(add(node));
  }

  void push_global(const std::string& module, const std::string& name) {
    push_scalar(PickleKind::kGlobal, static_cast<int64_t>(pickle_global(module, name, site())));
  }

  const std::string& name_of(PickleId id) const {
    if (objects_.kind(id) != PickleKind::kText) broken(describe(objects_.kind(id)) + " as a name");
    return objects_.text(id);
  }

  void push_storage() {
    if (objects_.storages_.size() == kMostTensors) broken("more than 200 000 storages");
    objects_.storages_.push_back(pickle_storage(objects_, pop(), site()));
    push(add_indexed(PickleKind::kStorage, objects_.storages_.size() - 1));
  }

  void push_tensor(const std::vector<PickleId>& arguments) {
    if (objects_.tensors_.size() == kMostTensors) broken("more than 200 000 tensors");
    objects_.tensors_.push_back(pickle_tensor(objects_, arguments, site()));
    push(add_indexed(PickleKind::kTensor, objects_.tensors_.size() - 1));
  }

  void reduce() {
    const PickleId argument_id = pop(), function = pop();
    if (objects_.kind(function) != PickleKind::kGlobal)
      broken("a call of " + describe(objects_.kind(function)));
    if (objects_.kind(argument_id) != PickleKind::kList) broken("a call without arguments");
    const auto& arguments = objects_.items(argument_id);  // not copied: they may be a million
    switch (static_cast<PickleGlobal>(objects_.integer(function))) {
      case PickleGlobal::kRebuildTensor:
        return push_tensor(arguments);
      case PickleGlobal::kRebuildParameter:
        if (arguments.empty() || objects_.kind(arguments[0]) != PickleKind::kTensor)
          broken("a parameter without data");
        return push(arguments[0]);
      case PickleGlobal::kOrderedDict:
        return push_ordered_dictionary(arguments);
      default:
        break;
    }
    site().refuse("a call of a storage type");
  }

  // OrderedDict() or, from Python 2, OrderedDict([[key, value], ...]).
  void push_ordered_dictionary(const std::vector<PickleId>& arguments) {
    std::vector<PickleId> items;
    if (!arguments.empty()) {
      const auto& pairs = container(arguments[0], PickleKind::kList);
      count_items(2 * pairs.size());  // before the copy is made
      for (const PickleId pair : pairs) {
        const auto& key_and_value = container(pair, PickleKind::kList);
        if (key_and_value.size() != 2) broken("a dictionary item that is no pair");
        items.insert(items.end(), key_and_value.begin(), key_and_value.end());
      }
    }
    push_list(PickleKind::kDictionary, std::move(items));
  }

  // PyTorch attaches version numbers to the OrderedDict of a state_dict in this way; they do not matter.
  void build() {
    const auto state = objects_.kind(pop());
    if (state != PickleKind::kDictionary || objects_.kind(top()) != PickleKind::kDictionary) {
      site().refuse("attributes set on " + describe(objects_.kind(top())));
    }
  }

  bool step() {
    const auto opcode = number<uint8_t>();
    switch (opcode) {
      case kStop:
        return false;
      case kProto:
        if (number<uint8_t>() > 5) broken("an unknown pickle protocol");
        return true;
      case kFrame:
        number<uint64_t>();
        return true;
      case kMark:
        if (marks_.size() == kMostStackEntries) broken("more than a million marks");
        marks_.push_back(stack_.size());
        return true;
      case kPop:
        if (!marks_.empty() && stack_.size() == marks_.back()) {
          marks_.pop_back();
        } else {
          pop();
        }
        return true;
      case kPopMark:
        pop_to_mark();
        return true;
      case kDup:
        push(top());
        return true;
      case kBinPut:
        put(number<uint8_t>());
        return true;
      case kLongBinPut:
        put(number<uint32_t>());
        return true;
      case kMemoize:
        put(memo_.size());
        return true;
      case kBinGet:
        get(number<uint8_t>());
        return true;
      case kLongBinGet:
        get(number<uint32_t>());
        return true;
      default:
        return step_value(opcode) || step_container(opcode) || step_object(opcode);
    }
  }

  bool step_value(uint8_t opcode) {
    switch (opcode) {
      case kNone:
        push_scalar(PickleKind::kNone, 0);
        return true;
      case kNewTrue:
        push_scalar(PickleKind::kBoolean, 1);
        return true;
      case kNewFalse:
        push_scalar(PickleKind::kBoolean, 0);
        return true;
      case kBinInt:
        push_scalar(PickleKind::kInteger, number<int32_t>());
        return true;
      case kBinInt1:
        push_scalar(PickleKind::kInteger, number<uint8_t>());
        return true;
      case kBinInt2:
        push_scalar(PickleKind::kInteger, number<uint16_t>());
        return true;
      case kLong1:
        push_long(number<uint8_t>());
        return true;
      case kLong4:
        push_long(number<uint32_t>());
        return true;
      case kBinFloat:
        push_real();
        return true;
      case kShortBinString:
      case kShortBinUnicode:
      case kShortBinBytes:
        push_text_of(number<uint8_t>());
        return true;
      case kBinString:
      case kBinUnicode:
      case kBinBytes:
        push_text_of(number<uint32_t>());
        return true;
      case kBinUnicode8:
      case kBinBytes8:
        push_text_of(number<uint64_t>());
        return true;
      default:
        return false;
    }
  }

  bool step_container(uint8_t opcode) {
    switch (opcode) {
      case kEmptyList:
      case kEmptyTuple:
        push_list(PickleKind::kList, {});
        return true;
      case kEmptyDict:
        push_list(PickleKind::kDictionary, {});
        return true;
      case kList:
      case kTuple:
        push_list(PickleKind::kList, pop_to_mark());
        return true;
      case kTuple1:
        push_tuple_of(1);
        return true;
      case kTuple2:
        push_tuple_of(2);
        return true;
      case kTuple3:
        push_tuple_of(3);
        return true;
      case kDict: {
        auto items = pop_to_mark();
        push_list(PickleKind::kDictionary, {});
        set_items(items);
        return true;
      }
      case kAppend:
        append({pop()});
        return true;
      case kAppends:
        append(pop_to_mark());
        return true;
      case kSetItem: {
        const PickleId value = pop(), key = pop();
        set_items({key, value});
        return true;
      }
      case kSetItems:
        set_items(pop_to_mark());
        return true;
      default:
        return false;
    }
  }

  bool step_object(uint8_t opcode) {
    switch (opcode) {
      case kGlobal: {
        const std::string module = line();
        push_global(module, line());
        return true;
      }
      case kStackGlobal: {
        const PickleId name = pop(), module = pop();
        push_global(name_of(module), name_of(name));
        return true;
      }
      case kBinPersistentId:
        push_storage();
        return true;
      case kReduce:
        reduce();
        return true;
      case kBuild:
        build();
        return true;
      default:
        break;
    }
    --position_;
    broken("opcode " + std::to_string(opcode) + ", which no state_dict needs,");
  }

  ByteView bytes_;
  size_t position_;
  std::string where_;
  PickleObjects objects_;
  std::vector<PickleId> stack_;
  std::vector<size_t> marks_;
  size_t list_items_ = 0;
  std::unordered_map<size_t, PickleId> memo_;
};

PickleObjects unpickle(ByteView bytes, size_t& position, const std::string& where) {
  Unpickler unpickler(bytes, position, where);
  PickleObjects objects = unpickler.run();
  position = unpickler.position();
  return objects;
}

std::string describe(PickleKind kind) {
  switch (kind) {
    case PickleKind::kNone:
      return "None";
    case PickleKind::kBoolean:
      return "a boolean";
    case PickleKind::kInteger:
      return "an integer";
    case PickleKind::kReal:
      return "a real number";
    case PickleKind::kText:
      return "a string";
    case PickleKind::kList:
      return "a list";
    case PickleKind::kDictionary:
      return "a dictionary";
    case PickleKind::kStorage:
      return "a storage";
    case PickleKind::kTensor:
      return "a tensor";
    case PickleKind::kGlobal:
      return "a type";
  }
  return "an object";
}

}  // namespace gld
