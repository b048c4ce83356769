#include "gld/base/yaml_text.h"

#include "gld/base/error.h"

#include <cstdint>
#include <cstring>
#include <set>
#include <sstream>
#include <string>

namespace gld {
namespace {

// yaml-cpp takes a key that is there twice, and gives the first value. Aliases make a graph of a document, with circles
// too: options are no deeper than this, nor more.
constexpr int kDeepestYaml = 64;
constexpr int64_t kMostYamlNodes = 1'000'000;

void refuse_duplicate_keys(const YAML::Node& node, const std::string& where, int depth, int64_t& nodes) {
  if (depth > kDeepestYaml || ++nodes > kMostYamlNodes) {
    fail({where, "YAML of at most " + std::to_string(kDeepestYaml) + " levels and a million values",
          depth > kDeepestYaml ? "deeper levels" : "more values", "remove aliases that repeat each other"});
  }
  if (node.IsSequence()) {
    for (const auto& item : node) refuse_duplicate_keys(item, where, depth + 1, nodes);
  }
  if (!node.IsMap()) return;
  std::set<std::string> known;
  for (const auto& entry : node) {
    if (entry.first.IsScalar() && !known.insert(entry.first.Scalar()).second) {
      fail({where + ":" + std::to_string(entry.first.Mark().line + 1), "every key once",
            "'" + entry.first.Scalar() + "' a second time", "remove one of the two"});
    }
    refuse_duplicate_keys(entry.second, where, depth + 1, nodes);
  }
}

bool is_marker(const std::string& line, const char* marker) {
  return line.rfind(marker, 0) == 0 && (line.size() == 3 || std::strchr(" \t\r", line[3]) != nullptr);
}

// A line that begins with "---" begins a document wherever it stands, "..." ends one, and what stands behind begins
// another (YAML 1.2, 9.1.2). They are looked for in the text, because YAML::LoadAll does not end on some damaged ones,
// such as ",1[ 2]: 3".
int64_t documents_in(const std::string& text) {
  int64_t documents = 0;
  bool open = false;
  constexpr const char* kByteOrderMark = "\xef\xbb\xbf";
  std::istringstream lines(text.rfind(kByteOrderMark, 0) == 0 ? text.substr(3) : text);
  for (std::string line; std::getline(lines, line);) {
    const size_t first = line.find_first_not_of(" \t\r");
    if (is_marker(line, "...")) {
      open = false;
      continue;
    }
    const bool text_without_marker =
        !open && first != std::string::npos && line[first] != '#' && line[0] != '%';
    if (!is_marker(line, "---") && !text_without_marker) continue;
    ++documents;
    open = true;
  }
  return documents;
}

}  // namespace

YAML::Node parse_yaml(const std::string& text, const std::string& where) {
  try {
    const int64_t documents = documents_in(text);
    if (documents > 1) {
      fail({where, "one YAML document", std::to_string(documents), "keep one of them"});
    }
    const YAML::Node document = YAML::Load(text);
    int64_t nodes = 0;
    refuse_duplicate_keys(document, where, 0, nodes);
    return document;
  } catch (const YAML::Exception& error) {
    const std::string line = error.mark.line >= 0 ? ":" + std::to_string(error.mark.line + 1) : "";
    // yaml-cpp's words for "title: a: b".
    const bool colon = error.msg.find("illegal map value") != std::string::npos;
    fail({where + line, "valid YAML", error.msg,
          colon ? "put a text that has a colon in it in quotes" : "correct the text"});
  }
}

}  // namespace gld
