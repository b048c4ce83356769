# The template of pages is taken with every seam once, and refused where one is missing, doubled or unknown, or where a script
# would end its element.
# cmake -DROOT=tree -DSCRATCH=folder -P embed_page_test.cmake
file(REMOVE_RECURSE ${SCRATCH})
file(MAKE_DIRECTORY ${SCRATCH})
file(READ ${ROOT}/gld/page/page.html whole)
file(WRITE ${SCRATCH}/style.css "a { b: c; }\n")
file(WRITE ${SCRATCH}/notice "</script> may stand here\n")

function(check template script expected)
  file(WRITE ${SCRATCH}/page.html "${template}")
  file(WRITE ${SCRATCH}/one.js "${script}")
  file(WRITE ${SCRATCH}/two.js "let two = [1, 2];\n")
  file(REMOVE ${SCRATCH}/page.cpp)
  execute_process(COMMAND ${CMAKE_COMMAND} -DTEMPLATE=${SCRATCH}/page.html -Dstyle=${SCRATCH}/style.css -Dthree=${SCRATCH}/one.js
      -Dcontrols=${SCRATCH}/one.js "-Dscripts=${SCRATCH}/one.js;${SCRATCH}/two.js" -Dnotice=${SCRATCH}/notice
      -DOUTPUT=${SCRATCH}/page.cpp -P ${ROOT}/gld/page/embed_page.cmake
    RESULT_VARIABLE status ERROR_VARIABLE errors OUTPUT_QUIET)
  string(REGEX REPLACE "[\n ]+" " " errors "${errors}")
  if(expected STREQUAL "" AND (status OR NOT EXISTS ${SCRATCH}/page.cpp))
    message(FATAL_ERROR "expected the template to be taken, found: ${errors}")
  elseif(NOT expected STREQUAL "" AND (NOT status OR NOT errors MATCHES "${expected}" OR EXISTS ${SCRATCH}/page.cpp))
    message(FATAL_ERROR "expected a refusal with ${expected}, found: ${errors}")
  endif()
endfunction()

check("${whole}" "let one = 1;\n" "")
file(READ ${SCRATCH}/page.cpp made)
string(REGEX MATCHALL "{\"[a-z]*\", " parts "${made}")
list(LENGTH parts count)
# 14 seams and the text before, between and behind them.
if(NOT count EQUAL 29)
  message(FATAL_ERROR "expected 29 parts of the template, found ${count}.")
endif()
string(REPLACE "{{verdict}}" "" missing "${whole}")
check("${missing}" "let one = 1;\n" "expected the seam {{verdict}} once, found it 0 times")
string(REPLACE "{{verdict}}" "{{verdict}}{{verdict}}" doubled "${whole}")
check("${doubled}" "let one = 1;\n" "expected the seam {{verdict}} once, found it 2 times")
string(REPLACE "{{verdict}}" "{{verdict}}{{verdicts}}" unknown "${whole}")
check("${unknown}" "let one = 1;\n" "found {{verdicts}}")
check("${whole}" "let one = '</SCRIPT>';\n" "expected nothing that ends an inline script")
check("${whole}" "let one = '<!--';\n" "expected nothing that ends an inline script")
check("${whole}" "let one = 1;\r\n" "carriage return")
