#!/usr/bin/env bash
# Attacks the program for some time and writes down what was done, a line a round:
#   scripts/attack.sh MINUTES [all|command_lines|files [RECORD]]    RECORD: docs/measured/attack/rounds.csv by default
# In turn 400 command lines drawn from the registry of commands and options (random_command_lines_test), 5 rounds, and mutated
# files through every reader under AddressSanitizer and UBSan (scripts/fuzz.sh), 20 s a reader. Every round has a seed of its
# own, the next after those of the record, so that another night goes on where this one ended. A finding ends nothing: it is
# counted, what was said of it lies in runs/attack, and the exit status is 1 at the end.
set -euo pipefail
cd "$(dirname "$0")/.."
if ! [[ ${1:-} =~ ^[0-9]+$ ]]; then
  echo "attack: expected a number of minutes, found '${1:-}'; write for example scripts/attack.sh 60." >&2
  exit 2
fi
until=$((SECONDS + 60 * $1))
attacks=${2:-all}
case $attacks in all | command_lines | files) ;; *)
  echo "attack: expected all, command_lines or files, found '$attacks'." >&2
  exit 2
  ;;
esac
record=${3:-docs/measured/attack/rounds.csv}
said=runs/attack
program=build/release/tests/cli_random_torch_tests
[ -x "$program" ] || scripts/build.sh cli_random_torch_tests
mkdir -p "$said" "$(dirname "$record")"
[ -s "$record" ] || echo "attack,seed,cases,seconds,findings,commit" >"$record"
commit=$(git describe --always --dirty)
found=0

next_seed() { awk -F, -v attack="$1" '$1 == attack && $2 >= seed { seed = $2 } END { print seed + 1 }' "$record"; }

# note ATTACK SEED CASES SECONDS FINDINGS
note() {
  echo "$1,$2,$3,$4,$5,$commit" >>"$record"
  found=$((found + $5))
}

command_lines() {
  local seed begun=$SECONDS log findings
  seed=$(next_seed command_lines)
  log=$said/command_lines_$seed.log
  "$program" --gtest_shuffle --gtest_random_seed="$seed" >"$log" 2>&1 || true
  if ! grep -q '^\[==========\] .* ran' "$log"; then
    echo "attack: $program ended before its tests did; see $log." >&2
    exit 1
  fi
  findings=$(grep -c ': Failure$' "$log" || true)
  note command_lines "$seed" 400 $((SECONDS - begun)) "$findings"
  [ "$findings" -gt 0 ] || rm "$log"
}

files() {
  local seed log kind units
  seed=$(next_seed safetensors)
  log=$said/files_$seed.log
  scripts/fuzz.sh --seed "$seed" 20 >"$log" 2>&1 || true
  if ! grep -qE '^fuzz: .*number_of_executed_units| failed; ' "$log"; then
    echo "attack: scripts/fuzz.sh ended before it read a file; see $log." >&2
    exit 1
  fi
  while read -r kind units; do note "$kind" "$seed" "$units" 20 0; done \
    < <(sed -nE 's/^fuzz: ([a-z0-9_]+): number_of_executed_units: ([0-9]+), .*/\1 \2/p' "$log")
  for kind in $(sed -nE 's/^fuzz: ([a-z0-9_]+) failed; .*/\1/p' "$log"); do note "$kind" "$seed" 0 20 1; done
  grep -q ' failed; ' "$log" || rm "$log"
}

while [ $SECONDS -lt $until ]; do
  for round in 1 2 3 4 5; do
    [ $SECONDS -ge $until ] || [ "$attacks" = files ] || command_lines
  done
  [ $SECONDS -ge $until ] || [ "$attacks" = command_lines ] || files
done
awk -F, 'NR > 1 { if ($1 == "command_lines") lines += $3; else files += $3; found += $5 }
  END { printf "attack: in the record %d command lines and %d mutated files, %d findings\n", lines, files, found }' "$record"
[ $found -eq 0 ]
