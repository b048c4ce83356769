#!/usr/bin/env bash
# Fails when clang-format would change a tracked source; scripts/check_format.sh --fix changes them.
set -euo pipefail
cd "$(dirname "$0")/.."
mapfile -t files < <(git ls-files -- '*.cpp' '*.h')
if [ "${1:-}" = --fix ]; then
  clang-format -i "${files[@]}"
  exit
fi
if ! clang-format --dry-run -Werror "${files[@]}"; then
  echo "check_format: expected sources as clang-format writes them, found others; run scripts/check_format.sh --fix." >&2
  exit 1
fi
echo "check_format: ${#files[@]} sources are as clang-format writes them."
