#include "gld/base/sha256.h"

#include "gld/base/atomic_file.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <string>
#include <utility>

#include <gtest/gtest.h>

namespace gld {
namespace {

std::string digest(const std::string& text) {
  Sha256 hash;
  hash.update(text);
  return hash.hex_digest();
}

// FIPS 180-4's own examples.
TEST(Sha256, KnownDigests) {
  EXPECT_EQ(digest(""), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  EXPECT_EQ(digest("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  EXPECT_EQ(digest("abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq"),
            "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1");
  EXPECT_EQ(digest(std::string(1000000, 'a')),
            "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
}

TEST(Sha256, PiecesDoNotMatter) {
  const std::string text(300, 'g');
  for (size_t cut = 0; cut <= text.size(); cut += 13) {
    Sha256 hash;
    hash.update(text.substr(0, cut));
    hash.update(text.substr(cut));
    EXPECT_EQ(hash.hex_digest(), digest(text)) << cut;
  }
  const test::TemporaryFolder folder;
  write_file_atomically(folder.path() / "f", text);
  EXPECT_EQ(sha256_of_file(folder.path() / "f"), digest(text));
}

TEST(Sha256, AnObjectTakenOverGoesOn) {
  Sha256 first;
  first.update(std::string("ab"));
  Sha256 second = std::move(first);
  second.update(ByteView());
  second.update(std::string("c"));
  EXPECT_EQ(second.hex_digest(), digest("abc"));
}

TEST(Sha256, SaysWhichFileIsMissing) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "weights";
  EXPECT_EQ(test::error_of([&] { sha256_of_file(file); }),
            file.string() + ": expected a readable file, found No such file or directory; check the path.");
}

}  // namespace
}  // namespace gld
