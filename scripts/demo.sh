#!/usr/bin/env bash
# From a fresh machine to novel views: installs, builds, draws a scene that no model was trained on, takes two of its
# pictures as sources, and samples an orbit of targets. Safe to run again.
set -euo pipefail
cd "$(dirname "$0")/.."

held_out_seed=910000
model=configs/tiny
out=runs/demo

scripts/setup.sh
targets=(gld)
[ -e "$model/level1.safetensors" ] || targets+=(gld_write_random_bundle)
scripts/build.sh "${targets[@]}"

if [ ! -e "$model/level1.safetensors" ]; then
  echo
  echo "demo: $model holds no trained weights yet, so random ones are used: every stage runs, but the pictures are noise."
  model=$out/random_model
  mkdir -p "$out"
  build/release/tests/support/gld_write_random_bundle "$model" configs/tiny/model.yaml 1
fi

build/release/cli/gld synth --seed "$held_out_seed" --scenes 1 --frames 12 --width 112 --height 112 --out "$out/scene"
scene=$(find "$out/scene" -name cameras.json -printf '%h\n' | sort | head -1)
build/release/cli/gld sample --model "$model" --scene "$scene" --sources 0,6 --targets 2,3,4,9 --out "$out/targets"
build/release/cli/gld sample --model "$model" --scene "$scene" --sources 0,6 --path orbit --frames 6 --out "$out/orbit"
echo
echo "demo: look at $out/targets/contact_sheet.png (with the true pictures), $out/orbit/contact_sheet.png and $out/orbit/points.ply"
