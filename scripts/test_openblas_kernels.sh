#!/usr/bin/env bash
# The tests of the label multiplies once under each of OpenBLAS's kernels that this processor can run, and once with 1 and
# once with 2 threads under the one that OpenBLAS chooses: what is promised to the bit, or within a bound that a test derives,
# must not hang on the order in which a BLAS sums. compute_threads_test checks that the kernel is the one that was asked for.
#   test_openblas_kernels.sh [BUILD]    a folder of tests that are built, build/release by default
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/hardware_labels.sh
build=${1:-build/release}

has() {
  local flag
  for flag in "$@"; do
    grep -qw "$flag" /proc/cpuinfo || return 1
  done
}

kernels=()
has sse4_2 && kernels+=(Nehalem)
has avx2 fma && kernels+=(Zen)
has avx512f avx512dq avx512bw avx512vl avx512cd && kernels+=(SkylakeX)
has avx512_bf16 avx512f avx512dq avx512bw avx512vl && kernels+=(Cooperlake)
if [ ${#kernels[@]} -eq 0 ]; then
  echo "test_openblas_kernels: expected a processor that runs at least one of OpenBLAS's kernels by name, found none." >&2
  exit 1
fi

selection=(-L '^multiplies$' -LE "$(left_out "$build" shared)")
unset OPENBLAS_CORETYPE OPENBLAS_L2_SIZE OMP_NUM_THREADS OPENBLAS_NUM_THREADS

# run TEXT VARIABLE=VALUE...
run() {
  local begun=$SECONDS log
  log=$(mktemp)
  if ! env "${@:2}" ctest --test-dir "$build" "${selection[@]}" --no-tests=error --output-on-failure --timeout 600 -j 2 >"$log"; then
    cat "$log"
    rm -f "$log"
    echo "test_openblas_kernels: failed with $1 (${*:2})." >&2
    exit 1
  fi
  echo "$1: $(sed -n 's/.*tests passed.* out of \([0-9]*\)$/\1 tests passed/p' "$log") ($((SECONDS - begun)) s)"
  rm -f "$log"
}

echo "label multiplies: $(ctest --test-dir "$build" -N "${selection[@]}" | sed -n 's/^ *Test *#[0-9]*: //p' | paste -sd ' ')"
for kernel in "${kernels[@]}"; do run "kernel $kernel" OPENBLAS_CORETYPE="$kernel"; done
# A smaller cache cuts OpenBLAS's sums elsewhere.
has avx2 fma && run "kernel Haswell, 512 KiB of cache" OPENBLAS_CORETYPE=Haswell OPENBLAS_L2_SIZE=512
for threads in 1 2; do
  run "OpenBLAS's own choice, threads $threads" OMP_NUM_THREADS=$threads OPENBLAS_NUM_THREADS=$threads
done
