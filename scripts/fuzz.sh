#!/usr/bin/env bash
# Builds the fuzzers of the readers with clang, AddressSanitizer and UBSan, and runs each for some seconds from its corpus:
#   scripts/fuzz.sh                    # all, 10 seconds each, as CI does
#   scripts/fuzz.sh 600 hdf5 image     # these two, 10 minutes each
#   scripts/fuzz.sh --seed 7 60        # with libFuzzer's random numbers from a seed of one's own
# A run that takes more than 1 GiB, or 10 seconds for one file, fails like a crash. What was found lies in build/fuzz_found;
# put the smallest such file into tests/fuzz/corpus, which every build replays.
set -euo pipefail
cd "$(dirname "$0")/.."

seed=0 # of its own choice
if [ "${1:-}" = --seed ]; then
  seed=$2
  shift 2
fi
seconds=${1:-10}
[ $# -gt 0 ] && shift
kinds=("$@")
[ ${#kinds[@]} -gt 0 ] || kinds=(safetensors torch_archive npy hdf5 json yaml image colmap re10k ffprobe)

# For seconds they are taken from the build of scripts/test.sh, which is optimised a little; for longer they are worth their own.
if [ "$seconds" -le 10 ]; then
  build=build/asan
  cmake --preset asan >/dev/null
else
  build=build/fuzz
  cmake --preset asan -B "$build" -DCMAKE_CXX_FLAGS_RELWITHDEBINFO="-O2 -g -DNDEBUG" >/dev/null
fi
cmake --build "$build" --target "${kinds[@]/#/fuzz_}"

# Relative to this folder, whose own path may have a space.
export LSAN_OPTIONS=suppressions=tests/leak_suppressions.txt:print_suppressions=0
# libFuzzer's limit counts what AddressSanitizer keeps of freed memory as well: it is told to keep little.
export ASAN_OPTIONS=quarantine_size_mb=16:detect_odr_violation=0
found=$PWD/build/fuzz_found
# fuzz KIND: of one reader. Fails as it does.
fuzz() {
  local kind=$1 new log=$found/$1.log status=0
  mkdir -p "$found/$kind"
  new=$(mktemp -d)
  if "$build"/tests/fuzz/fuzz_"$kind" -seed="$seed" -max_total_time="$seconds" -rss_limit_mb=1024 -timeout=10 -print_final_stats=1 \
    -artifact_prefix="$found/$kind/" "$new" "tests/fuzz/corpus/$kind" >"$log" 2>&1; then
    echo "fuzz: $kind: $(grep -o 'number_of_executed_units: .*' "$log"), peak $(grep -o 'peak_rss_mb: .*' "$log")"
  else
    echo "fuzz: $kind failed; the end of $log:" >&2
    grep -E 'ERROR|SUMMARY|#[0-9]+ .*gld::|Test unit written' "$log" | head -20 >&2 || tail -20 "$log" >&2
    status=1
  fi
  rm -rf "$new"
  return "$status"
}

# One a core at a time; who ends this script ends them.
trap 'kill $(jobs -p) 2>/dev/null || true' EXIT
failed=0
running=0
for kind in "${kinds[@]}"; do
  if [ "$running" -ge "$(nproc)" ]; then
    wait -n || failed=$((failed + 1))
    running=$((running - 1))
  fi
  fuzz "$kind" &
  running=$((running + 1))
done
while [ "$running" -gt 0 ]; do
  wait -n || failed=$((failed + 1))
  running=$((running - 1))
done
if [ "$failed" -gt 0 ]; then
  echo "fuzz: $failed of ${#kinds[@]} readers failed." >&2
  exit 1
fi
