#include "gld/base/json_text.h"

#include "gld/base/error.h"

#include <algorithm>
#include <cctype>
#include <set>
#include <vector>

namespace gld {
namespace {

constexpr size_t kDeepestNesting = 64;
constexpr size_t kMostValues = 20'000'000;

[[noreturn]] void fail_at(const std::string& text, size_t byte, const std::string& where,
                          const std::string& expected, const std::string& found, const std::string& remedy) {
  const auto end = text.begin() + static_cast<std::ptrdiff_t>(std::min(byte, text.size()));
  fail({where + ":" + std::to_string(1 + std::count(text.begin(), end, '\n')), expected, found, remedy});
}

// Checks the depth and the number of values before anything is built. What is no JSON may pass: the parser refuses it.
void check_size(const std::string& text, const std::string& where) {
  size_t depth = 0, values = 1;
  bool in_string = false;
  for (size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (in_string) {
      if (c == '\\') ++i;
      if (c == '"') in_string = false;
      continue;
    }
    if (c == '"') in_string = true;
    if (c == '[' || c == '{') {
      if (++depth > kDeepestNesting) {
        fail_at(text, i, where, "JSON nested at most " + std::to_string(kDeepestNesting) + " deep", "more",
                "check that it is the right file");
      }
      ++values;
    }
    if ((c == ']' || c == '}') && depth > 0) --depth;
    if (c == ',' && ++values > kMostValues) {
      fail({where, "at most " + std::to_string(kMostValues) + " values", "more",
            "check that it is the right file"});
    }
  }
}

// Returns whether the word that an error ended in is one that some programs write for numbers that JSON does not have.
bool names_no_number(const std::string& text, size_t error_end) {
  const auto is_letter = [&](size_t i) { return std::isalpha(static_cast<unsigned char>(text[i])) != 0; };
  size_t begin = std::min(error_end, text.size()), end = begin;
  while (begin > 0 && is_letter(begin - 1)) --begin;
  while (end < text.size() && is_letter(end)) ++end;
  const std::string word = text.substr(begin, end - begin);
  return word == "NaN" || word == "nan" || word == "Infinity" || word == "inf";
}

template <class Json>
Json parse_as(const std::string& text, const std::string& where) {
  check_size(text, where);
  std::vector<std::set<std::string>> keys;  // of the objects that are open
  // The parser would take the last of two values of one key.
  const auto each_key_once = [&](int /*depth*/, typename Json::parse_event_t event, Json& parsed) {
    if (event == Json::parse_event_t::object_start) keys.emplace_back();
    if (event == Json::parse_event_t::object_end) keys.pop_back();
    if (event == Json::parse_event_t::key && !keys.back().insert(parsed.template get<std::string>()).second) {
      fail({where, "each key of an object once", "\"" + parsed.template get<std::string>() + "\" twice",
            "remove one of them"});
    }
    return true;
  };
  try {
    return Json::parse(text, each_key_once);
  } catch (const typename Json::parse_error& error) {
    const size_t end = std::min(error.byte, text.size());
    const bool not_finite = names_no_number(text, end);
    const bool not_utf8 = std::string(error.what()).find("UTF-8") != std::string::npos;
    fail_at(text, end, where, "JSON",
            not_finite ? "NaN or Infinity, which are no JSON"
            : not_utf8 ? "text that is no UTF-8"
                       : "a syntax error",
            not_finite ? "write null or leave the value out" : "correct the file");
  } catch (const typename Json::out_of_range&) {
    fail({where, "numbers up to 1.8e308", "a larger one", "correct the value"});
  }
}

}  // namespace

nlohmann::json parse_json(const std::string& text, const std::string& where) {
  return parse_as<nlohmann::json>(text, where);
}

nlohmann::ordered_json parse_ordered_json(const std::string& text, const std::string& where) {
  return parse_as<nlohmann::ordered_json>(text, where);
}

std::string json_text(const nlohmann::json& value, int indent) {
  return value.dump(indent, ' ', /*ensure_ascii=*/false, nlohmann::json::error_handler_t::replace);
}

std::string json_text(const nlohmann::ordered_json& value, int indent) {
  return value.dump(indent, ' ', /*ensure_ascii=*/false, nlohmann::ordered_json::error_handler_t::replace);
}

}  // namespace gld
