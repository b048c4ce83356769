#!/usr/bin/env bash
# From a fresh machine to novel views: installs, builds, draws a scene that no model was trained on, takes two of its
# pictures as sources, and samples two views between them and two of an orbit. Safe to run again.
set -euo pipefail
cd "$(dirname "$0")/.."

held_out_seed=910000
model=configs/tiny
out=runs/demo

scripts/setup.sh
scripts/build.sh gld

# The first room of its seed, not one that was chosen. Two sources and two targets are the four views that the model was trained
# on: more would be a warning. Samples are drawn as gld sample draws them where nothing else is asked for; pictures have the
# size of the drawn photographs, what these show at their own resolution.
build/release/cli/gld synth --seed "$held_out_seed" --scene-count 1 --frames 12 --width 448 --height 448 --out "$out/scene" --overwrite
scene=$(find "$out/scene" -name cameras.json -printf '%h\n' | sort | head -1)
sample=(build/release/cli/gld sample --model "$model" --scene "$scene" --sources 0,3 --size photographs --overwrite)
"${sample[@]}" --path orbit --orbit-degrees 20 --frames 2 --out "$out/orbit"
"${sample[@]}" --targets 1,2 --out "$out/targets"
echo
echo "demo: an orbit: $out/orbit/report.html; its geometry: $out/orbit/points.ply"
echo "demo: open this first, in a browser: $out/targets/report.html (with the true pictures)"
