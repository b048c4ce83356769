#!/usr/bin/env bash
# Trains the small model of configs/tiny from nothing: backbone, RGB decoder, latent statistics, M1, cascade; then
# measures it. About four hours on 2 cores, minutes on a GPU. Every stage continues where it was interrupted: run it
# again. Usage: scripts/train_tiny.sh [RUNS [DEVICE]], by default runs/tiny and cpu.
set -euo pipefail
cd "$(dirname "$0")/.."
runs=${1:-runs/tiny}
device=${2:-cpu}
gld=build/release/cli/gld
[ -x "$gld" ] || scripts/build.sh gld

# stage NAME KIND MODEL: trains unless its model is there already.
stage() {
  local name=$1 kind=$2 model=$3
  if [ -f "$runs/$name/report.json" ]; then
    echo "train_tiny: $name is done already"
    return
  fi
  local resume=()
  if compgen -G "$runs/$name/checkpoints/step_*.safetensors" >/dev/null; then resume=(--resume); fi
  "$gld" train "$kind" --config "configs/tiny/$name.yaml" --model "$model" --out "$runs/$name" \
    --device "$device" "${resume[@]}"
}

stage backbone backbone configs/tiny
stage decoder decoder "$runs/backbone/model"
if [ -f "$runs/stats/report.json" ]; then
  echo "train_tiny: stats is done already"
else
  "$gld" stats --config configs/tiny/stats.yaml --model "$runs/decoder/model" --out "$runs/stats" --device "$device"
fi
stage level level "$runs/stats/model"
stage cascade cascade "$runs/level/model"

"$gld" eval --model "$runs/cascade/model" --synthetic 64 --out "$runs/eval" --device "$device"
echo "train_tiny: the model is in $runs/cascade/model; copy its safetensors into configs/tiny to ship it."
