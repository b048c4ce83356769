#!/usr/bin/env bash
# Builds the program with clang's ThreadSanitizer (build/thread_sanitizer, about 15 minutes on two cores) and runs what computes with threads:
# a small model trained by two workers beside loader threads, stopped and resumed; a scene sampled with every output; photographs
# without cameras; splats; rooms drawn. Ends with the data races that were found, of which there should be none.
# LibTorch, OpenMP's runtime and the other libraries are not instrumented: scripts/thread_sanitizer.supp says what follows from that.
set -euo pipefail
cd "$(dirname "$0")/.."
build=build/thread_sanitizer
cmake --preset release -B "$build" -DCMAKE_CXX_COMPILER=clang++-14 \
  "-DCMAKE_CXX_FLAGS_RELEASE=-O1 -g1 -DNDEBUG -fsanitize=thread" -DCMAKE_EXE_LINKER_FLAGS=-fsanitize=thread >/dev/null
cmake --build "$build" --target gld
gld=$build/cli/gld

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
# libarcher tells ThreadSanitizer what OpenMP's barriers and locks order.
archer=/usr/lib/llvm-14/lib/libarcher.so
if [ ! -f "$archer" ]; then
  echo "thread_sanitizer: expected $archer, found none; install libomp-14-dev (scripts/setup.sh --development)." >&2
  exit 1
fi
export OMP_TOOL_LIBRARIES=$archer
export TSAN_OPTIONS="suppressions=scripts/thread_sanitizer.supp ignore_noninstrumented_modules=1 halt_on_error=0 exitcode=66 log_path=$work/race"
# That a race is seen at all, in OpenMP's loops too: this has one.
printf 'int main() { int x = 0;\n#pragma omp parallel for num_threads(2)\nfor (int i = 0; i < 1000; ++i) x += i;\nreturn x == 1; }\n' >"$work/probe.cpp"
clang++-14 -O1 -g1 -fsanitize=thread -fopenmp "$work/probe.cpp" -o "$work/probe"
"$work/probe" >/dev/null 2>&1 || true
if ! cat "$work"/race.* 2>/dev/null | grep -q '^WARNING: ThreadSanitizer'; then
  echo "thread_sanitizer: expected the race of a probe to be reported, found none: libarcher or clang does not see OpenMP here." >&2
  exit 1
fi
rm "$work"/race.*

# 66: it ended well, and races were reported. A run that leaves nothing did not run.
number=0
run() {
  number=$((number + 1))
  echo "thread_sanitizer: gld $*"
  local status=0
  "$gld" "$@" --out "$work/$number" >"$work/log" 2>&1 || status=$?
  if { [ "$status" -ne 0 ] && [ "$status" -ne 66 ]; } || [ ! -f "$work/$number/config.yaml" ]; then
    echo "thread_sanitizer: expected a run in $work/$number, found exit status $status:" >&2
    tail -5 "$work/log" >&2
    cat "$work"/race.* >&2 2>/dev/null || true
    exit 1
  fi
}
small=(--set data.validation_scenes=1 --set data.distinct_batches=4)
run synth --seed 5 --scene-count 1 --frames 6 --width 112 --height 112 --threads 2
scene=$(dirname "$(find "$work/1" -name cameras.json | head -1)")
run train level --config configs/tiny/level.yaml --model configs/tiny "${small[@]}" --batch-size 1 --set loop.micro_batches=2 --loop.workers 2 \
  --set loop.loader_threads=2 --steps 2 --threads 2 --set objective.start=bundle --set objective.kept_latents_gib=1
run train blending --config configs/tiny/blending.yaml --model configs/tiny "${small[@]}" --batch-size 2 --set loop.micro_batches=2 --loop.workers 2 \
  --set loop.loader_threads=2 --steps 2 --threads 2
run sample --model configs/tiny --scene "$scene" --sources 0,4 --targets 2 --evaluations 2 --threads 2 \
  --outputs image,depth,rays,points,latents,splats,page --steps 20
run sample --model configs/tiny --photos "$scene/images" --frames 1 --evaluations 2 --threads 2
run splat fit --scene "$scene" --steps 20 --threads 2
run eval --model configs/tiny --synthetic 1 --samples 2 --threads 2

races=$(cat "$work"/race.* 2>/dev/null | grep -c '^WARNING: ThreadSanitizer' || true)
if [ "$races" -gt 0 ]; then
  mkdir -p "$build/races"
  cp "$work"/race.* "$build/races/"
  grep -h -A1 '^SUMMARY: ThreadSanitizer' "$work"/race.* | sort | uniq -c | sort -rn | head -20
  echo "thread_sanitizer: expected no report, found $races; they lie in $build/races." >&2
  exit 1
fi
echo "thread_sanitizer: no data race in $number runs"
