# Sourced by scripts that run tests: what of the hardware that tests are for this machine lacks, as ctest labels
# (cmake/GldTargets.cmake, GLD_TEST_HARDWARE). Such tests are left out and counted, and never pass without having run.

# missing_labels BUILD: one a line, as the program built there says.
missing_labels() { "$1"/tests/support/gld_missing_hardware; }

# left_out BUILD LABEL...: the regular expression for ctest -LE of these labels and the missing ones.
left_out() {
  local build=$1
  shift
  echo "^($(printf '%s\n' "$@" $(missing_labels "$build") | paste -sd '|'))\$"
}

# say_what_did_not_run BUILD CTEST_OPTION...: a line for each missing label that tests of the selection have.
say_what_did_not_run() {
  local build=$1 label count
  shift
  for label in $(missing_labels "$build"); do
    count=$(ctest --test-dir "$build" -N "$@" -L "^$label\$" | sed -n 's/^Total Tests: //p')
    if [ "$count" -gt 0 ]; then echo "not run here: $count, label $label"; fi
  done
}
