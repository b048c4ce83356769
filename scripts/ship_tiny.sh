#!/usr/bin/env bash
# Puts a small model that scripts/train_tiny.sh has trained into configs/tiny: its weights, and beside them how it was
# trained (curves, final numbers, last validation pictures) and what it is worth (the evaluation). Usage:
# scripts/ship_tiny.sh [RUNS], by default runs/tiny.
set -euo pipefail
cd "$(dirname "$0")/.."
runs=${1:-runs/tiny}
tiny=configs/tiny
most_bytes=$((24 * 1000 * 1000))

stages=(backbone stats decoder level cascade head)
for needed in model/{level1,cascade,rgb_decoder,dpt_head}.safetensors eval/report.json "${stages[@]/%//report.json}"; do
  if [ ! -f "$runs/$needed" ]; then
    echo "ship_tiny: expected $runs/$needed, found none; run scripts/train_tiny.sh $runs first." >&2
    exit 1
  fi
done
bytes=$(cat "$runs"/model/*.safetensors | wc -c)
if [ "$bytes" -gt "$most_bytes" ]; then
  echo "ship_tiny: expected at most $most_bytes bytes of weights, found $bytes in $runs/model; shrink $tiny/model.yaml." >&2
  exit 1
fi

# The weights must be of the architecture that they are shipped with: a scene is made with both.
together=$(mktemp -d)
trap 'rm -rf "$together"' EXIT
cp "$tiny/model.yaml" "$runs"/model/*.safetensors "$together/"
if ! build/release/cli/gld eval --model "$together" --synthetic 1 --pictures 0 --out "$together/eval" >/dev/null; then
  echo "ship_tiny: expected weights of the model in $tiny/model.yaml in $runs/model, found others; train them again." >&2
  exit 1
fi

cp "$runs"/model/*.safetensors "$tiny/"
rm -rf "$tiny/training" "$tiny/evaluation"
for stage in backbone decoder level cascade head; do
  mkdir -p "$tiny/training/$stage"
  cp "$runs/$stage"/{config.yaml,loss.png,metrics.jsonl,report.json} "$tiny/training/$stage/"
  if [ -d "$runs/$stage/validation" ]; then  # M1 trains before there is a decoder to draw with
    cp "$(find "$runs/$stage/validation" -name 'step_*.png' | sort | tail -1)" "$tiny/training/$stage/validation.png"
  fi
done
mkdir -p "$tiny/training/stats" "$tiny/evaluation"
cp "$runs"/stats/{config.yaml,report.json} "$tiny/training/stats/"
cp "$runs"/eval/{config.yaml,eval.csv,report.json} "$tiny/evaluation/"
# The records name the runs where others will have them.
{ grep -rl -- "$runs/" "$tiny/training" "$tiny/evaluation" || true; } | xargs -r sed -i "s#$runs/#runs/tiny/#g"
# Its errors were those of other weights.
rm -f "$tiny/plan_errors.json"
echo "ship_tiny: $bytes bytes of weights are in $tiny; measure their sampling errors with gld bench sample-plan" \
  "--model $tiny --write-table --out docs/measured/sample_plan"
