// write_result_pages ROOT FOLDER writes the pages of a training, an evaluation and an ablation that are in the tree
// below ROOT, as train.html, eval.html and ablate.html, for the test in a browser.
#include "ablate/page/ablation_page.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "infer/page/eval_page.h"
#include "train/page/training_page.h"

#include <cstdio>
#include <filesystem>

int main(int count, char** words) {
  using namespace gld;
  if (count != 3) {
    std::fputs("write_result_pages: expected the tree and a folder, found others; name both.\n", stderr);
    return 2;
  }
  try {
    const std::filesystem::path root = words[1], folder = words[2];
    std::filesystem::create_directories(folder);
    write_file_atomically(folder / "train.html",
                          page_html(training_page(root / "configs/tiny/training/level/part_4")));
    write_file_atomically(folder / "eval.html", page_html(evaluation_page(root / "configs/tiny/evaluation")));
    write_file_atomically(folder / "ablate.html",
                          page_html(ablation_page(root / "docs/measured/ablations/sources")));
  } catch (const Error& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
  return 0;
}
