#include "gld/base/configuration.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/flag_values.h"
#include "gld/base/json_text.h"
#include "gld/base/option_differences.h"
#include "gld/base/yaml_text.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <map>
#include <optional>
#include <set>
#include <sstream>
#include <type_traits>

#include <yaml-cpp/yaml.h>

namespace gld {
namespace {

std::string range_text(const IntegerRange& range) {
  const IntegerRange any;
  if (range.minimum == any.minimum && range.maximum == any.maximum) return "";
  if (range.maximum == any.maximum) return ">= " + std::to_string(range.minimum);
  if (range.minimum == any.minimum) return "<= " + std::to_string(range.maximum);
  return "[" + std::to_string(range.minimum) + ", " + std::to_string(range.maximum) + "]";
}

std::string real_text(double value) {
  if (std::isnan(value)) return ".nan";
  if (std::isinf(value)) return value > 0 ? ".inf" : "-.inf";
  // This finds the shortest text that reads back to the same double.
  for (int digits = 6; digits <= 17; ++digits) {
    std::ostringstream text;
    text.precision(digits);
    text << value;
    // Not std::stod, which throws for numbers below the normal ones.
    if (std::strtod(text.str().c_str(), nullptr) == value) return text.str();
  }
  return std::to_string(value);
}

std::string range_text(const RealRange& range) {
  const bool below = !std::isinf(range.minimum), above = !std::isinf(range.maximum);
  if (below && above) return "[" + real_text(range.minimum) + ", " + real_text(range.maximum) + "]";
  if (below) return ">= " + real_text(range.minimum);
  if (above) return "<= " + real_text(range.maximum);
  return "";
}

std::string quoted(const std::string& text) { return "'" + text + "'"; }

std::string joined(const std::vector<std::string>& parts, const std::string& separator) {
  std::string text;
  for (const auto& part : parts) text += (text.empty() ? "" : separator) + part;
  return text;
}

// Visits every leaf with its dotted key.
class LeafVisitor : public FieldVisitor {
 public:
  void group(const Field& field, OptionsGroup& value) override {
    const std::string outer = prefix_;
    prefix_ += field.name + ".";
    value.visit(*this);
    prefix_ = outer;
  }

 protected:
  std::string key(const Field& field) const { return prefix_ + field.name; }

 private:
  std::string prefix_;
};

// The place of a value for error messages: "file.yaml:12, key 'solver.evaluations'", or a flag, which says it all.
enum class SourceKind { kFile, kSetting, kFlag };
struct Source {
  std::string where;
  SourceKind kind = SourceKind::kFile;
};

std::string place(const Source& source, const YAML::Node& node, const std::string& key) {
  if (source.kind == SourceKind::kFlag) return source.where;
  std::string text = source.where;
  if (source.kind == SourceKind::kFile && node.Mark().line >= 0)
    text += ":" + std::to_string(node.Mark().line + 1);
  return text + ", key " + quoted(key);
}

std::string shown(const YAML::Node& node) {
  if (node.IsNull()) return "nothing";
  if (node.IsScalar()) {
    constexpr size_t kLongest = 60;
    const std::string& text = node.Scalar();
    return quoted(text.size() <= kLongest ? text : text.substr(0, kLongest) + "...");
  }
  return node.IsSequence() ? "a list" : "a map";
}

// Assigns the entries of one YAML map to the fields of one group and refuses what is left over.
class Assigner : public FieldVisitor {
 public:
  Assigner(const YAML::Node& map, const Source& source, std::string prefix)
      : map_(map), source_(source), prefix_(std::move(prefix)) {}

  void boolean(const Field& field, bool& value) override {
    if (auto node = take(field)) value = scalar<bool>(field, *node, "true or false");
  }
  void integer(const Field& field, int64_t& value, const IntegerRange& range) override {
    if (auto node = take(field)) value = ranged<int64_t>(field, *node, "an integer", range);
  }
  void real(const Field& field, double& value, const RealRange& range) override {
    if (auto node = take(field)) value = ranged<double>(field, *node, "a number", range);
  }
  void text(const Field& field, std::string& value) override {
    if (auto node = take(field))
      value = node->IsNull() ? std::string() : scalar<std::string>(field, *node, "text");
  }
  void choice(const Field& field, int& value, const std::vector<std::string>& names) override {
    auto node = take(field);
    if (!node) return;
    const auto name = scalar<std::string>(field, *node, "text");
    const auto found = std::find(names.begin(), names.end(), name);
    if (found == names.end()) {
      const auto near = nearest_name(name, names);
      fail({place(source_, *node, prefix_ + field.name), "one of " + joined(names, ", "), quoted(name),
            near.empty() ? "choose one of them" : "did you mean " + quoted(near) + "?"});
    }
    value = static_cast<int>(found - names.begin());
  }
  void integers(const Field& field, std::vector<int64_t>& value, const IntegerRange& range) override {
    list(field, value,
         [&](const YAML::Node& node) { return ranged<int64_t>(field, node, "an integer", range); });
  }
  void reals(const Field& field, std::vector<double>& value, const RealRange& range) override {
    list(field, value,
         [&](const YAML::Node& node) { return ranged<double>(field, node, "a number", range); });
  }
  void texts(const Field& field, std::vector<std::string>& value) override {
    list(field, value, [&](const YAML::Node& node) { return scalar<std::string>(field, node, "text"); });
  }
  void group(const Field& field, OptionsGroup& value) override {
    auto node = take(field);
    groups_.emplace_back(field.name, &value);
    if (!node || node->IsNull()) return;
    if (!node->IsMap()) {
      fail({place(source_, *node, prefix_ + field.name), "a map of options", shown(*node),
            "write its options indented below it"});
    }
    Assigner inner(*node, source_, prefix_ + field.name + ".");
    value.visit(inner);
    inner.refuse_unknown();
  }

  void refuse_unknown() const {
    for (const auto& entry : map_) {
      if (!entry.first.IsScalar()) {
        fail({place(source_, entry.first, prefix_), "the name of an option", shown(entry.first),
              "correct the text"});
      }
      const auto name = entry.first.Scalar();
      if (std::find(known_.begin(), known_.end(), name) != known_.end()) continue;
      fail({place(source_, entry.first, prefix_ + name), "a known option", "an unknown one", hint(name)});
    }
  }

 private:
  // What to do about a name that is none of this map's. On the command line groups are left out ("--evaluations"), here
  // they are not, so that a name that stands in one is told first.
  std::string hint(const std::string& name) const {
    std::vector<std::string> found;
    for (const auto& [group, options] : groups_) {
      for (const auto& leaf : describe_options(*options)) {
        const std::string key = group + "." + leaf.key;
        const size_t start = key.size() - std::min(key.size(), name.size());
        if (start > 0 && key[start - 1] == '.' && key.substr(start) == name)
          found.push_back(quoted(prefix_ + key));
      }
    }
    if (!found.empty()) return "did you mean " + joined(found, " or ") + "?";
    const auto near = nearest_name(name, known_);
    return near.empty() ? "the options here are " + joined(known_, ", ")
                        : "did you mean " + quoted(prefix_ + near) + "?";
  }

  std::optional<YAML::Node> take(const Field& field) {
    known_.push_back(field.name);
    // operator[] on a const node does not insert.
    const YAML::Node& map = map_;
    const YAML::Node node = map[field.name];
    if (!node.IsDefined()) return std::nullopt;
    return node;
  }

  template <class Value>
  Value scalar(const Field& field, const YAML::Node& node, const std::string& expected) const {
    Value value{};
    bool right = node.IsScalar();
    if constexpr (std::is_same_v<Value, int64_t>) {
      // yaml-cpp also takes octal and hexadecimal numbers; only plain decimal integers are meant here.
      const std::string text = right ? node.Scalar() : std::string();
      const auto parsed = std::from_chars(text.data(), text.data() + text.size(), value);
      const bool whole = right && parsed.ptr == text.data() + text.size();
      if (whole && parsed.ec == std::errc::result_out_of_range) {
        fail({place(source_, node, prefix_ + field.name), expected + " of 64 bits", shown(node),
              "choose one nearer to 0"});
      }
      right = whole && parsed.ec == std::errc();
    } else {
      right = right && YAML::convert<Value>::decode(node, value);
    }
    if (!right) {
      fail({place(source_, node, prefix_ + field.name), expected, shown(node), "correct the value"});
    }
    return value;
  }

  template <class Value, class Range>
  Value ranged(const Field& field, const YAML::Node& node, const std::string& expected,
               const Range& range) const {
    const auto value = scalar<Value>(field, node, expected);
    if (!(value >= range.minimum && value <= range.maximum)) {
      fail({place(source_, node, prefix_ + field.name), expected + " in the range " + range_text(range),
            node.Scalar(), "choose a value inside the range"});
    }
    return value;
  }

  template <class Value, class Read>
  void list(const Field& field, std::vector<Value>& value, const Read& read) {
    auto node = take(field);
    if (!node) return;
    value.clear();
    if (node->IsNull()) return;
    if (node->IsSequence()) {
      for (const auto& item : *node) value.push_back(read(item));
      return;
    }
    if (!node->IsScalar()) {
      fail({place(source_, *node, prefix_ + field.name), "a list", shown(*node), "write it as [a, b, ...]"});
    }
    // "0,3" as people write it on a command line.
    std::stringstream parts(node->Scalar());
    for (std::string part; std::getline(parts, part, ',');) {
      if constexpr (!std::is_same_v<Value, std::string>) {  // "0, 3"; a text keeps its spaces
        part.erase(0, part.find_first_not_of(' '));
        part.erase(part.find_last_not_of(' ') + 1);
      }
      value.push_back(read(YAML::Node(part)));
    }
  }

  YAML::Node map_;
  Source source_;
  std::string prefix_;
  std::vector<std::string> known_;
  std::vector<std::pair<std::string, const OptionsGroup*>> groups_;
};

void assign(OptionsGroup& options, const YAML::Node& root, const Source& source) {
  if (root.IsNull() || !root.IsDefined()) return;
  if (!root.IsMap()) {
    fail({source.where, "a map of options", shown(root), "write one 'key: value' a line"});
  }
  try {
    Assigner assigner(root, source, "");
    options.visit(assigner);
    assigner.refuse_unknown();
  } catch (const YAML::Exception& error) {
    fail({source.where, "options", error.msg, "correct the text"});
  }
}

// Writes YAML and JSON, both from one walk, since a JSON document is the structure YAML needs.
class JsonWriter : public FieldVisitor {
 public:
  void boolean(const Field& field, bool& value) override { object[field.name] = value; }
  void integer(const Field& field, int64_t& value, const IntegerRange&) override {
    object[field.name] = value;
  }
  void real(const Field& field, double& value, const RealRange&) override { object[field.name] = value; }
  void text(const Field& field, std::string& value) override { object[field.name] = value; }
  void choice(const Field& field, int& value, const std::vector<std::string>& names) override {
    object[field.name] = names.at(static_cast<size_t>(value));
  }
  void integers(const Field& field, std::vector<int64_t>& value, const IntegerRange&) override {
    object[field.name] = value;
  }
  void reals(const Field& field, std::vector<double>& value, const RealRange&) override {
    object[field.name] = value;
  }
  void texts(const Field& field, std::vector<std::string>& value) override { object[field.name] = value; }
  void group(const Field& field, OptionsGroup& value) override {
    JsonWriter inner;
    value.visit(inner);
    object[field.name] = std::move(inner.object);
  }

  nlohmann::ordered_json object = nlohmann::ordered_json::object();
};

class YamlWriter : public FieldVisitor {
 public:
  explicit YamlWriter(std::vector<std::string> leave_out) : leave_out_(std::move(leave_out)) {}

  void boolean(const Field& field, bool& value) override { line(field, value ? "true" : "false"); }
  void integer(const Field& field, int64_t& value, const IntegerRange&) override {
    line(field, std::to_string(value));
  }
  void real(const Field& field, double& value, const RealRange&) override { line(field, real_text(value)); }
  void text(const Field& field, std::string& value) override { line(field, text_value(value)); }
  void choice(const Field& field, int& value, const std::vector<std::string>& names) override {
    line(field, names.at(static_cast<size_t>(value)));
  }
  void integers(const Field& field, std::vector<int64_t>& value, const IntegerRange&) override {
    list(field, value, [](int64_t item) { return std::to_string(item); });
  }
  void reals(const Field& field, std::vector<double>& value, const RealRange&) override {
    list(field, value, real_text);
  }
  void texts(const Field& field, std::vector<std::string>& value) override { list(field, value, text_value); }
  void group(const Field& field, OptionsGroup& value) override {
    text_ += std::string(depth_, ' ') + field.name + ":\n";
    depth_ += 2;
    value.visit(*this);
    depth_ -= 2;
  }

  const std::string& yaml() const { return text_; }

  static std::string text_value(const std::string& value) {
    YAML::Emitter emitter;
    emitter << YAML::DoubleQuoted << value;
    return emitter.c_str();
  }

 private:
  void line(const Field& field, const std::string& value) {
    if (depth_ == 0 && std::find(leave_out_.begin(), leave_out_.end(), field.name) != leave_out_.end())
      return;
    text_ += std::string(depth_, ' ') + field.name + ": " + value + "\n";
  }
  template <class Value, class Show>
  void list(const Field& field, const std::vector<Value>& value, const Show& show) {
    std::string items;
    for (const auto& item : value) items += (items.empty() ? "" : ", ") + show(item);
    line(field, "[" + items + "]");
  }

  std::vector<std::string> leave_out_;
  size_t depth_ = 0;
  std::string text_;
};

class Describer : public LeafVisitor {
 public:
  void boolean(const Field& field, bool& value) override {
    add(field, "true|false", value ? "true" : "false", "");
  }
  void integer(const Field& field, int64_t& value, const IntegerRange& range) override {
    add(field, "integer", std::to_string(value), range_text(range));
  }
  void real(const Field& field, double& value, const RealRange& range) override {
    add(field, "real", real_text(value), range_text(range));
  }
  void text(const Field& field, std::string& value) override { add(field, "text", value, ""); }
  void choice(const Field& field, int& value, const std::vector<std::string>& names) override {
    add(field, joined(names, "|"), names.at(static_cast<size_t>(value)), "");
  }
  void integers(const Field& field, std::vector<int64_t>& value, const IntegerRange& range) override {
    std::vector<std::string> items;
    items.reserve(value.size());
    for (auto item : value) items.push_back(std::to_string(item));
    add(field, "list of integer", joined(items, ","), range_text(range));
  }
  void reals(const Field& field, std::vector<double>& value, const RealRange& range) override {
    std::vector<std::string> items;
    items.reserve(value.size());
    for (auto item : value) items.push_back(real_text(item));
    add(field, "list of real", joined(items, ","), range_text(range));
  }
  void texts(const Field& field, std::vector<std::string>& value) override {
    add(field, "list of text", joined(value, ","), "");
  }

  std::vector<OptionDescription> descriptions;

 private:
  void add(const Field& field, const std::string& type, const std::string& value, const std::string& range) {
    descriptions.push_back({key(field), field.help, type, value, range});
  }
};

class RangeChecker : public LeafVisitor {
 public:
  explicit RangeChecker(std::string where) : where_(std::move(where)) {}

  void boolean(const Field&, bool&) override {}
  void integer(const Field& field, int64_t& value, const IntegerRange& range) override {
    require(field, value, range, std::to_string(value));
  }
  void real(const Field& field, double& value, const RealRange& range) override {
    require(field, value, range, real_text(value));
  }
  void text(const Field&, std::string&) override {}
  void choice(const Field& field, int& value, const std::vector<std::string>& names) override {
    require(field, int64_t{value}, IntegerRange{0, static_cast<int64_t>(names.size()) - 1},
            std::to_string(value));
  }
  void integers(const Field& field, std::vector<int64_t>& value, const IntegerRange& range) override {
    for (auto item : value) require(field, item, range, std::to_string(item));
  }
  void reals(const Field& field, std::vector<double>& value, const RealRange& range) override {
    for (auto item : value) require(field, item, range, real_text(item));
  }
  void texts(const Field&, std::vector<std::string>&) override {}
  void group(const Field& field, OptionsGroup& value) override {
    LeafVisitor::group(field, value);
    value.check();
  }

 private:
  template <class Value, class Range>
  void require(const Field& field, Value value, const Range& range, const std::string& shown_value) const {
    if (value >= range.minimum && value <= range.maximum) return;  // false for NaN too
    fail({where_ + ", key " + quoted(key(field)), "a value in the range " + range_text(range), shown_value,
          "choose a value inside the range"});
  }

  std::string where_;
};

// Visiting never changes what these visitors only read; visit() is one function for reading and writing.
OptionsGroup& visitable(const OptionsGroup& options) { return const_cast<OptionsGroup&>(options); }

// Returns {a: {b: node}} for the key "a.b".
YAML::Node nested(const std::string& key, YAML::Node node) {
  std::stringstream parts(key);
  std::vector<std::string> names;
  for (std::string name; std::getline(parts, name, '.');) names.push_back(name);
  std::reverse(names.begin(), names.end());
  for (const auto& name : names) {
    YAML::Node outer(YAML::NodeType::Map);
    outer[name] = node;
    node.reset(outer);
  }
  return node;
}

}  // namespace

void load_yaml(OptionsGroup& options, const std::filesystem::path& file) {
  constexpr uint64_t kLargestConfiguration = 1 << 20;
  load_yaml_text(options, read_file(file, kLargestConfiguration), file.string());
}

void load_yaml_text(OptionsGroup& options, const std::string& text, const std::string& where) {
  assign(options, parse_yaml(text, where), {where, SourceKind::kFile});
}

void apply_setting(OptionsGroup& options, const std::string& setting) {
  const auto equals = setting.find('=');
  if (equals == std::string::npos || equals == 0) {
    fail({"--set", "key=value", quoted(setting), "write for example --set solver.evaluations=16"});
  }
  apply_setting(options, setting.substr(0, equals), setting.substr(equals + 1), "--set");
}

void apply_setting(OptionsGroup& options, const std::string& key, const std::string& value,
                   const std::string& where) {
  assign(options, nested(key, parse_yaml(value, where + ", key " + quoted(key))),
         {where, SourceKind::kSetting});
}

void apply_flag(OptionsGroup& options, const std::string& key, const std::string& value,
                const std::string& flag) {
  assign(options, nested(key, YAML::Node(value)), {flag, SourceKind::kFlag});
}

void load_json(OptionsGroup& options, const nlohmann::json& object, const std::string& where) {
  // JSON is a subset of YAML, so both share one reader and its messages.
  assign(options, parse_yaml(json_text(object), where), {where, SourceKind::kSetting});
}

std::string to_yaml(const OptionsGroup& options) { return to_yaml_without(options, {}); }

std::string to_yaml_without(const OptionsGroup& options, const std::vector<std::string>& leave_out) {
  YamlWriter writer(leave_out);
  visitable(options).visit(writer);
  return writer.yaml();
}

nlohmann::json to_json(const OptionsGroup& options) {
  JsonWriter writer;
  visitable(options).visit(writer);
  return writer.object;
}

void check_options(const OptionsGroup& options, const std::string& where) {
  RangeChecker checker(where);
  visitable(options).visit(checker);
  options.check();
}

std::vector<OptionDescription> describe_options(const OptionsGroup& options) {
  Describer describer;
  visitable(options).visit(describer);
  return describer.descriptions;
}

}  // namespace gld
