#!/usr/bin/env bash
# Trains the small model from nothing, one stage after the other, and measures it. Every stage goes on where it was
# interrupted: run it again.
#   scripts/train_tiny.sh [RUNS [DEVICE]]   trains; Ctrl-C or SIGTERM writes a checkpoint and stops. At the end the model is in
#                                           RUNS/cascade/model and what it is worth in RUNS/eval: scripts/ship_tiny.sh RUNS
#   scripts/train_tiny.sh keep [RUNS]       copies what another machine needs to go on (models of finished stages, the
#                                           newest checkpoint of the one that runs, curves) into RECIPE/so_far, for git
# RUNS is runs/tiny by default, DEVICE cpu; what matches photographs runs on the CPU in any case. RUNS/kept_scenes, up to
# 40 GB of rooms and what is made of them, spares making them again. The RECIPE is configs/tiny/next (the model that is
# to take the place of configs/tiny) where there is one, else configs/tiny. GLD=PROGRAM takes another program than
# build/release's.
set -euo pipefail
cd "$(dirname "$0")/.."
action=train
if [ "${1:-}" = keep ]; then
  action=keep
  shift
fi
runs=${1:-runs/tiny}
device=${2:-cpu}
recipe=configs/tiny
if [ -f configs/tiny/next/model.yaml ]; then recipe=configs/tiny/next; fi
so_far=$recipe/so_far
gld=${GLD:-build/release/cli/gld}
stages=(backbone decoder head depth blending stats level cascade)

if [ "$action" = keep ]; then
  rm -rf "$so_far.partial"
  latest=
  mkdir -p "$so_far.partial"
  if [ -f "$runs/nothing/model.yaml" ]; then cp "$runs/nothing/model.yaml" "$so_far.partial/"; fi
  for stage in "${stages[@]}"; do
    [ -d "$runs/$stage" ] || break
    mkdir -p "$so_far.partial/$stage"
    for file in config.yaml metrics.jsonl report.json loss.png; do
      if [ -f "$runs/$stage/$file" ]; then cp "$runs/$stage/$file" "$so_far.partial/$stage/"; fi
    done
    if [ -f "$runs/$stage/report.json" ]; then
      # Each model holds those before it.
      if [ -n "$latest" ]; then rm -rf "$so_far.partial/$latest/model"; fi
      latest=$stage
      cp -r "$runs/$stage/model" "$so_far.partial/$stage/"
      if [ -d "$runs/$stage/validation" ]; then
        mkdir "$so_far.partial/$stage/validation"
        cp "$(find "$runs/$stage/validation" -name 'step_*.png' | sort | tail -1)" "$so_far.partial/$stage/validation/"
      fi
    elif [ -d "$runs/$stage/checkpoints" ]; then
      mkdir "$so_far.partial/$stage/checkpoints"
      find "$runs/$stage/checkpoints" -name 'step_*.safetensors' | sort | tail -1 |
        xargs -r cp -t "$so_far.partial/$stage/checkpoints"
    fi
  done
  if [ ! -d "$so_far.partial/backbone" ]; then
    rm -rf "$so_far.partial"
    echo "train_tiny: expected a stage in $runs, found none; train first." >&2
    exit 1
  fi
  # The records name the runs where others will have them.
  { grep -rlI -- "$runs/" "$so_far.partial" || true; } | xargs -r sed -i "s#$runs/#runs/tiny/#g"
  rm -rf "$so_far"
  mv "$so_far.partial" "$so_far"
  echo "train_tiny: kept in $so_far: $(du -sm "$so_far" | cut -f1) MB"
  exit 0
fi

[ -x "$gld" ] || scripts/build.sh gld
mkdir -p "$runs"
for stage in "${stages[@]}"; do
  if [ -d "$so_far/$stage" ] && [ ! -d "$runs/$stage" ]; then cp -r "$so_far/$stage" "$runs/$stage"; fi
done

# In the background, so that a signal to this script reaches the program at once (it then writes a checkpoint), and in a
# process group of its own (set -m), so that Ctrl-C does not reach it twice.
set -m
running=
stop() {
  trap - EXIT
  if [ -n "$running" ]; then
    kill -TERM "$running" 2>/dev/null || true
    wait "$running" || true
  fi
  exit "$1"
}
trap 'stop 130' INT
trap 'stop 143' TERM
run() {
  "$gld" "$@" &
  running=$!
  wait -f "$running"  # not only until somebody pauses it, which under set -m ends a plain wait
  running=
}

# stage NAME KIND MODEL DEVICE: gld train KIND with the recipe's NAME.yaml, unless its model is there already.
stage() {
  local name=$1 kind=$2 model=$3 on=$4 how=--overwrite
  if [ -f "$runs/$name/report.json" ]; then
    echo "train_tiny: $name is done already"
    return
  fi
  if compgen -G "$runs/$name/checkpoints/step_*.safetensors" >/dev/null; then how=--resume; fi
  run train "$kind" --config "$recipe/$name.yaml" --model "$model" --out "$runs/$name" --device "$on" \
    --kept-scenes "$runs/kept_scenes" "$how"
}

# The recipe begins without weights, though shipped ones may lie beside it. Each stage's model is that of the stage before with
# one part more, so that a model.yaml which is changed on the way would change nothing that is trained.
mkdir -p "$runs/nothing"
began=$runs/nothing/model.yaml
if [ ! -f "$began" ] && [ -f "$so_far/model.yaml" ]; then cp "$so_far/model.yaml" "$began"; fi
if [ ! -f "$began" ]; then cp "$recipe/model.yaml" "$began"; fi
if ! cmp -s "$recipe/model.yaml" "$began"; then
  echo "train_tiny: expected the model.yaml that $runs began with, found another in $recipe; put it back as $began is, or" \
    "train from nothing in another folder." >&2
  exit 1
fi
stage backbone backbone "$runs/nothing" "$device"
stage decoder decoder "$runs/backbone/model" "$device"
stage head backbone "$runs/decoder/model" "$device"
stage depth depth "$runs/head/model" cpu
stage blending blending "$runs/depth/model" cpu
if [ ! -f "$runs/stats/report.json" ]; then
  run stats --config "$recipe/stats.yaml" --model "$runs/blending/model" --out "$runs/stats" --overwrite --device "$device"
fi
stage level level "$runs/stats/model" cpu
stage cascade cascade "$runs/level/model" cpu
if [ ! -f "$runs/eval/report.json" ]; then
  run eval --model "$runs/cascade/model" --synthetic 64 --synthetic-seed 20261212 --samples 4 \
    --out "$runs/eval" --overwrite --device "$device"
fi
echo "train_tiny: the model is in $runs/cascade/model; scripts/ship_tiny.sh $runs puts it into configs/tiny."
