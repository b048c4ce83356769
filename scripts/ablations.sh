#!/usr/bin/env bash
# Runs the ablations of configs/ablations (docs/ABLATIONS.md). Run it again to go on where it was stopped.
#   scripts/ablations.sh smoke [NAME...]   with one seed, few scenes and few steps: shows that everything runs
#   scripts/ablations.sh full [NAME...]    as they are described: hours to days on 2 cores
#   scripts/ablations.sh plan [NAME...]    what full would run and what that takes, as far as it is known
# Results go to runs/ablations/{smoke,full}/NAME, stages into one cache for all of them, because some have trainings in common.
# Commands of full runs are what docs/measured/ablations is made with.
set -euo pipefail
cd "$(dirname "$0")/.."
action=${1:-}
case "$action" in
  smoke | full | plan) shift ;;
  *)
    echo "ablations: expected smoke, full or plan, found '$action'; see the head of this script." >&2
    exit 2
    ;;
esac
gld=build/release/cli/gld
[ -x "$gld" ] || scripts/build.sh gld
if [ $# -gt 0 ]; then
  names=("$@")
else
  names=()
  for file in configs/ablations/*.yaml; do names+=("$(basename "$file" .yaml)"); done
fi
where=$action
options=()
case "$action" in
  smoke) options=(--smoke) ;;
  plan)
    where=full
    options=(--plan)
    ;;
esac
failed=()
for name in "${names[@]}"; do
  echo "ablations: $name"
  if "$gld" ablate --config "configs/ablations/$name.yaml" --out "runs/ablations/$where/$name" \
    --cache "runs/ablations/$where/cache" "${options[@]}"; then
    continue
  else
    status=$?
  fi
  [ "$status" != 130 ] || exit 130
  failed+=("$name")
done
if [ ${#failed[@]} -gt 0 ]; then
  echo "ablations: expected all to run, found failures in ${failed[*]}; their ablation.md says why." >&2
  exit 1
fi
