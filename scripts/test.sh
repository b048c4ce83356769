#!/usr/bin/env bash
# From a clean Debian 12 machine to green: installs, builds, runs every test, fails if one is skipped. Needs nothing beside
# the clone; the tests of the label shared, which do, are run with ctest -L shared (CONTRIBUTING.md).
#   --libtorch DIR    with that LibTorch instead of Debian's (scripts/build.sh): the program, its reference cases and every test
#                     that LibTorch has a part in (the label libtorch); the others would be the same once more
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/build_folder.sh
if [ ${#rest[@]} -ne 0 ]; then
  echo "test: expected nothing or --libtorch DIR, found '${rest[*]}'." >&2
  exit 2
fi
selection=(-LE '^shared$')
targets=()
if [ -n "$libtorch" ]; then
  selection=(-L '^libtorch$')
  targets=(--target gld tests_of_libtorch)
fi

scripts/setup.sh
cmake --preset release -B "$build_folder" "${configuration[@]}" >/dev/null
cmake --build "$build_folder" "${targets[@]}"

# The parts without LibTorch once more under AddressSanitizer and UBSan.
if [ -z "$libtorch" ]; then
  cmake --preset asan >/dev/null
  cmake --build --preset asan
  ctest --preset asan --no-tests=error --timeout 900 -j 2
fi

log=$(mktemp)
trap 'rm -f "$log"' EXIT
ctest --test-dir "$build_folder" --output-on-failure "${selection[@]}" --no-tests=error --timeout 1800 -j 2 | tee "$log"
if grep -qE 'Not Run|\*\*\*Skipped|Disabled' "$log"; then
  echo "test: a test was skipped; every test must run." >&2
  exit 1
fi
"$build_folder"/cli/gld verify tests/data/reference_cases/* | tail -1
