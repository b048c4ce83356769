#include "infer/sample/background_hash.h"

namespace gld {

BackgroundHash::BackgroundHash(const ModelBundle& bundle)
    : running_(std::async(std::launch::async, [bundle] { return bundle.content_hash(); })) {}

const std::string& BackgroundHash::get() {
  if (running_.valid()) hash_ = running_.get();
  return hash_;
}

}  // namespace gld
