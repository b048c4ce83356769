# cmake -DGLD=build/release/cli/gld -DMANUAL=gld.1 -P cmake/write_manual.cmake: the manual page, made by the program from its
# registry of commands and options; whole or not at all.
execute_process(COMMAND ${GLD} help --man OUTPUT_FILE ${MANUAL}.part ERROR_VARIABLE errors RESULT_VARIABLE status)
if(NOT status EQUAL 0)
  file(REMOVE ${MANUAL}.part)
  message(FATAL_ERROR "${GLD} help --man: expected a manual page, found status ${status}: ${errors}")
endif()
file(RENAME ${MANUAL}.part ${MANUAL})
