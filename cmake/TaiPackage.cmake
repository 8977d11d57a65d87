# Makes find_package(Tai) work, from the build folder and from an installation.
# In portable mode the library exports the C API alone, and there is no package.
if(NOT TARGET tai OR TAI_PORTABLE)
  return()
endif()
include(CMakePackageConfigHelpers)
set(TAI_CMAKE_DIR "${CMAKE_INSTALL_LIBDIR}/cmake/tai")

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

set(TAI_CONFIG_PLUGIN "${PROJECT_BINARY_DIR}/lib/TaiPlugin.so")
configure_package_config_file(cmake/TaiConfig.cmake.in
  "${PROJECT_BINARY_DIR}/lib/cmake/tai/TaiConfig.cmake" INSTALL_DESTINATION "${TAI_CMAKE_DIR}")
set(TAI_CONFIG_PLUGIN "\${PACKAGE_PREFIX_DIR}/${CMAKE_INSTALL_LIBDIR}/TaiPlugin.so")
configure_package_config_file(cmake/TaiConfig.cmake.in
  "${PROJECT_BINARY_DIR}/install/TaiConfig.cmake" INSTALL_DESTINATION "${TAI_CMAKE_DIR}")
write_basic_package_version_file("${PROJECT_BINARY_DIR}/lib/cmake/tai/TaiConfigVersion.cmake"
  COMPATIBILITY SameMinorVersion)
install(FILES "${PROJECT_BINARY_DIR}/install/TaiConfig.cmake"
  "${PROJECT_BINARY_DIR}/lib/cmake/tai/TaiConfigVersion.cmake"
  DESTINATION "${TAI_CMAKE_DIR}" COMPONENT headers)
