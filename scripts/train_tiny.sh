#!/usr/bin/env bash
# Trains the small model of configs/tiny from nothing, then measures it: backbone; latent statistics; M1 on one core
# while the RGB decoder and then the cascade train on the other; 64 held-out scenes. About two hours on 2 idle cores.
# Every stage continues where it was interrupted: run it again. Usage: scripts/train_tiny.sh [RUNS [DEVICE]], by default
# runs/tiny and cpu.
set -euo pipefail
cd "$(dirname "$0")/.."
runs=${1:-runs/tiny}
device=${2:-cpu}
gld=build/release/cli/gld
[ -x "$gld" ] || scripts/build.sh gld
mkdir -p "$runs"

# stage NAME MODEL [OPTION...]: trains the kind NAME unless its model is there already.
stage() {
  local name=$1 model=$2
  shift 2
  if [ -f "$runs/$name/report.json" ]; then
    echo "train_tiny: $name is done already"
    return
  fi
  local resume=()
  if compgen -G "$runs/$name/checkpoints/step_*.safetensors" >/dev/null; then resume=(--resume); fi
  "$gld" train "$name" --config "configs/tiny/$name.yaml" --model "$model" --out "$runs/$name" \
    --device "$device" "$@" "${resume[@]}"
}

stage backbone configs/tiny
if [ -f "$runs/stats/report.json" ]; then
  echo "train_tiny: stats is done already"
else
  "$gld" stats --config configs/tiny/stats.yaml --model "$runs/backbone/model" --out "$runs/stats" --device "$device"
fi

# Two processes of one thread each keep two cores busier than one with two: the models are small.
level() { stage level "$runs/stats/model" --threads 1; }
decoder_and_cascade() {
  stage decoder "$runs/stats/model" --threads 1
  stage cascade "$runs/decoder/model" --threads 1
}
decoder_and_cascade >"$runs/decoder_and_cascade.log" 2>&1 &
beside=$!
trap 'kill "$beside" 2>/dev/null || true' EXIT
level
echo "train_tiny: M1 is done; waiting for the decoder and the cascade ($runs/decoder_and_cascade.log)"
wait "$beside"
trap - EXIT

rm -rf "$runs/model"
cp -r "$runs/cascade/model" "$runs/model"
cp "$runs/level/model/level1.safetensors" "$runs/model/"
"$gld" eval --model "$runs/model" --synthetic 64 --out "$runs/eval" --device "$device"
echo "train_tiny: the model is in $runs/model; scripts/ship_tiny.sh $runs puts it into configs/tiny."
