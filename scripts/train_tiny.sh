#!/usr/bin/env bash
# Trains the small model: backbone; latent statistics; the depth head, which carries photographs into target views for M1;
# then M1 for as long as it is left running, while the RGB decoder, the mending of depth, the blending of photographs and the cascade train
# beside it. Every stage goes on where it was interrupted: run it again.
#   scripts/train_tiny.sh [RUNS [DEVICE]]        trains; Ctrl-C or SIGTERM writes checkpoints and stops
#   scripts/train_tiny.sh ship [RUNS [DEVICE]]   branches a falling learning rate off what M1 has learnt so far, puts the
#                                                parts together in RUNS/model and measures it; the run itself is unharmed
#   scripts/train_tiny.sh keep [RUNS [DEVICE]]   copies the weights and curves so far beside the recipe, for git: another
#                                                machine goes on from them
# RUNS is runs/tiny by default, DEVICE cpu. RUNS/kept_scenes, up to 40 GB of rooms and what is made of them, spares making them again.
# The recipe is configs/tiny/next (the model that is to take the place of
# configs/tiny) where there is one, else configs/tiny. Weights that lie beside the recipe are gone on with where RUNS has
# no checkpoints: a backbone with its statistics is taken as it is, everything else starts from them.
set -euo pipefail
cd "$(dirname "$0")/.."
action=train
case "${1:-}" in
  ship | keep)
    action=$1
    shift
    ;;
esac
runs=${1:-runs/tiny}
device=${2:-cpu}
recipe=configs/tiny
if [ -f configs/tiny/next/model.yaml ]; then recipe=configs/tiny/next; fi
gld=build/release/cli/gld
[ -x "$gld" ] || scripts/build.sh gld
mkdir -p "$runs"

has_checkpoint() { compgen -G "$runs/$1/checkpoints/step_*.safetensors" >/dev/null; }

# stage NAME KIND MODEL START [OPTION...]: trains with the recipe's NAME.yaml unless its model is there already.
# START: the setting that makes a fresh run go on from the weights in MODEL; none: -.
stage() {
  local name=$1 kind=$2 model=$3 start=$4
  shift 4
  if [ -f "$runs/$name/report.json" ]; then
    echo "train_tiny: $name is done already"
    return
  fi
  local how=(--overwrite)  # of a run that was stopped before its first checkpoint
  if has_checkpoint "$name"; then
    how=(--resume)
  elif [ "$start" != - ]; then
    how+=(--set "$start" --set loop.learning_rate.warmup_steps=0)
    echo "train_tiny: $name goes on from the weights in $model; its curve begins anew"
  fi
  "$gld" train "$kind" --config "$recipe/$name.yaml" --model "$model" --out "$runs/$name" --device "$device" \
    --kept-scenes "$runs/kept_scenes" "$@" "${how[@]}"
}

# The start setting where the recipe brings the weights of that part, else -.
start_of() { if [ -f "$recipe/$1.safetensors" ]; then echo "$2"; else echo -; fi; }

# Backbone and statistics, on which everything else is built.
base=$recipe
if has_checkpoint backbone || [ ! -f "$recipe/statistics_level1.safetensors" ]; then
  if [ "$action" = train ]; then
    stage backbone backbone "$recipe" "$(start_of backbone objective.training=from_bundle)" --threads 1
  fi
  base=$runs/backbone/model
fi
if [ -f "$runs/stats/report.json" ] || [ "$base" != "$recipe" ]; then
  if [ "$action" = train ] && [ ! -f "$runs/stats/report.json" ]; then
    "$gld" stats --config "$recipe/stats.yaml" --model "$base" --out "$runs/stats" --overwrite --device "$device"
  fi
  base=$runs/stats/model
fi

# What M1 is trained on: the model so far with the depth head of its own stage, or, where M1 goes on from the recipe's
# weights, with the head that those were trained with.
level_base=$runs/level_base
level_start=-
prepare_level() {
  local head=$runs/head/model
  if [ -f "$recipe/level1.safetensors" ] && cmp -s "$base/backbone.safetensors" "$recipe/backbone.safetensors"; then
    level_start=objective.start=bundle
    head=$recipe
  elif [ "$action" = train ]; then
    stage head backbone "$base" -
  fi
  rm -rf "$level_base"
  mkdir -p "$level_base"
  cp "$base"/*.safetensors "$recipe/model.yaml" "$level_base/"
  if [ -f "$base/seen_scenes.json" ]; then cp "$base/seen_scenes.json" "$level_base/"; fi
  cp "$head/dpt_head.safetensors" "$level_base/"
  # The unit of a single view belongs to this head, which is not the one that gld stats saw.
  if [ "$head" != "$recipe" ]; then
    if [ "$action" = train ] && [ ! -f "$runs/unit/report.json" ]; then
      "$gld" stats --config "$recipe/stats.yaml" --model "$level_base" --scene-count 2048 --out "$runs/unit" --overwrite --device "$device"
    fi
    if [ -f "$runs/unit/report.json" ]; then cp "$runs/unit/model/single_view_unit.safetensors" "$level_base/"; fi
  fi
  if [ "$level_start" != - ]; then cp "$recipe/level1.safetensors" "$level_base/"; fi
}
prepare_level

# newest_step NAME: of its newest checkpoint.
newest_step() {
  local newest
  newest=$(find "$runs/$1/checkpoints" -name 'step_*.safetensors' | sort | tail -1)
  echo $((10#$(basename "$newest" .safetensors | cut -d_ -f2)))
}

# branch NAME KIND MODEL STEP FALL [OPTION...]: a copy of the run at that step goes on for FALL steps while its rate
# falls to nothing, and leaves its model in RUNS/NAME_STEP; the run itself is unharmed. The moving average, which is what is exported,
# remembers a fifth of the fall: the run's own would still hold much of what the weights were before it.
branch() {
  local name=$1 kind=$2 model=$3 step=$4 fall=$5
  shift 5
  local copy=$runs/${name}_$step
  if [ -f "$copy/report.json" ]; then return; fi
  if [ ! -d "$copy" ]; then
    rm -rf "$copy.partial"
    mkdir -p "$copy.partial/checkpoints"
    cp "$runs/$name/checkpoints/$(printf 'step_%09d.safetensors' "$step")" "$copy.partial/checkpoints/"
    cp "$runs/$name"/{config.yaml,metrics.jsonl} "$copy.partial/"
    mv "$copy.partial" "$copy"
  fi
  local average=()
  if [ "$fall" -gt 0 ]; then
    average=(--set "loop.optimiser.ema_decay=$(awk "BEGIN { printf \"%.5f\", 1 - 5 / $fall }")"
      --may-change loop.optimiser.ema_decay)
  fi
  "$gld" train "$kind" --config "$recipe/$name.yaml" --model "$model" --out "$copy" --device "$device" --resume \
    --kept-scenes "$runs/kept_scenes" \
    --set loop.steps=$((step + fall)) --set loop.learning_rate.schedule=linear \
    --set loop.learning_rate.decay_start_step="$step" ${average[@]+"${average[@]}"} "$@"
}

if [ "$action" = ship ]; then
  for needed in decoder depth blending cascade; do
    if [ ! -f "$runs/$needed/report.json" ]; then
      echo "train_tiny: expected $runs/$needed to be done before shipping, found no report.json;" \
        "let scripts/train_tiny.sh $runs run on." >&2
      exit 1
    fi
  done
  step=$(newest_step level)
  branch level level "$level_base" "$step" $((step / 6 < 100 ? 100 : step / 6 > 3000 ? 3000 : step / 6)) --set loop.workers=2
  rm -rf "$runs/model" "$runs/level_ship" "$runs/eval"
  cp -r "$runs/cascade/model" "$runs/model"
  cp "$runs/level_$step/model/level1.safetensors" "$runs/blending/model"/{depth_refinement,blending}.safetensors "$level_base/dpt_head.safetensors" \
    "$recipe/model.yaml" "$runs/model/"
  cp -r "$runs/level_$step" "$runs/level_ship"
  cp "$level_base/single_view_unit.safetensors" "$runs/model/"
  "$gld" eval --model "$runs/model" --synthetic 64 --out "$runs/eval" --device "$device"
  echo "train_tiny: the model is in $runs/model; scripts/ship_tiny.sh $runs puts it into configs/tiny."
  exit 0
fi

if [ "$action" = keep ]; then
  # A machine's checkpoints end with it; what git keeps are the weights (16 bits, moving average) and the curves.
  part() {  # STAGE FILE...: the stage's weights, and its curve behind those kept before
    local name=$1 from=$2 number=1
    shift 2
    for file in "$@"; do cp "$from/model/$file.safetensors" "$recipe/"; done
    while [ -d "$recipe/training/$name/part_$number" ]; do number=$((number + 1)); done
    mkdir -p "$recipe/training/$name/part_$number"
    cp "$from"/{config.yaml,metrics.jsonl,report.json} "$recipe/training/$name/part_$number/"
    sed -i "s#$runs/#runs/tiny/#g" "$recipe/training/$name/part_$number"/*
    echo "train_tiny: kept $name in $recipe"
  }
  if [ -f "$runs/backbone/report.json" ]; then
    part backbone "$runs/backbone" backbone dpt_head
  elif has_checkpoint backbone; then
    step=$(newest_step backbone)
    branch backbone backbone "$recipe" "$step" 0
    part backbone "$runs/backbone_$step" backbone dpt_head
  fi
  if [ -f "$runs/stats/report.json" ]; then
    cp "$runs"/stats/model/statistics_level*.safetensors "$recipe/"
    for key in single_source_unit single_source_unit_deviation; do
      line=$(grep "^$key: " "$runs/stats/model/model.yaml" || true)
      if [ -n "$line" ]; then sed -i "s/^$key: .*/$line/" "$recipe/model.yaml"; fi
    done
  fi
  if [ -f "$runs/stats/model/seen_scenes.json" ]; then cp "$runs/stats/model/seen_scenes.json" "$recipe/"; fi
  if has_checkpoint level; then
    step=$(newest_step level)
    branch level level "$level_base" "$step" 0
    part level "$runs/level_$step" level1
  fi
  if [ -f "$runs/decoder/report.json" ]; then part decoder "$runs/decoder" rgb_decoder; fi
  if [ -f "$runs/blending/report.json" ]; then part blending "$runs/blending" blending; fi
  if [ -f "$runs/depth/report.json" ]; then part depth "$runs/depth" depth_refinement; fi
  if [ -f "$runs/cascade/report.json" ]; then part cascade "$runs/cascade" cascade; fi
  if [ -f "$runs/head/report.json" ]; then part head "$runs/head" dpt_head; fi
  exit 0
fi

# Beside each other every process has one thread: the models are small, and that keeps the cores busier than several
# threads a process. Alone, M1 has all cores, and a worker for each of its micro-batches.
level() { stage level level "$level_base" "$level_start" "$@"; }
beside_level() {
  stage decoder decoder "$base" "$(start_of rgb_decoder objective.start=bundle)" --threads 1
  # Photographs are matched on the CPU.
  device=cpu stage depth depth "$level_base" "$(start_of depth_refinement objective.start=bundle)" --threads 1
  device=cpu stage blending blending "$runs/depth/model" "$(start_of blending objective.start=bundle)" --threads 1
  # The head that carries photographs into target views is M1's.
  rm -rf "$runs/cascade_base"
  cp -r "$runs/decoder/model" "$runs/cascade_base"
  cp "$level_base"/{dpt_head,single_view_unit}.safetensors "$runs/cascade_base/"
  stage cascade cascade "$runs/cascade_base" "$(start_of cascade objective.flow.start=bundle)" --threads 1
}
level_is_alone() {
  [ -f "$runs/decoder/report.json" ] && [ -f "$runs/depth/report.json" ] && [ -f "$runs/blending/report.json" ] && [ -f "$runs/cascade/report.json" ]
}

running=()
# With process groups of their own (set -m), which get one signal each: gld then writes a checkpoint.
stop_running() {
  local group
  for group in ${running[@]+"${running[@]}"}; do kill -TERM -- "-$group" 2>/dev/null || true; done
  wait
  running=()
}
trap stop_running EXIT
trap 'exit 130' INT
trap 'exit 143' TERM
set -m
if ! level_is_alone; then
  beside_level >"$runs/beside_level.log" 2>&1 &
  beside=$!
  level --threads 1 &
  running=("$beside" $!)
  if ! wait "$beside"; then
    echo "train_tiny: expected decoder, depth, blending and cascade to train, found a failure; see $runs/beside_level.log." >&2
    exit 1
  fi
  stop_running
fi
level --set loop.workers=2 &
running=($!)
wait "${running[0]}"
