# The portable mode: LLVM and MLIR statically inside libtai.
#
# The package's CMake targets (MLIRxxx) bring the LLVM shared library along, so
# the archives are named by hand, all in one group: the linker takes the members
# that are needed, in whatever order they need each other.

file(GLOB archives "${LLVM_LIBRARY_DIR}/libLLVM*.a" "${LLVM_LIBRARY_DIR}/libMLIR*.a")
# The C API is taken whole, by add_tai_shared_library; the test libraries hold
# second definitions of what others define.
list(FILTER archives EXCLUDE REGEX "libMLIR(CAPI|Test|.*TestPasses)")

# LLVM's own needs, static too, so that the bundle needs the C and C++ run time
# libraries and nothing else of the system.
find_library(TAI_ZLIB NAMES libz.a REQUIRED)
find_library(TAI_ZSTD NAMES libzstd.a REQUIRED)
mark_as_advanced(TAI_ZLIB TAI_ZSTD)

set(TAI_PORTABLE_LINK
  -Wl,--start-group ${archives} -Wl,--end-group ${TAI_ZLIB} ${TAI_ZSTD} pthread dl m rt)

# Vector functions for loops, without which loops call libm. libtai looks for them
# next to itself.
find_library(TAI_SLEEF NAMES libsleef.so.3)
mark_as_advanced(TAI_SLEEF)
if(TAI_SLEEF)
  file(REAL_PATH "${TAI_SLEEF}" sleef)
  install(FILES "${sleef}" DESTINATION "${CMAKE_INSTALL_LIBDIR}" RENAME libsleef.so.3
    COMPONENT library)
endif()

# The licences of what is linked or copied into the bundle, from Debian's packages.
foreach(name llvm=libmlir-22-dev sleef=libsleef3 zlib=zlib1g-dev zstd=libzstd-dev)
  string(REGEX MATCH "([a-z]+)=(.*)" _ "${name}")
  set(license "/usr/share/doc/${CMAKE_MATCH_2}/copyright")
  if(EXISTS "${license}")
    install(FILES "${license}" DESTINATION "${TAI_LICENSE_DESTINATION}"
      RENAME "LICENSE.${CMAKE_MATCH_1}" COMPONENT library)
  endif()
endforeach()
install(FILES "${PROJECT_SOURCE_DIR}/LICENSE" DESTINATION "${TAI_LICENSE_DESTINATION}"
  COMPONENT library)

# tai_portable_exports(): what libtai exports is the C API and what the tools
# use of it, nothing else: a process may hold another LLVM too.
function(tai_portable_exports)
  get_property(tools GLOBAL PROPERTY TAI_TOOLS)
  set(objects $<TARGET_OBJECTS:TaiToolsCommon>)
  foreach(tool ${tools})
    list(APPEND objects $<TARGET_OBJECTS:${tool}-objects>)
  endforeach()
  set(script "${PROJECT_BINARY_DIR}/libtai.exports")
  set(roots "${PROJECT_BINARY_DIR}/libtai.roots")
  add_custom_command(OUTPUT "${script}" "${roots}"
    COMMAND "${CMAKE_COMMAND}" -D "NM=${LLVM_TOOLS_BINARY_DIR}/llvm-nm"
      -D "OBJECTS=${objects}" -D "SCRIPT=${script}" -D "ROOTS=${roots}"
      -P "${PROJECT_SOURCE_DIR}/cmake/PortableExports.cmake"
    DEPENDS ${objects} "${PROJECT_SOURCE_DIR}/cmake/PortableExports.cmake"
    COMMENT "Listing what the tools need of libtai" VERBATIM)
  add_custom_target(tai-exports DEPENDS "${script}" "${roots}")
  add_dependencies(tai tai-exports)
  target_link_options(tai PRIVATE
    "-Wl,--version-script=${script}" -Wl,--undefined-version "${roots}"
    -Wl,--gc-sections -Wl,-Bsymbolic -Wl,-s)
  set_property(TARGET tai APPEND PROPERTY LINK_DEPENDS "${script}" "${roots}")
endfunction()
