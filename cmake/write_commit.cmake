# cmake -DROOT=... -DFILE=... -P write_commit.cmake: writes FILE with the commit of the tree at ROOT as GLD_COMMIT, with "+"
# where tracked files differ from it, or "unknown" outside of git. Leaves a FILE that says so already, so that nothing is
# built again.
execute_process(COMMAND git -C ${ROOT} rev-parse HEAD OUTPUT_VARIABLE commit OUTPUT_STRIP_TRAILING_WHITESPACE
  ERROR_QUIET RESULT_VARIABLE problem)
if(problem)
  set(commit unknown)
else()
  execute_process(COMMAND git -C ${ROOT} diff-index --quiet HEAD -- RESULT_VARIABLE differs OUTPUT_QUIET ERROR_QUIET)
  if(differs)
    string(APPEND commit "+")
  endif()
endif()
set(text "#define GLD_COMMIT \"${commit}\"\n")
set(before "")
if(EXISTS ${FILE})
  file(READ ${FILE} before)
endif()
if(NOT text STREQUAL before)
  file(WRITE ${FILE} "${text}")
endif()
