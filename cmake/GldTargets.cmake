# Functions with which every room declares its library and its tests.

include(RoomTable)
gld_read_room_table(${PROJECT_SOURCE_DIR}/docs/ARCHITECTURE.md)
set_property(DIRECTORY ${PROJECT_SOURCE_DIR} APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS docs/ARCHITECTURE.md)

function(gld_target_defaults target)
  target_include_directories(${target} PUBLIC ${PROJECT_SOURCE_DIR})
  target_compile_options(${target} PRIVATE -Wall -Wextra)
  # clang is told nothing of warnings and pragmas that only g++ has.
  target_compile_options(${target} PRIVATE "$<$<CXX_COMPILER_ID:Clang>:-Wno-unknown-warning-option;-Wno-unknown-pragmas>")
  # Nobody replaces a function of ours at run time: within a room they are inlined as in a program.
  target_compile_options(${target} PRIVATE $<$<CXX_COMPILER_ID:GNU>:-fno-semantic-interposition>)
  # As the rooms are for libgld.so: a precompiled header serves only sources of its own kind of code.
  get_target_property(type ${target} TYPE)
  if(type STREQUAL EXECUTABLE)
    set_target_properties(${target} PROPERTIES POSITION_INDEPENDENT_CODE OFF)
    target_compile_options(${target} PRIVATE -fPIC)
  endif()
  # g++ collects its garbage again and again beside a precompiled header of 500 MB: for nothing, in a tenth of its time.
  target_compile_options(${target} PRIVATE $<$<CXX_COMPILER_ID:GNU>:--param=ggc-min-heapsize=1048576>)
  if(GLD_WARNINGS_AS_ERRORS)
    target_compile_options(${target} PRIVATE -Werror)
  endif()
  if(GLD_FUZZ)
    target_compile_options(${target} PRIVATE -fsanitize=fuzzer-no-link)
  endif()
  if(GLD_SANITIZE)
    target_compile_options(${target} PUBLIC -fsanitize=address,undefined -fno-sanitize-recover=all -fno-omit-frame-pointer)
    # A null or overflowed pointer that is used AddressSanitizer finds too; a wrong downcast, and a pointer that is only computed,
    # nothing finds then. With them gld/photogrammetry takes 61 s to compile in the place of 44.
    target_compile_options(${target} PUBLIC -fno-sanitize=null,vptr,object-size,pointer-overflow)
    target_link_options(${target} PUBLIC -fsanitize=address,undefined)
  endif()
endfunction()

# What computes nothing itself that takes time is compiled with -O1: tests, commands, pages, readers of text, and all that includes
# LibTorch, whose products and convolutions are others' and whose loops over pixels are in rooms without it, but for few that take no
# time beside those (models/blending lays a large picture together as fast as before). Half of a whole build is theirs, and one precompiled header serves all of LibTorch's (a build of the program alone: 320 s with -O3 where it was, 296 so, on two
# Zen 5 cores; sampling, training and evaluating take as long). Not -O0: under the sanitizers, where that saves half of
# compiling tests, they then take 565 s in the place of 168, since what headers define is linked from them.
set(GLD_LIGHT_OPTIMISATION -O1)
# Only where the rest is optimised more: a quick build (scripts/build.sh --quick) has none at all beside its kernels.
if(CMAKE_BUILD_TYPE STREQUAL "Release" AND CMAKE_CXX_FLAGS_RELEASE MATCHES "-O3")
  set(GLD_HAS_LIGHT_CODE ON)
endif()
set(GLD_LIGHT_ROOMS "^(ablate/.*|bench/.*|cli|datasets/(check|formats|pictures)|gld/report|infer/(page|paths|run_export)|train/page)$")

# gld_shared_headers(NAME FOLDER LIBRARIES...): the library gld_NAME_headers, for the precompiled header FOLDER/NAME_precompiled.h, which
# all sources with LibTorch share (torch: its headers cost 25 s a file otherwise), and all without (plain). What g++ reads from a
# precompiled header it optimises as that was: all with LibTorch is compiled with less, and gld_light_plain_headers is for those without
# that are.
function(gld_shared_headers name folder)
  gld_precompiled_headers(gld_${name}_headers ${folder}/${name}_precompiled ${ARGN})
  if(GLD_HAS_LIGHT_CODE AND name STREQUAL "torch")
    target_compile_options(gld_torch_headers PRIVATE ${GLD_LIGHT_OPTIMISATION})
  elseif(GLD_HAS_LIGHT_CODE)
    gld_precompiled_headers(gld_light_${name}_headers ${folder}/${name}_precompiled gld_${name}_headers)
    target_compile_options(gld_light_${name}_headers PRIVATE ${GLD_LIGHT_OPTIMISATION})
  endif()
endfunction()

function(gld_precompiled_headers target header)
  add_library(${target} STATIC EXCLUDE_FROM_ALL ${PROJECT_SOURCE_DIR}/${header}.cpp)
  gld_target_defaults(${target})
  target_link_libraries(${target} PUBLIC ${ARGN})
  target_precompile_headers(${target} PRIVATE ${PROJECT_SOURCE_DIR}/${header}.h)
endfunction()

# gld_light(TARGET): compiled with less optimisation; before gld_use_headers.
function(gld_light target)
  if(GLD_HAS_LIGHT_CODE)
    target_compile_options(${target} PRIVATE ${GLD_LIGHT_OPTIMISATION})
    set_target_properties(${target} PROPERTIES GLD_LIGHT ON)
  endif()
endfunction()

# The precompiled header NAME for the sources of a target. CMake warns of every target that is to share one where there is none
# (scripts/tidy.sh).
function(gld_use_headers name target)
  target_link_libraries(${target} PUBLIC gld_${name}_headers)
  # A LibTorch with an fmt of its own hides the one that the plain header has from those that are linked with both.
  if(name STREQUAL "plain" AND GLD_TORCH_FMT)
    return()
  endif()
  if(CMAKE_DISABLE_PRECOMPILE_HEADERS)
    return()
  endif()
  get_target_property(light ${target} GLD_LIGHT)
  if(light AND TARGET gld_light_${name}_headers)
    target_precompile_headers(${target} REUSE_FROM gld_light_${name}_headers)
  else()
    target_precompile_headers(${target} REUSE_FROM gld_${name}_headers)
  endif()
endfunction()

# Sources of a target in batches, one translation unit each; those with options of their own (the kernels of an instruction
# set) stay alone.
function(gld_unity target batch)
  set_target_properties(${target} PROPERTIES UNITY_BUILD ${GLD_UNITY} UNITY_BUILD_BATCH_SIZE ${batch})
endfunction()

# gld_room_target(TARGET ROOM): the library of a room, gld_flow_solvers for gld/flow/solvers.
function(gld_room_target target room)
  string(REPLACE "/" "_" name ${room})
  set(${target} ${name} PARENT_SCOPE)
endfunction()

# gld_room([SOURCES a.cpp ...] [TORCH_SOURCES b.cpp ...] [LIBRARIES x ...] [PRIVATE_LIBRARIES y ...])
# The library of the room in the current folder, linked with the rooms that docs/ARCHITECTURE.md lets it include.
# PRIVATE_LIBRARIES are those that only its sources include. TORCH_SOURCES include LibTorch; GLD_SANITIZE leaves them out, and a room of them alone with them.
function(gld_room)
  cmake_parse_arguments(arg "" "" "SOURCES;TORCH_SOURCES;LIBRARIES;PRIVATE_LIBRARIES" ${ARGN})
  file(RELATIVE_PATH room ${PROJECT_SOURCE_DIR} ${CMAKE_CURRENT_SOURCE_DIR})
  if(NOT room IN_LIST GLD_ROOMS)
    message(FATAL_ERROR "${room} is no room: add it to the table in docs/ARCHITECTURE.md.")
  endif()
  if(GLD_SANITIZE)
    set(arg_TORCH_SOURCES "")
  endif()
  if(NOT arg_SOURCES AND NOT arg_TORCH_SOURCES)
    return()
  endif()
  gld_room_target(target ${room})
  add_library(${target} STATIC ${arg_SOURCES} ${arg_TORCH_SOURCES})
  gld_target_defaults(${target})
  gld_unity(${target} 16)
  if(arg_TORCH_SOURCES OR room MATCHES "${GLD_LIGHT_ROOMS}")
    gld_light(${target})
  endif()
  foreach(included IN LISTS GLD_ROOM_${room})
    gld_room_target(library ${included})
    if(TARGET ${library})
      target_link_libraries(${target} PUBLIC ${library})
    endif()
  endforeach()
  target_link_libraries(${target} PUBLIC ${arg_LIBRARIES} PRIVATE ${arg_PRIVATE_LIBRARIES})
  if(arg_TORCH_SOURCES)
    gld_use_headers(torch ${target})
    set_source_files_properties(${arg_SOURCES} PROPERTIES SKIP_PRECOMPILE_HEADERS ON)
  else()
    gld_use_headers(plain ${target})
  endif()
endfunction()

# gld_knows_commit(TARGET SOURCE): a source of the room in the current folder may include gld_commit.h, which defines GLD_COMMIT,
# the commit of the tree as it is when the program is built. Such a source is compiled alone, since every commit changes it.
function(gld_knows_commit target source)
  if(NOT TARGET ${target})
    return()
  endif()
  set(folder ${PROJECT_BINARY_DIR}/commit)
  if(NOT TARGET gld_commit)
    add_custom_target(gld_commit COMMAND ${CMAKE_COMMAND} -DROOT=${PROJECT_SOURCE_DIR} -DFILE=${folder}/gld_commit.h
      -P ${PROJECT_SOURCE_DIR}/cmake/write_commit.cmake BYPRODUCTS ${folder}/gld_commit.h)
  endif()
  add_dependencies(${target} gld_commit)
  set_source_files_properties(${source} PROPERTIES INCLUDE_DIRECTORIES ${folder} SKIP_UNITY_BUILD_INCLUSION ON)
endfunction()

# gld_rooms_included(ROOMS SOURCE): the libraries of the rooms that a test includes, itself or through a header of tests/.
function(gld_rooms_included result source)
  file(STRINGS ${PROJECT_SOURCE_DIR}/${source} lines ENCODING UTF-8 REGEX "^#include \"[^\"]+\"")
  set(libraries "")
  foreach(line IN LISTS lines)
    string(REGEX REPLACE "^#include \"([^\"]+)\".*" "\\1" included "${line}")
    get_filename_component(room ${included} DIRECTORY)
    if(room IN_LIST GLD_ROOMS)
      gld_room_target(library ${room})
      list(APPEND libraries ${library})
    elseif(included MATCHES "^tests/" AND EXISTS ${PROJECT_SOURCE_DIR}/${included})
      gld_rooms_included(more ${included})
      list(APPEND libraries ${more})
    endif()
  endforeach()
  list(REMOVE_DUPLICATES libraries)
  set(${result} ${libraries} PARENT_SCOPE)
endfunction()

# gld_test_suites(SUITES SOURCE): the googletest suites that a test file defines.
function(gld_test_suites result source)
  set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${source})
  file(STRINGS ${source} lines ENCODING UTF-8 REGEX "^TEST(_F|_P)?\\([A-Za-z0-9_]+")
  set(suites "")
  foreach(line IN LISTS lines)
    string(REGEX REPLACE "^TEST[_FP]*\\(([A-Za-z0-9_]+).*" "\\1" suite "${line}")
    list(APPEND suites ${suite})
  endforeach()
  list(REMOVE_DUPLICATES suites)
  if(NOT suites)
    message(FATAL_ERROR "${source}: expected a test, found none.")
  endif()
  set(${result} ${suites} PARENT_SCOPE)
endfunction()

# What a machine, or its LibTorch, may lack: a label each. A test for it is instantiated with the prefix on_LABEL and becomes a ctest entry of
# its own, x_test_on_LABEL, which fails where the hardware is missing; who runs tests leaves out and counts the labels that
# gld_missing_hardware names (scripts/hardware_labels.sh).
set(GLD_TEST_HARDWARE avx2 avx512 avx512_bf16 avx512_vnni amx_bf16 amx_int8 gpu libtorch_1 libtorch_2)

# gld_test_hardware(LABELS SOURCE): those of the hardware for which a test file instantiates suites.
function(gld_test_hardware result source)
  file(STRINGS ${source} lines ENCODING UTF-8 REGEX "^INSTANTIATE_TEST_SUITE_P\\(on_[a-z0-9_]+,")
  set(labels "")
  foreach(line IN LISTS lines)
    string(REGEX REPLACE "^INSTANTIATE_TEST_SUITE_P\\(on_([a-z0-9_]+),.*" "\\1" label "${line}")
    if(NOT label IN_LIST GLD_TEST_HARDWARE)
      message(FATAL_ERROR "${source}: expected hardware that GLD_TEST_HARDWARE names, found on_${label}.")
    endif()
    list(APPEND labels ${label})
  endforeach()
  list(REMOVE_DUPLICATES labels)
  set(${result} ${labels} PARENT_SCOPE)
endfunction()

# One ctest entry: the cases of a program that a filter names. A skipped case fails it, and a filter that names none.
function(gld_test_entry name program filter)
  add_test(NAME ${name} COMMAND ${program} --gtest_filter=${filter})
  set_tests_properties(${name} PROPERTIES
    FAIL_REGULAR_EXPRESSION "SKIPPED;No tests were found;0 tests from 0 test suites" TIMEOUT 600)
  if(GLD_SANITIZE)
    set_tests_properties(${name} PROPERTIES
      ENVIRONMENT "LSAN_OPTIONS=suppressions=${PROJECT_SOURCE_DIR}/tests/leak_suppressions.txt")
  endif()
endfunction()

# gld_test_program(PROGRAM FOLDER TESTS LIBRARIES...): one executable of the test files of a folder, since every program links
# LibTorch's rooms anew, and a ctest entry for each file, which runs that file's suites; a skipped case fails the entry. A test
# may include any room, not only its own, and is linked with those that it includes.
function(gld_test_program program folder tests)
  list(TRANSFORM tests PREPEND ${folder}/ OUTPUT_VARIABLE sources)
  list(TRANSFORM sources APPEND .cpp)
  add_executable(${program} ${sources})
  gld_target_defaults(${program})
  gld_unity(${program} 8)
  gld_light(${program})  # what tests multiply, they multiply in the rooms
  if(GLD_SANITIZE)
    target_compile_options(${program} PRIVATE -g0)  # a tenth of their time; rooms have their lines
  endif()
  foreach(source IN LISTS sources)
    gld_rooms_included(rooms tests/${source})
    foreach(room IN LISTS rooms)
      if(TARGET ${room})
        target_link_libraries(${program} PRIVATE ${room})
      endif()
    endforeach()
  endforeach()
  target_link_libraries(${program} PRIVATE ${ARGN} gld_test_support GTest::gmock gld_test_main)
  set(all_suites "")
  foreach(name IN LISTS tests)
    gld_test_suites(suites ${CMAKE_CURRENT_SOURCE_DIR}/${folder}/${name}.cpp)
    foreach(suite IN LISTS suites)
      if(suite IN_LIST all_suites)
        message(FATAL_ERROR "tests/${folder}/${name}.cpp: expected a suite that no other file of ${program} has, found ${suite}.")
      endif()
    endforeach()
    list(APPEND all_suites ${suites})
    gld_test_hardware(hardware ${CMAKE_CURRENT_SOURCE_DIR}/${folder}/${name}.cpp)
    set(filter "")
    foreach(suite IN LISTS suites)
      list(APPEND filter "${suite}.*" "*/${suite}.*")
    endforeach()
    list(JOIN filter ":" filter)
    list(TRANSFORM hardware REPLACE "(.+)" "on_\\1/*" OUTPUT_VARIABLE elsewhere)
    list(JOIN elsewhere ":" elsewhere)
    gld_test_entry(${name} ${program} "${filter}:-${elsewhere}")
    foreach(label IN LISTS hardware)
      list(TRANSFORM suites REPLACE "(.+)" "on_${label}/\\1.*" OUTPUT_VARIABLE filter)
      list(JOIN filter ":" filter)
      gld_test_entry(${name}_on_${label} ${program} "${filter}")
      set_tests_properties(${name}_on_${label} PROPERTIES LABELS ${label})
    endforeach()
  endforeach()
endfunction()

# gld_room_tests(ROOM [NAME x] [LIBRARIES y ...] [SOURCES s.cpp ...] [TESTS a_test ...] [TORCH_TESTS b_test ...])
# A ctest entry for each file tests/ROOM/a_test.cpp, in a program for the room's TESTS and one for its TORCH_TESTS (called again
# with a NAME, in programs of their own); those with LibTorch have the label libtorch, and GLD_SANITIZE leaves them out. A room
# that is not built has no tests. SOURCES is what the tests with LibTorch have beside their own files.
function(gld_room_tests room)
  gld_room_target(library ${room})
  if(TARGET ${library})
    gld_folder_tests(${room} LIBRARIES ${library} ${ARGN})
  endif()
endfunction()

# gld_label_tests(LABEL TEST...): one more label, of those of the tests that are built and of their entries for hardware.
function(gld_label_tests label)
  foreach(test IN LISTS ARGN)
    foreach(hardware IN ITEMS "" ${GLD_TEST_HARDWARE})
      string(REGEX REPLACE "(.+)" "_on_\\1" ending "${hardware}")
      if(TEST ${test}${ending})
        set_property(TEST ${test}${ending} APPEND PROPERTY LABELS ${label})
      endif()
    endforeach()
  endforeach()
endfunction()

# gld_labelled_tests(LABEL LIBRARIES x ... [TESTS a_test ...] [TORCH_TESTS b_test ...])
# The same for tests/LABEL; ctest -L LABEL selects them, and the test presets leave them out.
function(gld_labelled_tests label)
  gld_folder_tests(${label} ${ARGN} LABEL ${label})
endfunction()

function(gld_folder_tests folder)
  cmake_parse_arguments(arg "" "LABEL;NAME" "LIBRARIES;SOURCES;TESTS;TORCH_TESTS" ${ARGN})
  string(REPLACE "/" "_" program ${folder})
  if(arg_NAME)
    string(APPEND program _${arg_NAME})
  endif()
  if(arg_TESTS)
    gld_test_program(${program}_tests ${folder} "${arg_TESTS}" ${arg_LIBRARIES})
    gld_use_headers(plain ${program}_tests)
  endif()
  if(arg_TORCH_TESTS AND NOT GLD_SANITIZE)
    gld_test_program(${program}_torch_tests ${folder} "${arg_TORCH_TESTS}" ${arg_LIBRARIES})
    target_sources(${program}_torch_tests PRIVATE ${arg_SOURCES})
    target_link_libraries(${program}_torch_tests PRIVATE gld_test_seeded)
    gld_use_headers(torch ${program}_torch_tests)
    if(NOT arg_LABEL)
      # Benchmarks, ablations and evaluation call nothing of LibTorch that these rooms do not: a second build is for them.
      if(folder MATCHES "^(gld|models|train|verify|cli|infer/pipeline|infer/sample)(/|$)")
        gld_label_tests(libtorch ${arg_TORCH_TESTS})
        set_property(GLOBAL APPEND PROPERTY GLD_TESTS_OF_LIBTORCH ${program}_torch_tests)
      endif()
    endif()
  endif()
  if(arg_LABEL)
    gld_label_tests(${arg_LABEL} ${arg_TESTS} ${arg_TORCH_TESTS})
  endif()
endfunction()
