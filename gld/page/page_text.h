#pragma once

#include <string>
#include <string_view>

#include <nlohmann/json.hpp>

namespace gld {

// How bytes and texts stand in a page.

std::string base64_text(std::string_view bytes);

// Returns bytes in zlib's format (RFC 1950), which browsers call "deflate". Equal input gives equal bytes.
std::string deflated(std::string_view bytes);

// Returns text as HTML, line by line as it is: &, <, > and quotes become entities.
std::string escaped_text(std::string_view text);

// Returns text of unknown origin as HTML, between tags and inside quoted attributes, of its printable_text().
std::string html_text(const std::string& text);

// Returns JSON on one line that may stand inside a script element: nothing in it ends the element or begins a comment.
std::string script_json(const nlohmann::ordered_json& value);

// Returns "data:image/png;base64,...".
std::string data_address(const std::string& media_type, std::string_view bytes);

// Returns base64 of the SHA-256 of a text, as a policy names an inline script: "'sha256-...'".
std::string policy_hash(std::string_view text);

}  // namespace gld
