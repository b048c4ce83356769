#!/usr/bin/env bash
# From a clean Debian 12 machine to green: installs, builds, runs every test, fails if one is skipped. Needs nothing beside
# the clone; the tests of the label shared, which do, are run with ctest -L shared (CONTRIBUTING.md).
set -euo pipefail
cd "$(dirname "$0")/.."

scripts/setup.sh
scripts/build.sh

# The parts without LibTorch once more under AddressSanitizer and UBSan.
cmake --preset asan >/dev/null
cmake --build --preset asan
ctest --preset asan --no-tests=error --timeout 900 -j 2

log=$(mktemp)
trap 'rm -f "$log"' EXIT
ctest --preset release --no-tests=error --timeout 1800 -j 2 | tee "$log"
if grep -qE 'Not Run|\*\*\*Skipped|Disabled' "$log"; then
  echo "test: a test was skipped; every test must run." >&2
  exit 1
fi
