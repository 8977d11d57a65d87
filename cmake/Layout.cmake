# The places of an installation, relative to its prefix. SKBUILD is set by the build
# backend of the Python package: a wheel has everything inside of the package, LLVM
# too, so that it does not depend on the LLVM of the machine that built it.
if(SKBUILD)
  set(TAI_PORTABLE ON)
  set(TAI_TESTS OFF)
  set(CMAKE_INSTALL_LIBDIR tai/lib)
  set(CMAKE_INSTALL_BINDIR tai/bin)
  set(TAI_PACKAGE_DESTINATION tai)
  set(TAI_LICENSE_DESTINATION tai/licenses)
  set(TAI_MODULE_RPATH "$ORIGIN/lib")
  set(CMAKE_INSTALL_RPATH "$ORIGIN/../lib")
endif()
include(GNUInstallDirs)
if(NOT SKBUILD)
  set(TAI_PACKAGE_DESTINATION python/tai)
  set(TAI_LICENSE_DESTINATION licenses)
  set(TAI_MODULE_RPATH "$ORIGIN/../../${CMAKE_INSTALL_LIBDIR}")
  set(CMAKE_INSTALL_RPATH "$ORIGIN/../${CMAKE_INSTALL_LIBDIR}")
endif()

# The commit, for `ti.info`. It is asked for at each installation, since a build
# folder outlives commits; without git, the file COMMIT of a source distribution
# or the environment variable TAI_COMMIT says it.
install(CODE "
  set(commit \"\$ENV{TAI_COMMIT}\")
  if(NOT commit AND EXISTS \"${PROJECT_SOURCE_DIR}/COMMIT\")
    file(STRINGS \"${PROJECT_SOURCE_DIR}/COMMIT\" commit LIMIT_COUNT 1)
  elseif(NOT commit AND EXISTS \"${PROJECT_SOURCE_DIR}/.git\")
    execute_process(COMMAND git describe --always --dirty --abbrev=12 --exclude=*
      WORKING_DIRECTORY \"${PROJECT_SOURCE_DIR}\" OUTPUT_VARIABLE commit
      OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
  endif()
  if(NOT commit)
    set(commit unknown)
  endif()
  set(to \"\$ENV{DESTDIR}\${CMAKE_INSTALL_PREFIX}/${TAI_PACKAGE_DESTINATION}/build.json\")
  file(WRITE \"\${to}\" \"{\\\"commit\\\": \\\"\${commit}\\\"}\\n\")
" COMPONENT python)
