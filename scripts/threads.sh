#!/usr/bin/env bash
# ThreadSanitizer over everything that has threads: a model trained for two steps with two workers, the loader's threads and
# validation, its statistics, a scene sampled with a page and with splats, scenes drawn, and the tests of what is parallel.
# Needs clang with its OpenMP (scripts/setup.sh --development), whose Archer tells ThreadSanitizer of OpenMP's barriers. LibTorch is
# not instrumented: what happens in it alone is not seen. A report fails. From nothing half an hour on 2 cores.
set -euo pipefail
cd "$(dirname "$0")/.."
build=build/threads
cmake -S . -B "$build" -G Ninja -DCMAKE_BUILD_TYPE=RelWithDebInfo "-DCMAKE_CXX_FLAGS_RELWITHDEBINFO=-O1 -g1 -DNDEBUG" \
  -DCMAKE_CXX_COMPILER=clang++-14 -DGLD_SANITIZE_THREADS=ON -DGLD_WARNINGS_AS_ERRORS=OFF >/dev/null
cmake --build "$build" --target gld

archer=$(ls /usr/lib/llvm-14/lib/libarcher.so 2>/dev/null || true)
if [ -z "$archer" ]; then
  echo "threads: expected /usr/lib/llvm-14/lib/libarcher.so (scripts/setup.sh --development), found none." >&2
  exit 1
fi
export OMP_TOOL_LIBRARIES=$archer OMP_NUM_THREADS=2
export TSAN_OPTIONS="suppressions=$PWD/tests/thread_suppressions.txt ignore_noninstrumented_modules=1 exitcode=66 second_deadlock_stack=1"

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
gld=$build/cli/gld
found=()
# check WHAT COMMAND...
check() {
  local what=$1 status=0
  shift
  "$@" >"$work/log" 2>&1 || status=$?
  if [ $status -eq 0 ]; then
    echo "threads: $what: nothing found"
  else
    echo "threads: $what: status $status" >&2
    cat "$work/log" >&2
    found+=("$what")
  fi
}
check "drawing scenes" "$gld" synth --seed 5 --scene-count 2 --frames 6 --width 112 --height 112 --threads 2 --out "$work/drawn"
scene=$(dirname "$(find "$work/drawn" -name cameras.json | sort | head -1)")
for kind in backbone decoder level cascade; do
  check "training, $kind" "$gld" train "$kind" --config "configs/tiny/${kind/backbone/head}.yaml" --model configs/tiny --steps 2 --workers 2 \
    --loader-threads 2 --threads 2 --validate-every 1 --validation-scenes 2 --distinct-batches 4 --out "$work/$kind"
done
check "statistics" "$gld" stats --model configs/tiny --data.synthetic.scene-count 2 --scene-count 2 --threads 2 --out "$work/stats"
check "sampling" "$gld" sample --model configs/tiny --scene "$scene" --sources 0,5 --targets 2 --evaluations 2 --threads 2 \
  --outputs image,depth,rays,points,splats,page --splats.steps 20 --out "$work/sampled"
check "evaluation" "$gld" eval --model configs/tiny --synthetic 2 --evaluations 2 --threads 2 --out "$work/evaluated"
check "splats" "$gld" splat fit --scene "$scene" --held-out 2 --fit.steps 20 --threads 2 --out "$work/splats"
if [ ${#found[@]} -gt 0 ]; then
  printf 'threads: findings in: %s\n' "${found[*]}" >&2
  exit 1
fi
