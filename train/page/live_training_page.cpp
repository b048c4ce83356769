#include "train/page/live_training_page.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/page/run_page.h"

#include <exception>

namespace gld {
namespace {

void write_page(const std::filesystem::path& run, const Page& page) {
  write_file_atomically(run / kPageFile, page_html(page));
}

}  // namespace

LiveTrainingPage::~LiveTrainingPage() {
  if (!ended_) stop();
}

void LiveTrainingPage::stop() noexcept {
  if (!written_) return;
  try {
    write_page(run_, unfinished_training_page(run_, UnfinishedTraining::kStopped));
  } catch (const std::exception&) {
    // What stopped the training, a full disk for one, is said by who stopped it.
  }
}

void LiveTrainingPage::follow() {
  const auto now = std::chrono::steady_clock::now();
  if (written_ && now - last_ < std::chrono::seconds(kTrainingPageSeconds)) return;
  written_ = true;
  last_ = now;
  try {
    write_page(run_, unfinished_training_page(run_, UnfinishedTraining::kGoesOn));
  } catch (const Error&) {
    // Its checkpoints matter more than its page, and say themselves what is wrong with the disk.
  }
}

void LiveTrainingPage::end() {
  ended_ = true;
  write_page(run_, training_page(run_));
}

}  // namespace gld
