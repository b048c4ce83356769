#!/usr/bin/env bash
# Configures the release preset and builds the given targets, or everything: build/release/cli/gld. Safe to run again.
#   --libtorch DIR    with that LibTorch (an unpacked one, or the folder torch of PyTorch's package) instead of Debian's:
#                     build/libtorch-VERSION/cli/gld
#   --quick           by clang, nothing but the kernels optimised, for checks and not for use (setup.sh --testing): build/release-quick/cli/gld,
#                     with --libtorch build/libtorch-VERSION-quick/cli/gld
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/build_folder.sh
cmake --preset release -B "$build_folder" "${configuration[@]}" >/dev/null
if [ ${#rest[@]} -eq 0 ]; then
  cmake --build "$build_folder"
else
  cmake --build "$build_folder" --target "${rest[@]}"
fi
