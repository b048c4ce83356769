#pragma once

#include <string>

#include <nlohmann/json.hpp>

namespace gld {

// Parses JSON of unknown origin. Throws one Error that names where and the line, for what is no JSON (NaN and Infinity
// are not), text that is no UTF-8, numbers beyond the range of doubles, lists and objects nested more than 64 deep (the
// JSON library copies, compares and writes values recursively, and the stack ends), or more than 20 million values.
nlohmann::json parse_json(const std::string& text, const std::string& where);
nlohmann::ordered_json parse_ordered_json(const std::string& text, const std::string& where);

// Returns JSON text; bytes that are no UTF-8 (a file's name may hold any) become U+FFFD instead of an exception. An
// indent of -1 gives one line.
std::string json_text(const nlohmann::json& value, int indent = -1);
std::string json_text(const nlohmann::ordered_json& value, int indent = -1);

}  // namespace gld
