#!/usr/bin/env bash
# Trains on two hosts that are network namespaces of this machine, with a cable between them:
#   1. two hosts train the weights of one process, to the byte;
#   2. the cable is cut in the middle of a step: both end within 10 s, each with a sentence that names the other;
#   3. the run goes on and ends at those same weights.
# Needs root (network namespaces) and the built program; `ip` is Debian's iproute2.
#   scripts/test_two_hosts.sh [GLD]
set -euo pipefail
cd "$(dirname "$0")/.."
gld=$(realpath "${1:-build/release/cli/gld}")
if ! ip netns add gld_probe 2>/dev/null; then
  echo "test_two_hosts: expected the right to make network namespaces, found none; run this as root on Linux." >&2
  exit 2
fi
ip netns delete gld_probe

work=$(mktemp -d)
cleanup() {
  jobs -p | xargs -r kill -KILL 2>/dev/null || true
  for host in a b; do ip netns delete "gld_$host" 2>/dev/null || true; done
  rm -rf "$work"
}
trap cleanup EXIT

connect() {
  ip link add gld_a type veth peer name gld_b
  for host in a b; do
    ip netns add "gld_$host"
    ip link set "gld_$host" netns "gld_$host"
    ip -n "gld_$host" link set lo up
    ip -n "gld_$host" link set "gld_$host" up
  done
  ip -n gld_a address add 10.77.0.1/24 dev gld_a
  ip -n gld_b address add 10.77.0.2/24 dev gld_b
}
cut_cable() { ip -n gld_b link set gld_b down; }
mend_cable() { ip -n gld_b link set gld_b up; }

# train OUT OPTION...: a few steps of the small decoder on drawn rooms, one thread.
train() {
  local out=$1
  shift
  "$gld" train decoder --config configs/tiny/decoder.yaml --model configs/tiny --out "$out" --threads 1 \
    --set objective.start=bundle --set store=float32 --set loop.micro_batches=2 --set data.distinct_batches=2 --set data.validation_scenes=1 \
    --set loop.validate_every=1000 --set loop.checkpoint_every=2 --set loop.log_every=1 --set loop.steps=12 "$@"
}
# on HOST RANK OUT OPTION...
on() {
  local host=$1 rank=$2 out=$3
  shift 3
  export gld
  export -f train
  ip netns exec "gld_$host" bash -c 'train "$@"' _ "$out" --processes.count 2 --processes.rank "$rank" \
    --processes.master-address 10.77.0.1 --processes.master-port 29571 "$@"
}
# What the run exports; checkpoints also hold how long it took.
trained() { echo "$1/model/rgb_decoder.safetensors"; }

connect
train "$work/alone" >"$work/alone.log" 2>&1
echo "test_two_hosts: one process: trained"

on a 0 "$work/both" >"$work/a.log" 2>&1 &
on b 1 "$work/both" >"$work/b.log" 2>&1
wait
cmp "$(trained "$work/alone")" "$(trained "$work/both")"
echo "test_two_hosts: two hosts: the same bytes"

on a 0 "$work/cut" >"$work/a.log" 2>&1 &
first=$!
on b 1 "$work/cut" >"$work/b.log" 2>&1 &
second=$!
for _ in $(seq 600); do
  if compgen -G "$work/cut/checkpoints/step_000000004*" >/dev/null; then break; fi
  sleep 0.1
done
cut_cable
cut_at=$(date +%s%N)
ended=0
for process in "$first" "$second"; do
  if wait "$process"; then
    echo "test_two_hosts: expected both hosts to end with an error, found one that finished." >&2
    exit 1
  fi
  ended=$((($(date +%s%N) - cut_at) / 1000000))
done
for host in a b; do echo "test_two_hosts: host $host said: $(grep -h '^error' "$work/$host.log" | tail -1)"; done
grep -q "rank 1" "$work/a.log" && grep -q "rank 0" "$work/b.log"
echo "test_two_hosts: cut off after step 4, both ended within $ended ms"
[ "$ended" -lt 10000 ]

mend_cable
sleep 1
on a 0 "$work/cut" --resume >"$work/a.log" 2>&1 &
on b 1 "$work/cut" --resume >"$work/b.log" 2>&1
wait
cmp "$(trained "$work/alone")" "$(trained "$work/cut")"
echo "test_two_hosts: gone on with: the same bytes again"
