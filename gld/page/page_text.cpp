#include "gld/page/page_text.h"

#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/printable_text.h"
#include "gld/base/sha256.h"

#include <algorithm>

#include <zlib.h>

namespace gld {
namespace {

std::string bytes_of_hex(const std::string& hex) {
  std::string bytes;
  for (size_t i = 0; i + 1 < hex.size(); i += 2) {
    bytes.push_back(static_cast<char>(std::stoi(hex.substr(i, 2), nullptr, 16)));
  }
  return bytes;
}

}  // namespace

std::string base64_text(std::string_view bytes) {
  static const char* const digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (size_t i = 0; i < bytes.size(); i += 3) {
    uint32_t three = 0;
    for (size_t k = 0; k < 3; ++k) {
      three = three << 8 | (i + k < bytes.size() ? static_cast<uint8_t>(bytes[i + k]) : 0u);
    }
    const size_t known = std::min<size_t>(3, bytes.size() - i);
    for (size_t k = 0; k < 4; ++k) text.push_back(k <= known ? digits[three >> (18 - 6 * k) & 63] : '=');
  }
  return text;
}

std::string deflated(std::string_view bytes) {
  uLongf size = compressBound(static_cast<uLong>(bytes.size()));
  std::string result(size, '\0');
  const int status =
      compress2(reinterpret_cast<Bytef*>(result.data()), &size, reinterpret_cast<const Bytef*>(bytes.data()),
                static_cast<uLong>(bytes.size()), Z_BEST_COMPRESSION);
  if (status != Z_OK) {
    fail({"zlib", "to compress " + std::to_string(bytes.size()) + " bytes",
          "its error " + std::to_string(status), "free some memory"});
  }
  result.resize(size);
  return result;
}

std::string escaped_text(std::string_view text) {
  std::string html;
  for (const char c : text) {
    switch (c) {
      case '&':
        html += "&amp;";
        break;
      case '<':
        html += "&lt;";
        break;
      case '>':
        html += "&gt;";
        break;
      case '"':
        html += "&quot;";
        break;
      case '\'':
        html += "&#39;";
        break;
      default:
        html += c;
    }
  }
  return html;
}

std::string html_text(const std::string& text) { return escaped_text(printable_text(text)); }

std::string script_json(const nlohmann::ordered_json& value) {
  const std::string plain = json_text(value);
  std::string text;
  text.reserve(plain.size());
  // Outside of strings JSON has none of these.
  for (const char c : plain) {
    if (c == '<') {
      text += "\\u003c";
    } else if (c == '>') {
      text += "\\u003e";
    } else if (c == '&') {
      text += "\\u0026";
    } else {
      text += c;
    }
  }
  return text;
}

std::string data_address(const std::string& media_type, std::string_view bytes) {
  return "data:" + media_type + ";base64," + base64_text(bytes);
}

std::string policy_hash(std::string_view text) {
  Sha256 hash;
  hash.update(std::string(text));
  return "'sha256-" + base64_text(bytes_of_hex(hash.hex_digest())) + "'";
}

}  // namespace gld
