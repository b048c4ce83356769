#!/usr/bin/env bash
# Trains configs/splat from nothing: the autoencoder, statistics of its latents, pairs of splatted and encoded latents, the
# refiner's prior, and the refiner. Every stage goes on where it was interrupted: run it again.
#   scripts/train_splat.sh [RUNS]       trains; Ctrl-C or SIGTERM writes checkpoints and stops
#   scripts/train_splat.sh keep [RUNS]  copies weights, curves and reports of finished stages into configs/splat, for git
# RUNS is runs/splat by default. GLD=PROGRAM takes another program than build/release's.
set -euo pipefail
cd "$(dirname "$0")/.."
action=train
if [ "${1:-}" = keep ]; then
  action=keep
  shift
fi
runs=${1:-runs/splat}
recipe=configs/splat
gld=${GLD:-build/release/cli/gld}

if [ "$action" = keep ]; then
  latest=
  for stage in autoencoder stats prior refiner; do
    [ -f "$runs/$stage/report.json" ] || continue
    # A prior is no refiner yet.
    if [ "$stage" != prior ]; then latest=$runs/$stage/model; fi
    mkdir -p "$recipe/training/$stage"
    for file in report.json config.yaml metrics.jsonl loss.png; do
      if [ -f "$runs/$stage/$file" ]; then cp "$runs/$stage/$file" "$recipe/training/$stage/"; fi
    done
  done
  if [ -z "$latest" ]; then
    echo "train_splat: expected a finished stage in $runs, found none; train first." >&2
    exit 1
  fi
  # Weights of a refiner say nothing of what they repair: model.yaml does.
  repairs() { sed -n 's/^ *degraded: *//p' "$1/model.yaml"; }
  if [ -f "$latest/refiner.safetensors" ] && [ "$(repairs "$latest")" != "$(repairs "$recipe")" ]; then
    echo "train_splat: expected weights for the degraded: $(repairs "$recipe") of $recipe/model.yaml, found those of" \
      "$(repairs "$latest"); change it there, or train with it." >&2
    exit 1
  fi
  cp "$latest"/*.safetensors "$recipe/"
  if [ -f "$runs/stats/model/seen_scenes.json" ]; then cp "$runs/stats/model/seen_scenes.json" "$recipe/"; fi
  exit 0
fi

[ -x "$gld" ] || scripts/build.sh gld
mkdir -p "$runs"

# stage NAME OPTION...: a kind of gld train with the recipe's NAME.yaml, unless its model is there already.
stage() {
  local name=$1 kind=$2 model=$3
  shift 3
  if [ -f "$runs/$name/report.json" ]; then
    echo "train_splat: $name is done already"
    return
  fi
  local how=--overwrite
  if compgen -G "$runs/$name/checkpoints/step_*.safetensors" >/dev/null; then how=--resume; fi
  "$gld" train "$kind" --config "$recipe/$name.yaml" --model "$model" --out "$runs/$name" "$@" "$how"
}

# The architecture without weights of an earlier training.
mkdir -p "$runs/untrained"
cp "$recipe/model.yaml" "$runs/untrained/"
stage autoencoder backbone "$runs/untrained"
if [ ! -f "$runs/stats/report.json" ]; then
  "$gld" stats --config "$recipe/stats.yaml" --model "$runs/autoencoder/model" --out "$runs/stats" --overwrite
fi
for pairs in pairs pairs_few pairs_lifted; do
  [ -f "$runs/$pairs/report.json" ] && continue
  how=--overwrite
  if [ -d "$runs/$pairs/pairs" ]; then how=--resume; fi
  "$gld" splat pairs --config "$recipe/$pairs.yaml" --model "$runs/stats/model" --out "$runs/$pairs" "$how"
done
pairs=("$runs/pairs/pairs" "$runs/pairs_few/pairs" "$runs/pairs_lifted/pairs")
stage prior refiner "$runs/stats/model" --pairs "${pairs[@]}"
stage refiner refiner "$runs/prior/model" --pairs "${pairs[@]}"
