#!/usr/bin/env bash
# From a clean Debian 12 machine to green: installs, builds, runs every test, fails if one is skipped. Needs nothing beside
# the clone; the tests of the label shared, which do, are run with ctest -L shared (CONTRIBUTING.md). Tests for hardware
# that this machine lacks are left out, and the last lines count them.
#   --libtorch DIR    with that LibTorch instead of Debian's (scripts/build.sh): the program, its reference cases and the tests
#                     of the rooms that call LibTorch (the label libtorch); the others would be the same once more
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/build_folder.sh
. scripts/hardware_labels.sh
if [ ${#rest[@]} -ne 0 ]; then
  echo "test: expected nothing or --libtorch DIR, found '${rest[*]}'." >&2
  exit 2
fi
selection=()
targets=()
if [ -n "$libtorch" ]; then
  selection=(-L '^libtorch$')
  targets=(--target gld gld_missing_hardware tests_of_libtorch)
fi

# Tests run two at a time, each with threads of its own: a thread that waits for work sleeps, instead of keeping a core from the
# other test (two short trainings at once: 41 s spinning, 35 s sleeping, on two cores).
export OMP_WAIT_POLICY=passive OPENBLAS_THREAD_TIMEOUT=4

scripts/setup.sh --testing
cmake --preset release -B "$build_folder" "${configuration[@]}" >/dev/null
cmake --build "$build_folder" "${targets[@]}"

# The parts without LibTorch once more under AddressSanitizer and UBSan.
if [ -z "$libtorch" ]; then
  cmake --preset asan >/dev/null
  cmake --build --preset asan
  ctest --test-dir build/asan --output-on-failure -LE "$(left_out build/asan shared)" --no-tests=error --timeout 900 -j 2
fi

log=$(mktemp)
trap 'rm -f "$log"' EXIT
ctest --test-dir "$build_folder" --output-on-failure "${selection[@]}" -LE "$(left_out "$build_folder" shared)" --no-tests=error --timeout 1800 -j 2 | tee "$log"
if grep -qE 'Not Run|\*\*\*Skipped|Disabled' "$log"; then
  echo "test: a test was skipped; every test must run." >&2
  exit 1
fi
echo "the slowest ten:"
sed -nE 's/^ *[0-9]+\/[0-9]+ Test +#[0-9]+: ([^ ]+) .* ([0-9.]+) sec.*$/  \2 s  \1/p' "$log" | sort -k1 -rn | head -n 10 || true
"$build_folder"/cli/gld verify tests/data/reference_cases/* | tail -1
say_what_did_not_run "$build_folder" "${selection[@]}"
