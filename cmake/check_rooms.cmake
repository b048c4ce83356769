# cmake -P cmake/check_rooms.cmake: every #include of a source of ours, however it is spaced and quoted, must be of its own
# room or of one that the table in docs/ARCHITECTURE.md allows. -DROOT=DIR checks another tree.
# Families of backbones are named in their room and in the table of published files alone: everything else goes through
# backbone.h and backbone_registry.h.
cmake_minimum_required(VERSION 3.25)
get_filename_component(here ${CMAKE_CURRENT_LIST_DIR}/.. ABSOLUTE)
if(NOT ROOT)
  set(ROOT ${here})
endif()
include(${CMAKE_CURRENT_LIST_DIR}/RoomTable.cmake)
gld_read_room_table(${ROOT}/docs/ARCHITECTURE.md)

set(problems "")
foreach(folder gld models datasets train infer bench verify ablate library cli)
  file(GLOB_RECURSE sources RELATIVE ${ROOT} ${ROOT}/${folder}/*.h ${ROOT}/${folder}/*.cpp)
  foreach(source IN LISTS sources)
    get_filename_component(room ${source} DIRECTORY)
    if(NOT room IN_LIST GLD_ROOMS)
      list(APPEND problems "${source}: expected a file inside a room of docs/ARCHITECTURE.md, found ${room}, which is none")
      continue()
    endif()
    file(STRINGS ${ROOT}/${source} includes ENCODING UTF-8
         REGEX "^[ \t]*#[ \t]*include[ \t]*(\"|<(gld|models|datasets|train|infer|bench|verify|ablate|library|cli)/)")
    foreach(line IN LISTS includes)
      string(REGEX REPLACE "^[ \t]*#[ \t]*include[ \t]*[\"<]([^\">]+).*" "\\1" included "${line}")
      get_filename_component(other ${included} DIRECTORY)
      if(NOT other STREQUAL room AND NOT other IN_LIST GLD_ROOM_${room})
        list(APPEND problems "${source}: expected includes of ${room} and of the rooms it may include, found \"${included}\"")
      endif()
      if(other STREQUAL models/backbones AND NOT room STREQUAL models/backbones
         AND NOT source STREQUAL models/bundle/published_backbones.cpp
         AND NOT included MATCHES "^models/backbones/(backbone|backbone_registry)\\.h$")
        list(APPEND problems "${source}: expected backbone.h or backbone_registry.h of models/backbones, which name no family, found \"${included}\"")
      endif()
    endforeach()
  endforeach()
endforeach()
if(problems)
  list(JOIN problems "\n  " text)
  message(FATAL_ERROR "Includes against the table of rooms (docs/ARCHITECTURE.md):\n  ${text}\n"
                      "Move the code to the room that it belongs to, or change the table.")
endif()
if(STAMP)
  file(TOUCH ${STAMP})
endif()
