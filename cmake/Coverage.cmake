# What the preset coverage needs: counters in the sources of some folders of lib.
#
# Each process adds its counts to the files in profiles/ of the build, which
# scripts/measure_coverage.py reads.
set(TAI_COVERAGE "" CACHE STRING
  "Folders of lib to count in, such as AD;Runtime/Tape; or all")

# The counts of all processes go into four files, which are merged in place.
set(TAI_COVERAGE_FLAGS
  "-fprofile-instr-generate=${PROJECT_BINARY_DIR}/profiles/%4m.profraw" -fcoverage-mapping)

# tai_cover(<sources>): counters in the sources that TAI_COVERAGE names.
function(tai_cover)
  if(NOT TAI_COVERAGE)
    return()
  endif()
  list(JOIN TAI_COVERAGE "|" folders)
  if(TAI_COVERAGE STREQUAL "all")
    set(folders ".*")
  endif()
  foreach(source ${ARGN})
    cmake_path(ABSOLUTE_PATH source BASE_DIRECTORY "${CMAKE_CURRENT_SOURCE_DIR}")
    if(source MATCHES "^${PROJECT_SOURCE_DIR}/lib/(${folders})/.*\\.cpp$")
      set_property(SOURCE "${source}" APPEND PROPERTY COMPILE_OPTIONS ${TAI_COVERAGE_FLAGS})
    endif()
  endforeach()
endfunction()

if(TAI_COVERAGE)
  foreach(kind SHARED MODULE)
    string(APPEND CMAKE_${kind}_LINKER_FLAGS " -fprofile-instr-generate")
  endforeach()
endif()
