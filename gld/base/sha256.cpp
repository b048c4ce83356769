#include "gld/base/sha256.h"

#include "gld/base/error.h"

#include <array>
#include <fstream>
#include <vector>

#include <openssl/evp.h>

namespace gld {
namespace {

constexpr size_t kDigestBytes = 32;

void require(bool success) {
  if (!success) {
    fail({"SHA-256", "OpenSSL to compute it", "a refusal", "check how this machine's OpenSSL is configured"});
  }
}

}  // namespace

void Sha256::FreeContext::operator()(evp_md_ctx_st* context) const { EVP_MD_CTX_free(context); }

Sha256::Sha256() : context_(EVP_MD_CTX_new()) {
  require(context_ != nullptr && EVP_DigestInit_ex(context_.get(), EVP_sha256(), nullptr) == 1);
}

void Sha256::update(ByteView bytes) {
  if (bytes.size != 0) require(EVP_DigestUpdate(context_.get(), bytes.data, bytes.size) == 1);
}

void Sha256::update(const std::string& bytes) {
  update(ByteView{reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()});
}

std::string Sha256::hex_digest() {
  std::array<unsigned char, kDigestBytes> digest{};
  require(EVP_DigestFinal_ex(context_.get(), digest.data(), nullptr) == 1);
  static const char digits[] = "0123456789abcdef";
  std::string text;
  for (const unsigned char byte : digest) {
    text += digits[byte >> 4];
    text += digits[byte & 15];
  }
  return text;
}

std::string sha256_of_file(const std::filesystem::path& file) {
  // The file is read, not mapped: the pages of a mapped file would count as this process's memory.
  constexpr size_t kChunk = size_t{1} << 20;
  MappedFile::open(file);  // says what is wrong with a file that cannot be read
  std::ifstream stream(file, std::ios::binary);
  std::vector<char> chunk(kChunk);
  Sha256 hash;
  while (stream.read(chunk.data(), kChunk), stream.gcount() > 0) {
    hash.update(
        ByteView{reinterpret_cast<const uint8_t*>(chunk.data()), static_cast<size_t>(stream.gcount())});
  }
  if (stream.bad()) fail({file.string(), "a readable file", "a reading error", "check the disk"});
  return hash.hex_digest();
}

}  // namespace gld
