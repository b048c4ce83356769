#!/usr/bin/env bash
# Configures the release preset and builds the given targets, or everything: build/release/cli/gld. Safe to run again.
set -euo pipefail
cd "$(dirname "$0")/.."
cmake --preset release >/dev/null
if [ $# -eq 0 ]; then
  cmake --build --preset release
else
  cmake --build --preset release --target "$@"
fi
