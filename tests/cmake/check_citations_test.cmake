# The check of citations passes on this tree, and refuses a document, a section and a heading that are not there.
# cmake -DROOT=tree -DSCRATCH=folder -P check_citations_test.cmake
execute_process(COMMAND ${CMAKE_COMMAND} -P ${ROOT}/cmake/check_citations.cmake RESULT_VARIABLE status ERROR_VARIABLE errors)
if(status)
  message(FATAL_ERROR "expected this tree's citations to hold, found: ${errors}")
endif()

file(REMOVE_RECURSE ${SCRATCH})
file(MAKE_DIRECTORY ${SCRATCH}/docs)
file(WRITE ${SCRATCH}/docs/DESIGN.md "# Title\n\n## 4. Facts\n\n### Latent statistics\n")
function(check text expected)
  file(WRITE ${SCRATCH}/gld/base/a.h "${text}")
  execute_process(COMMAND ${CMAKE_COMMAND} -DROOT=${SCRATCH} -P ${ROOT}/cmake/check_citations.cmake
    RESULT_VARIABLE status ERROR_VARIABLE errors OUTPUT_QUIET)
  if(expected STREQUAL "" AND status)
    message(FATAL_ERROR "expected \"${text}\" to pass, found: ${errors}")
  elseif(NOT expected STREQUAL "" AND NOT errors MATCHES "${expected}")
    message(FATAL_ERROR "expected \"${text}\" to be refused with ${expected}, found: ${errors}")
  endif()
endfunction()
check("// DESIGN.md section 4, \"Latent\n// statistics\"\n" "")
check("// DESIGN.md section 5\n" "section 5")
check("// DESIGN.md section 4, \"Backbone\"\n" "\"Backbone\"")
check("// HOUSE.md\n" "HOUSE.md")
