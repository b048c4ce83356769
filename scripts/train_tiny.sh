#!/usr/bin/env bash
# Trains the small model of configs/tiny from nothing, then measures it: backbone; latent statistics; M1 while the RGB
# decoder, the cascade and the depth head train beside it; 64 held-out scenes. About two and a half hours on 2 cores.
# Every stage continues where it was interrupted: run it again. Usage: scripts/train_tiny.sh [RUNS [DEVICE]], by default
# runs/tiny and cpu.
set -euo pipefail
cd "$(dirname "$0")/.."
runs=${1:-runs/tiny}
device=${2:-cpu}
gld=build/release/cli/gld
[ -x "$gld" ] || scripts/build.sh gld
mkdir -p "$runs"

# stage NAME KIND MODEL [OPTION...]: trains with configs/tiny/NAME.yaml unless its model is there already.
stage() {
  local name=$1 kind=$2 model=$3
  shift 3
  if [ -f "$runs/$name/report.json" ]; then
    echo "train_tiny: $name is done already"
    return
  fi
  local resume=()
  if compgen -G "$runs/$name/checkpoints/step_*.safetensors" >/dev/null; then resume=(--resume); fi
  "$gld" train "$kind" --config "configs/tiny/$name.yaml" --model "$model" --out "$runs/$name" \
    --device "$device" "$@" "${resume[@]}"
}

stage backbone backbone configs/tiny
if [ -f "$runs/stats/report.json" ]; then
  echo "train_tiny: stats is done already"
else
  "$gld" stats --config configs/tiny/stats.yaml --model "$runs/backbone/model" --out "$runs/stats" --device "$device"
fi

# Processes of one thread each keep the cores busier than one of several: the models are small.
level() { stage level level "$runs/stats/model" --threads 1; }
beside_level() {
  stage decoder decoder "$runs/stats/model" --threads 1
  stage cascade cascade "$runs/decoder/model" --threads 1
  stage head backbone "$runs/decoder/model" --threads 1
}
# With its own process group, so that the training it has started stops with it (gld writes a checkpoint).
set -m
beside_level >"$runs/beside_level.log" 2>&1 &
beside=$!
set +m
stop_beside() {
  kill -TERM -- "-$beside" 2>/dev/null || true
  wait "$beside" 2>/dev/null || true
}
trap stop_beside EXIT
level
echo "train_tiny: M1 is done; waiting for decoder, cascade and head ($runs/beside_level.log)"
if ! wait "$beside"; then
  echo "train_tiny: expected decoder, cascade and head to train, found a failure; see $runs/beside_level.log." >&2
  exit 1
fi
trap - EXIT

rm -rf "$runs/model"
cp -r "$runs/cascade/model" "$runs/model"
cp "$runs/level/model/level1.safetensors" "$runs/head/model/dpt_head.safetensors" "$runs/model/"
"$gld" eval --model "$runs/model" --synthetic 64 --out "$runs/eval" --device "$device"
echo "train_tiny: the model is in $runs/model; scripts/ship_tiny.sh $runs puts it into configs/tiny."
