#pragma once

#include "gld/base/mapped_file.h"

#include <filesystem>
#include <memory>
#include <string>

struct evp_md_ctx_st;  // OpenSSL's EVP_MD_CTX

namespace gld {

// SHA-256 (FIPS 180-4) by OpenSSL, which takes the processor's instructions for it; fed piece by piece.
class Sha256 {
 public:
  Sha256();  // Error when this OpenSSL was built or configured without SHA-256
  void update(ByteView bytes);
  void update(const std::string& bytes);
  // Returns 64 hexadecimal digits; the object must not be used afterwards.
  std::string hex_digest();

 private:
  struct FreeContext {
    void operator()(evp_md_ctx_st* context) const;
  };
  std::unique_ptr<evp_md_ctx_st, FreeContext> context_;
};

std::string sha256_of_file(const std::filesystem::path& file);

}  // namespace gld
