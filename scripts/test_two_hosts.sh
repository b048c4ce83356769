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
say() { echo "test_two_hosts: $1"; }
refuse() {
  echo "test_two_hosts: expected $1, found $2; $3." >&2
  exit 2
}
[ "$(id -u)" -eq 0 ] || refuse "root" "$(id -un)" "network namespaces need it"
command -v ip >/dev/null || refuse "the command ip" "none" "install iproute2"

work=$(mktemp -d)
running=()
cleanup() {
  local process host
  for process in ${running[@]+"${running[@]}"}; do kill -KILL "$process" 2>/dev/null || true; done
  for host in a b; do ip netns delete "gld_$host" 2>/dev/null || true; done
  rm -rf "$work"
}
trap cleanup EXIT
broken() {
  echo "test_two_hosts: expected $1, found $2; the ends of what was said:" >&2
  tail -n 3 "$work"/*.log >&2
  exit 1
}

cleanup_before() { for host in a b; do ip netns delete "gld_$host" 2>/dev/null || true; done; }
connect() {
  cleanup_before
  ip netns add gld_a 2>/dev/null || refuse "the right to make network namespaces" "none" "this sandbox takes it away"
  ip netns add gld_b
  ip link add gld_a netns gld_a type veth peer name gld_b netns gld_b
  for host in a b; do
    ip -n "gld_$host" link set lo up
    ip -n "gld_$host" link set "gld_$host" up
  done
  ip -n gld_a address add 10.77.0.1/24 dev gld_a
  ip -n gld_b address add 10.77.0.2/24 dev gld_b
}

# A few steps of the small decoder on drawn rooms, one thread.
training=(train decoder --config configs/tiny/decoder.yaml --model configs/tiny --threads 1 --set objective.start=bundle
  --set store=float32 --set loop.micro_batches=2 --set data.distinct_batches=2 --set data.validation_scenes=1
  --set loop.validate_every=1000 --set loop.checkpoint_every=2 --set loop.log_every=1 --set loop.steps=12)
# start HOST RANK OUT [OPTION...]: in the background, the program itself, so that a signal reaches it.
start() {
  local host=$1 rank=$2 out=$3
  shift 3
  ip netns exec "gld_$host" "$gld" "${training[@]}" --out "$out" --processes.count 2 --processes.rank "$rank" \
    --processes.master-address 10.77.0.1 --processes.master-port 29571 "$@" >"$work/$host.log" 2>&1 &
  running+=($!)
}
both() {  # OUT [OPTION...]: both hosts, to the end
  running=()
  start a 0 "$@"
  start b 1 "$@"
  wait "${running[0]}" || broken "host a to finish" "an error"
  wait "${running[1]}" || broken "host b to finish" "an error"
}
same_as_alone() {
  cmp "$work/alone/model/rgb_decoder.safetensors" "$1/model/rgb_decoder.safetensors" ||
    broken "the weights of one process" "others"
}

connect
"$gld" "${training[@]}" --out "$work/alone" >"$work/alone.log" 2>&1 || broken "one process to finish" "an error"
say "one process: trained"
both "$work/both"
same_as_alone "$work/both"
say "two hosts: the same bytes"

running=()
start a 0 "$work/cut"
start b 1 "$work/cut"
for _ in $(seq 600); do
  if [ -e "$work/cut/checkpoints/step_000000004.safetensors" ]; then break; fi
  sleep 0.1
done
[ -e "$work/cut/checkpoints/step_000000004.safetensors" ] || broken "a checkpoint of step 4 within a minute" "none"
ip -n gld_b link set gld_b down
cut_at=$(date +%s%N)
for process in "${running[@]}"; do
  if wait "$process"; then broken "both hosts to end with an error" "one that finished"; fi
done
took=$((($(date +%s%N) - cut_at) / 1000000))
for pair in a:1 b:0; do
  said=$(grep '^error' "$work/${pair%:*}.log" | tail -1 || true)
  grep -q "rank ${pair#*:}" <<<"$said" || broken "host ${pair%:*} to name rank ${pair#*:}" "'$said'"
  say "host ${pair%:*} said: $said"
done
[ "$took" -lt 10000 ] || broken "both to end within 10 s" "$took ms"
say "cut off after step 4, both ended within $took ms"

ip -n gld_b link set gld_b up
sleep 1
both "$work/cut" --resume
same_as_alone "$work/cut"
say "gone on with: the same bytes again"
