#!/usr/bin/env bash
# Puts the small model that scripts/train_tiny.sh has made into configs/tiny: its weights, its recipe, and beside them how it
# was trained (curves, final numbers, last validation pictures) and what it is worth (the evaluation), in the place of
# those before. Usage: scripts/ship_tiny.sh [RUNS], by default runs/tiny.
set -euo pipefail
cd "$(dirname "$0")/.."
runs=${1:-runs/tiny}
tiny=configs/tiny
recipe=$tiny
if [ -f "$tiny/next/model.yaml" ]; then recipe=$tiny/next; fi
model=$runs/cascade/model
most_bytes=$((24 * 1024 * 1024)) # 24 MiB

weights=()
for part in backbone dpt_head rgb_decoder depth_refinement blending level1 cascade statistics_level{0,1} single_view_unit; do
  weights+=("$model/$part.safetensors")
done
for needed in "${weights[@]}" "$runs/eval/report.json"; do
  if [ ! -f "$needed" ]; then
    echo "ship_tiny: expected $needed, found none; run scripts/train_tiny.sh $runs first." >&2
    exit 1
  fi
done
bytes=$(cat "${weights[@]}" | wc -c)
if [ "$bytes" -gt "$most_bytes" ]; then
  echo "ship_tiny: expected at most $most_bytes bytes of weights, found $bytes in $model; shrink $recipe/model.yaml." >&2
  exit 1
fi

# The weights must be of the architecture that they are shipped with: a scene is made with both.
together=$(mktemp -d)
trap 'rm -rf "$together"' EXIT
cp "$recipe/model.yaml" "${weights[@]}" "$together/"
for key in single_source_unit single_source_unit_deviation; do  # as gld stats found them
  sed -i "s/^$key: .*/$(grep "^$key: " "$model/model.yaml")/" "$together/model.yaml"
done
if ! build/release/cli/gld eval --model "$together" --synthetic 1 --pictures 0 --out "$together/eval" >/dev/null; then
  echo "ship_tiny: expected weights of the model in $recipe/model.yaml in $model, found others; train them again." >&2
  exit 1
fi

rm -rf "$tiny/training" "$tiny/evaluation" "$recipe/so_far"
if [ "$recipe" != "$tiny" ]; then
  cp "$recipe"/*.yaml "$tiny/"
  rm -rf "$recipe"
fi
cp "$together/model.yaml" "${weights[@]}" "$tiny/"
# What it was trained on, as gld stats noted it.
cp "$model/seen_scenes.json" "$tiny/"
for stage in backbone decoder head depth blending stats level cascade; do
  to=$tiny/training/$stage
  mkdir -p "$to"
  for file in config.yaml loss.png metrics.jsonl report.json; do
    if [ -f "$runs/$stage/$file" ]; then cp "$runs/$stage/$file" "$to/"; fi
  done
  if [ -d "$runs/$stage/validation" ]; then
    cp "$(find "$runs/$stage/validation" -name 'step_*.png' | sort | tail -1)" "$to/validation.png"
  fi
done
mkdir -p "$tiny/evaluation"
cp "$runs"/eval/{config.yaml,eval.csv,report.json} "$tiny/evaluation/"
# The records name the runs where others will have them.
{ grep -rl -- "$runs/" "$tiny/training" "$tiny/evaluation" || true; } | xargs -r sed -i "s#$runs/#runs/tiny/#g"
# Its errors were those of other weights.
rm -f "$tiny/plan_errors.json"
echo "ship_tiny: $bytes bytes of weights are in $tiny; measure their sampling errors with gld bench sample" \
  "--model $tiny --synthetic 16 --write-table --precisions bfloat16,int8 --out docs/measured/sample," \
  "and change $tiny/README.md with its evaluation; scripts/check_figures.py says where"
