#!/usr/bin/env bash
# Runs clang-tidy (.clang-tidy's checks) and fails on a finding. Usage:
#   scripts/tidy.sh                   every source, up to 16 of a room at a time: a fifth of the time of one by one
#   scripts/tidy.sh FILE...           these sources
#   scripts/tidy.sh --since COMMIT    sources whose content differs from every file of that commit, include lines and
#                                     comments aside; of a changed header the source of its name, or one that includes it
# --minutes N, in front of these, stops starting new files after that time and names those that were left out.
set -euo pipefail
cd "$(dirname "$0")/.."
build=build/tidy
minutes=100000
unity=OFF

# The hashes of files' contents without include lines, comments and white space: HASH FILE a line.
content_hashes() {
  local file
  while IFS= read -r file; do
    printf '%s %s\n' "$("$@" "$file" | sed -E '/^#(include|pragma once)/d; /NOLINT/!s,(^|[[:space:]])//.*,,' | tr -d '[:space:]' | sha256sum | cut -d' ' -f1)" "$file"
  done
}

# Sources whose bytes are not those of the commit's file of that name.
differing_from() { git diff --name-only --diff-filter=d "$1" -- '*.cpp' '*.h' | grep -E '^(gld|models|datasets|train|infer|bench|verify|ablate|library|cli|tests)/' || true; }

sources_of() { git ls-files -- '*.cpp' '*.h' | grep -E '^(gld|models|datasets|train|infer|bench|verify|ablate|library|cli|tests)/'; }

at_commit() { git cat-file blob "$commit:$1"; }

changed_since() {
  commit=$1
  local differing changed
  differing=$(differing_from "$commit")
  if [ -z "$differing" ]; then return; fi
  changed=$(awk 'NR == FNR { known[$1] = 1; next } !($1 in known) { print $2 }' \
    <(git ls-tree -r --name-only "$commit" | grep -E '\.(cpp|h)$' | content_hashes at_commit) \
    <(content_hashes cat <<<"$differing"))
  local file source
  for file in $changed; do
    case $file in
      *.cpp) echo "$file" ;;
      *) source=${file%.h}.cpp
        if [ ! -f "$source" ]; then source=$(git grep -lF "#include \"$file\"" -- '*.cpp' | head -1 || true); fi
        [ -z "$source" ] || echo "$source" ;;
    esac
  done | sort -u
}

if [ "${1:-}" = --minutes ]; then
  minutes=$2
  shift 2
fi
if [ "${1:-}" = --since ]; then
  if ! git cat-file -e "$2^{commit}" 2>/dev/null; then
    echo "tidy: expected the commit $2 in this clone, found none; fetch the whole history, or name files." >&2
    exit 2
  fi
  mapfile -t files < <(changed_since "$2")
elif [ $# -gt 0 ]; then
  files=("$@")
else
  files=()
  unity=ON
fi
if [ "$unity" = OFF ] && [ ${#files[@]} -eq 0 ]; then
  echo "tidy: no source has changed."
  exit 0
fi

# A configuration of its own: clang cannot read g++'s precompiled header, and a unity build has no commands for single
# sources. Nothing is built in it but a header that is written.
cmake -S . -B "$build" -G Ninja -DCMAKE_BUILD_TYPE=Release -DGLD_UNITY=$unity -DCMAKE_DISABLE_PRECOMPILE_HEADERS=ON >/dev/null
cmake --build "$build" --target gld_commit gld/page/embedded_page.cpp >/dev/null

# Sources that this build leaves out (the fuzzers) have no command.
known=$(sed -nE 's/^ *"file": "(.*)",?$/\1/p' "$build/compile_commands.json")
checked=()
if [ "$unity" = ON ]; then
  mapfile -t checked <<<"${known//"$PWD/"/}"
else
  for file in "${files[@]}"; do
    if grep -qxF "$PWD/$file" <<<"$known"; then checked+=("$file"); else echo "tidy: $file is in no target of this build"; fi
  done
fi

results=$(mktemp -d)
trap 'rm -rf "$results"' EXIT
export build results
tidy_one() {
  local name=${1//\//_}
  if [ "$(date +%s)" -ge "$stop_at" ]; then echo "$1" >"$results/$name.left"; return; fi
  # clang does not know all of g++'s options and pragmas. The filter is .clang-tidy's and the sources that a unity file
  # includes.
  if ! clang-tidy -p "$build" --quiet --extra-arg=-Wno-unknown-warning-option --extra-arg=-Wno-unknown-pragmas \
    --extra-arg=-Wno-unused-command-line-argument --header-filter='(gld|models|datasets|train|infer|bench|verify|ablate|library|cli|tests)/.*\.(h|cpp)$' "$1" >"$results/$name.log" 2>"$results/$name.stderr"; then
    echo "$1" >"$results/$name.failed"
    cat "$results/$name.log"
    grep -E '(error|fatal)' "$results/$name.stderr" || true
  fi
}
export -f tidy_one
stop_at=$(($(date +%s) + 60 * minutes))
export stop_at
printf '%s\n' "${checked[@]}" | xargs -P "$(nproc)" -I{} bash -c 'tidy_one "$1"' _ {}

left=$(cat "$results"/*.left 2>/dev/null || true)
failed=$(cat "$results"/*.failed 2>/dev/null || true)
if [ -n "$left" ]; then
  echo "tidy: $minutes minutes are over; left out $(wc -l <<<"$left") of ${#checked[@]} sources:"
  echo "$left"
fi
if [ -n "$failed" ]; then
  echo "tidy: findings in $(wc -l <<<"$failed") sources:" >&2
  echo "$failed" >&2
  exit 1
fi
echo "tidy: no finding."
