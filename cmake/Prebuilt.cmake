# The Python module alone, against a libtai that is built already: TAI_PREBUILT is
# the folder of a portable bundle. So one libtai serves the wheels of all Pythons.
# The bundle has the headers of the C API; others, which need no library, are the tree's.
add_library(tai SHARED IMPORTED GLOBAL)
set_target_properties(tai PROPERTIES IMPORTED_LOCATION "${TAI_PREBUILT}/lib/libtai.so"
  INTERFACE_INCLUDE_DIRECTORIES "${TAI_PREBUILT}/include;${PROJECT_SOURCE_DIR}/include")

# Nothing is instrumented here.
function(tai_sanitize target)
endfunction()

# A wheel holds no links: libtai under the name that others ask the loader for.
file(REAL_PATH "${TAI_PREBUILT}/lib/libtai.so" library)
install(FILES "${library}" DESTINATION "${CMAKE_INSTALL_LIBDIR}" COMPONENT library
  RENAME "libtai.so.${PROJECT_VERSION_MAJOR}.${PROJECT_VERSION_MINOR}")
install(DIRECTORY "${TAI_PREBUILT}/lib/" DESTINATION "${CMAKE_INSTALL_LIBDIR}"
  COMPONENT library USE_SOURCE_PERMISSIONS
  PATTERN "libtai.so*" EXCLUDE PATTERN "cmake" EXCLUDE PATTERN "pkgconfig" EXCLUDE)
install(DIRECTORY "${TAI_PREBUILT}/bin/" DESTINATION "${CMAKE_INSTALL_BINDIR}"
  COMPONENT tools USE_SOURCE_PERMISSIONS)
install(DIRECTORY "${TAI_PREBUILT}/licenses/" DESTINATION "${TAI_LICENSE_DESTINATION}"
  COMPONENT library)
