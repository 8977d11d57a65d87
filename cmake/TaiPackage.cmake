# Makes find_package(Tai) and pkg-config work, from the build folder and from an
# installation, and installs headers, examples and documentation.
#
# The portable library exports the C API alone: its package has the component C
# (docs/decisions/0058-packages.md).
if(NOT TARGET tai OR SKBUILD)
  return()
endif()
include(CMakePackageConfigHelpers)
set(TAI_CMAKE_DIR "${CMAKE_INSTALL_LIBDIR}/cmake/tai")
set(TAI_SOVERSION "${PROJECT_VERSION_MAJOR}.${PROJECT_VERSION_MINOR}")

install(FILES include/tai-c/Tai.h include/tai-c/Sizes.h include/tai-c/Mesh.h
  "${PROJECT_BINARY_DIR}/include/tai-c/Version.h" DESTINATION include/tai-c COMPONENT headers)
if(TAI_PORTABLE)
  # The ABI of compiled kernels, and the part of MLIR's C API that libtai exports
  # (TAI_UPSTREAM_CAPI).
  install(FILES include/tai/ABI/Abi.h include/tai/ABI/Abi.def include/tai/ABI/MeshAbi.h DESTINATION include/tai/ABI
    COMPONENT headers)
  foreach(part AffineExpr AffineMap BuiltinAttributes BuiltinTypes Diagnostics IR IntegerSet
          Pass Support)
    install(FILES "${MLIR_INCLUDE_DIRS}/mlir-c/${part}.h" DESTINATION include/mlir-c
      COMPONENT headers)
  endforeach()
  set(upstream)
else()
  target_include_directories(tai SYSTEM INTERFACE
    "$<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}/include;${PROJECT_BINARY_DIR}/include>"
    "$<INSTALL_INTERFACE:include>"
    ${MLIR_INCLUDE_DIRS} ${LLVM_INCLUDE_DIRS})
  target_compile_features(tai INTERFACE cxx_std_17)
  install(DIRECTORY include/tai "${PROJECT_BINARY_DIR}/include/tai" DESTINATION include
    COMPONENT headers FILES_MATCHING PATTERN "*.h" PATTERN "*.def" PATTERN "*.td" PATTERN "*.inc"
    PATTERN "CMakeFiles" EXCLUDE)
  install(EXPORT TaiTargets NAMESPACE tai:: DESTINATION "${TAI_CMAKE_DIR}" COMPONENT headers)
  export(EXPORT TaiTargets NAMESPACE tai:: FILE "${PROJECT_BINARY_DIR}/lib/cmake/tai/TaiTargets.cmake")
  set(upstream ${MLIR_INCLUDE_DIRS} ${LLVM_INCLUDE_DIRS})
  list(REMOVE_DUPLICATES upstream)
endif()

# tai_package(<folder> <libdir> <plugin> <include>...): the files of CMake and of
# pkg-config with these places, in a folder of the build.
function(tai_package folder libdir plugin)
  set(TAI_CONFIG_PLUGIN "${plugin}")
  set(TAI_CONFIG_LIBRARY "${libdir}/libtai.so.${PROJECT_VERSION}")
  set(TAI_CONFIG_INCLUDES "${ARGN};${upstream}")
  if(TAI_PORTABLE)
    set(TAI_CONFIG_INCLUDES "${ARGN}")
    file(READ cmake/TaiConfigPortable.cmake.in part)
  else()
    file(READ cmake/TaiConfigCxx.cmake.in part)
  endif()
  string(CONFIGURE "${part}" TAI_CONFIG_CXX @ONLY)
  configure_package_config_file(cmake/TaiConfig.cmake.in "${folder}/cmake/tai/TaiConfig.cmake"
    INSTALL_DESTINATION "${TAI_CMAKE_DIR}")
  write_basic_package_version_file("${folder}/cmake/tai/TaiConfigVersion.cmake"
    COMPATIBILITY SameMinorVersion)

  # An installation may be moved.
  cmake_path(RELATIVE_PATH CMAKE_INSTALL_FULL_LIBDIR BASE_DIRECTORY "${CMAKE_INSTALL_PREFIX}"
    OUTPUT_VARIABLE below)
  string(REGEX REPLACE "[^/]+" ".." up "${below}")
  set(TAI_PC_PREFIX "\${pcfiledir}/../${up}")
  set(TAI_PC_LIBDIR "${libdir}")
  list(TRANSFORM TAI_CONFIG_INCLUDES PREPEND "-I" OUTPUT_VARIABLE TAI_PC_INCLUDES)
  list(JOIN TAI_PC_INCLUDES " " TAI_PC_INCLUDES)
  foreach(place TAI_PC_LIBDIR TAI_PC_INCLUDES)
    string(REPLACE "\${PACKAGE_PREFIX_DIR}" "\${prefix}" ${place} "${${place}}")
  endforeach()
  configure_file(cmake/tai-c.pc.in "${folder}/pkgconfig/tai-c.pc" @ONLY)
  if(NOT TAI_PORTABLE)
    configure_file(cmake/tai.pc.in "${folder}/pkgconfig/tai.pc" @ONLY)
  endif()
endfunction()
set(prefix "\${PACKAGE_PREFIX_DIR}")
tai_package("${PROJECT_BINARY_DIR}/lib" "${PROJECT_BINARY_DIR}/lib"
  "${PROJECT_BINARY_DIR}/lib/TaiPlugin.so"
  "${PROJECT_SOURCE_DIR}/include" "${PROJECT_BINARY_DIR}/include")
tai_package("${PROJECT_BINARY_DIR}/install" "${prefix}/${CMAKE_INSTALL_LIBDIR}"
  "${prefix}/${CMAKE_INSTALL_LIBDIR}/TaiPlugin.so" "${prefix}/include")
install(DIRECTORY "${PROJECT_BINARY_DIR}/install/cmake" "${PROJECT_BINARY_DIR}/install/pkgconfig"
  DESTINATION "${CMAKE_INSTALL_LIBDIR}" COMPONENT headers)

# Examples, and the reference: pages, and those that TableGen makes of dialects and
# passes.
install(DIRECTORY examples DESTINATION share/tai COMPONENT doc
  PATTERN "__pycache__" EXCLUDE PATTERN "build" EXCLUDE)
install(DIRECTORY docs/start docs/guides docs/reference DESTINATION share/doc/tai COMPONENT doc)
install(FILES docs/limits.md DESTINATION share/doc/tai COMPONENT doc)
if(TARGET mlir-doc)
  add_custom_target(tai-reference ALL)
  add_dependencies(tai-reference mlir-doc)
  install(DIRECTORY "${PROJECT_BINARY_DIR}/docs/reference" DESTINATION share/doc/tai COMPONENT doc
    FILES_MATCHING PATTERN "*.md")
endif()
