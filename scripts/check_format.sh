#!/usr/bin/env bash
# Fails when clang-format would change a tracked source (scripts/check_format.sh --fix changes them), or where a line of
# comment goes beyond column 120, which clang-format is told to leave alone.
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
# Columns and not bytes; a table's row may be longer.
long=$(LC_ALL=C.UTF-8 grep -nE '^.{121,}$' "${files[@]}" | grep -E '^[^:]+:[0-9]+:\s*// ' | grep -vE 'NOLINT|// .*  ' | cut -d: -f1,2 || true)
if [ -n "$long" ]; then
  echo "check_format: expected comments of at most 120 columns, found longer ones; break these lines:" >&2
  echo "$long" >&2
  exit 1
fi
echo "check_format: ${#files[@]} sources are as clang-format writes them."
