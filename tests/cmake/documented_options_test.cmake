# The check of options in documents passes on this tree, and refuses one that is not there, of a command and of a kind of it.
# cmake -DROOT=tree -DGLD=program -DSCRATCH=folder -P documented_options_test.cmake
function(check tree expected)
  execute_process(COMMAND ${CMAKE_COMMAND} -DROOT=${tree} -DGLD=${GLD} -P ${ROOT}/cmake/check_documented_options.cmake
    RESULT_VARIABLE status ERROR_VARIABLE errors OUTPUT_QUIET)
  if(expected STREQUAL "" AND status)
    message(FATAL_ERROR "expected the documents of ${tree} to pass, found: ${errors}")
  elseif(NOT expected STREQUAL "" AND NOT errors MATCHES "${expected}")
    message(FATAL_ERROR "expected ${tree} to be refused with ${expected}, found: ${errors}")
  endif()
endfunction()
check(${ROOT} "")

file(REMOVE_RECURSE ${SCRATCH})
file(WRITE ${SCRATCH}/README.md "Say `gld sample --scene DIR\n--preset fast` or `scripts/build.sh --libtorch DIR`.\n")
check(${SCRATCH} "README.md: expected an option of gld sample, found --preset\n")
file(WRITE ${SCRATCH}/README.md "So:\n\n    build/release/cli/gld train level --level 0 \\\n        --epochs 2\n")
check(${SCRATCH} "README.md: expected an option of gld train level, found --epochs\n")
