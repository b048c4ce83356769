#!/usr/bin/env bash
# Puts a small model that scripts/train_tiny.sh ship has put together into configs/tiny: its weights, its recipe, and beside
# them how it was trained (curves, final numbers, last validation pictures; a stage that went on over several machines has
# one part_N each) and what it is worth (the evaluation). Usage: scripts/ship_tiny.sh [RUNS], by default runs/tiny.
set -euo pipefail
cd "$(dirname "$0")/.."
runs=${1:-runs/tiny}
tiny=configs/tiny
recipe=$tiny
if [ -f "$tiny/next/model.yaml" ]; then recipe=$tiny/next; fi
most_bytes=$((24 * 1024 * 1024)) # 24 MiB

for needed in model/{backbone,level1,cascade,rgb_decoder,depth_refinement,blending,dpt_head,statistics_level0,statistics_level1}.safetensors eval/report.json; do
  if [ ! -f "$runs/$needed" ]; then
    echo "ship_tiny: expected $runs/$needed, found none; run scripts/train_tiny.sh ship $runs first." >&2
    exit 1
  fi
done
bytes=$(cat "$runs"/model/*.safetensors | wc -c)
if [ "$bytes" -gt "$most_bytes" ]; then
  echo "ship_tiny: expected at most $most_bytes bytes of weights, found $bytes in $runs/model; shrink $recipe/model.yaml." >&2
  exit 1
fi

# The weights must be of the architecture that they are shipped with: a scene is made with both.
together=$(mktemp -d)
trap 'rm -rf "$together"' EXIT
cp "$recipe/model.yaml" "$runs"/model/*.safetensors "$together/"
if ! build/release/cli/gld eval --model "$together" --synthetic 1 --pictures 0 --out "$together/eval" >/dev/null; then
  echo "ship_tiny: expected weights of the model in $recipe/model.yaml in $runs/model, found others; train them again." >&2
  exit 1
fi

cp "$runs"/model/*.safetensors "$tiny/"
# What it was trained on, as gld stats noted it.
cp "$runs/model/seen_scenes.json" "$tiny/"
rm -rf "$tiny/evaluation"
mkdir -p "$tiny/training" "$tiny/evaluation"
if [ "$recipe" != "$tiny" ]; then
  rm -rf "$tiny/training"
  mkdir -p "$tiny/training"
  if [ -d "$recipe/training" ]; then cp -r "$recipe/training" "$tiny/"; fi
  cp "$recipe"/*.yaml "$tiny/"
fi
for stage in backbone decoder depth blending level cascade head; do
  from=$runs/$stage
  if [ "$stage" = level ] && [ -d "$runs/level_ship" ]; then from=$runs/level_ship; fi
  if [ ! -f "$from/metrics.jsonl" ]; then continue; fi  # taken over from another machine as it was
  # What was recorded before stays, as parts of one history; what is recorded already is not recorded again.
  to=$tiny/training/$stage
  if find "$to" -name metrics.jsonl -exec cmp -s {} "$from/metrics.jsonl" \; -print 2>/dev/null | grep -q .; then continue; fi
  if [ -f "$to/metrics.jsonl" ]; then
    mkdir "$to/part_1"
    find "$to" -maxdepth 1 -type f -exec mv {} "$to/part_1/" \;
  fi
  if [ -d "$to/part_1" ]; then
    number=1
    while [ -d "$to/part_$number" ]; do number=$((number + 1)); done
    to=$to/part_$number
  fi
  mkdir -p "$to"
  cp "$from"/{config.yaml,loss.png,metrics.jsonl,report.json} "$to/"
  if [ -d "$from/validation" ]; then  # M1 may train before there is a decoder to draw with
    cp "$(find "$from/validation" -name 'step_*.png' | sort | tail -1)" "$to/validation.png"
  fi
done
if [ -f "$runs/stats/report.json" ]; then
  mkdir -p "$tiny/training/stats"
  cp "$runs"/stats/{config.yaml,report.json} "$tiny/training/stats/"
fi
cp "$runs"/eval/{config.yaml,eval.csv,report.json} "$tiny/evaluation/"
# The records name the runs where others will have them.
{ grep -rl -- "$runs/" "$tiny/training" "$tiny/evaluation" || true; } | xargs -r sed -i "s#$runs/#runs/tiny/#g"
if [ "$recipe" != "$tiny" ]; then rm -rf "$recipe"; fi
# Its errors were those of other weights.
rm -f "$tiny/plan_errors.json"
echo "ship_tiny: $bytes bytes of weights are in $tiny; measure their sampling errors with gld bench sample" \
  "--model $tiny --synthetic 16 --write-table --precisions bfloat16,int8 --out docs/measured/sample," \
  "and change $tiny/README.md with its evaluation; scripts/check_figures.py says where"
