# CMake functions of this project.
#
# Each folder of lib/ is an OBJECT library; all of them together make one shared
# libtai, which the tools, the unit tests and the Python module link. The LLVM
# and MLIR libraries are linked in one place (tai_link_upstream), because naming
# an upstream CMake target such as MLIRIR anywhere else would add a second,
# static copy of what libMLIR.so holds.

# The upstream C API exists as static archives only; libtai carries those that
# the Python module calls.
set(TAI_UPSTREAM_CAPI IR)

# Archives are named by path: their CMake targets would bring static MLIR along.
set(TAI_UPSTREAM_CAPI_ARCHIVES)
foreach(part ${TAI_UPSTREAM_CAPI})
  list(APPEND TAI_UPSTREAM_CAPI_ARCHIVES "${LLVM_LIBRARY_DIR}/libMLIRCAPI${part}.a")
endforeach()

if(TAI_PORTABLE)
  include(TaiPortable)
endif()

# Links `target` with LLVM and MLIR, in the way that the build mode asks for.
function(tai_link_upstream target visibility)
  if(TAI_PORTABLE)
    target_link_libraries(${target} ${visibility} ${TAI_PORTABLE_LINK})
  else()
    target_link_libraries(${target} ${visibility} MLIR LLVM)
  endif()
endfunction()

# tai_compile_options(<target> [EXCEPTIONS])
#   Flags for every target that sees LLVM's headers. EXCEPTIONS: the target is
#   unwound when memory runs out.
function(tai_compile_options target)
  set(flag -fno-exceptions)
  if("EXCEPTIONS" IN_LIST ARGN)
    set(flag -fexceptions)
  endif()
  target_compile_options(${target} PRIVATE $<$<COMPILE_LANGUAGE:CXX>:${flag}>)
endfunction()

# tai_tablegen(<target> <file.td> OUTPUTS <out.inc> <generator args> [AND ...])
#   Runs mlir-tblgen on a file of the current folder, once for each output; the
#   outputs become part of the target tai-headers. A missing file is skipped.
function(tai_tablegen target file)
  file(GLOB found CONFIGURE_DEPENDS "${CMAKE_CURRENT_SOURCE_DIR}/${file}")
  if(NOT found)
    return()
  endif()
  set(LLVM_TARGET_DEFINITIONS ${file})
  cmake_parse_arguments(PARSE_ARGV 2 ARG "" "" "OUTPUTS")
  set(step)
  foreach(word IN LISTS ARG_OUTPUTS ITEMS AND)
    if(word STREQUAL "AND")
      mlir_tablegen(${step})
      set(step)
    else()
      list(APPEND step ${word})
    endif()
  endforeach()
  add_public_tablegen_target(${target})
  add_dependencies(tai-headers ${target})
endfunction()

# tai_pass_tablegen(<Name>)
#   Passes.td of the current folder to Passes.h.inc, with the registration
#   function register<Name>Passes(), and to reference documentation.
function(tai_pass_tablegen name)
  tai_tablegen(${name}PassIncGen Passes.td
    OUTPUTS Passes.h.inc -gen-pass-decls -name ${name})
  if(EXISTS "${CMAKE_CURRENT_SOURCE_DIR}/Passes.td")
    tai_doc(Passes ${name}Passes reference/ -gen-pass-doc)
  endif()
endfunction()

# tai_doc(<file without .td> <name> <folder below docs/> <generator args>)
function(tai_doc file name folder)
  add_mlir_doc(${file} ${name} ${folder} ${ARGN})
endfunction()

# The upstream headers that most files need, compiled once for all targets that
# see MLIR: a small pass compiles in 0.6 s instead of 5 s. Sources still include
# what they use; a build with TAI_PCH=OFF must pass.
if(TAI_PCH)
  set(headers
    <mlir/Dialect/Arith/IR/Arith.h>
    <mlir/Dialect/Func/IR/FuncOps.h>
    <mlir/Dialect/LLVMIR/LLVMDialect.h>
    <mlir/Dialect/Math/IR/Math.h>
    <mlir/Dialect/MemRef/IR/MemRef.h>
    <mlir/Dialect/SCF/IR/SCF.h>
    <mlir/Dialect/Vector/IR/VectorOps.h>
    <mlir/IR/Builders.h>
    <mlir/IR/BuiltinOps.h>
    <mlir/IR/DialectImplementation.h>
    <mlir/IR/IRMapping.h>
    <mlir/IR/OpImplementation.h>
    <mlir/IR/PatternMatch.h>
    <mlir/Pass/PassManager.h>
    <mlir/Transforms/DialectConversion.h>
    <mlir/Transforms/GreedyPatternRewriteDriver.h>
    <llvm/ADT/TypeSwitch.h>)
  file(CONFIGURE OUTPUT "${PROJECT_BINARY_DIR}/pch/pch.cpp"
    CONTENT "// Carries the precompiled header.\n")
  # A precompiled header holds absolute paths. So it is never taken from ccache,
  # and ccache identifies it by a checksum of what it means, not by its bytes:
  # objects are then shared between checkouts.
  string(SHA256 checksum "${headers} ${LLVM_PACKAGE_VERSION} ${CMAKE_CXX_COMPILER_VERSION}")
  # tai_add_precompiled(<Name> [EXCEPTIONS] [SANITIZED]): one for each set of
  # flags.
  function(tai_add_precompiled name)
    add_library(${name} OBJECT "${PROJECT_BINARY_DIR}/pch/pch.cpp")
    tai_compile_options(${name} ${ARGN})
    if("SANITIZED" IN_LIST ARGN)
      tai_sanitize(${name})
    endif()
    target_precompile_headers(${name} PRIVATE ${headers})
    set_target_properties(${name} PROPERTIES CXX_COMPILER_LAUNCHER "")
    list(JOIN ARGN " " kinds)
    string(STRIP "${checksum} ${kinds}" sum)
    file(CONFIGURE OUTPUT "${PROJECT_BINARY_DIR}/CMakeFiles/${name}.dir/cmake_pch.hxx.pch.sum"
      CONTENT "${sum}\n")
  endfunction()
  tai_add_precompiled(TaiPCH)
  set(sanitized)
  if(TAI_SANITIZE)
    set(sanitized SANITIZED)
    tai_add_precompiled(TaiSanitizedPCH SANITIZED)
  endif()
  # For the libraries with EXCEPTIONS, all of which are of several threads.
  tai_add_precompiled(TaiExceptionsPCH EXCEPTIONS ${sanitized})
endif()

# tai_precompile(<target> [THREADS] [EXCEPTIONS])
#   Not by REUSE_FROM, which names the header by an absolute path that ccache
#   does not see through. THREADS: for a target of tai_sanitize. EXCEPTIONS: as
#   with tai_compile_options.
function(tai_precompile target)
  if(TAI_PCH)
    set(header TaiPCH)
    if(TAI_SANITIZE AND "THREADS" IN_LIST ARGN)
      set(header TaiSanitizedPCH)
    endif()
    if("EXCEPTIONS" IN_LIST ARGN)
      set(header TaiExceptionsPCH)
    endif()
    set(pch CMakeFiles/${header}.dir/cmake_pch.hxx.pch)
    target_compile_options(${target} PRIVATE $<$<COMPILE_LANGUAGE:CXX>:SHELL:-include-pch ${pch}>)
    get_target_property(sources ${target} SOURCES)
    list(FILTER sources EXCLUDE REGEX "TARGET_OBJECTS")
    set_property(SOURCE ${sources} APPEND PROPERTY OBJECT_DEPENDS "${PROJECT_BINARY_DIR}/${pch}")
    add_dependencies(${target} ${header})
  endif()
endfunction()

# add_tai_library(<Name> [sources] [PLUGIN] [NO_MLIR] [THREADS] [EXCEPTIONS]
#                 [LINK_LIBS libs] [DEPENDS targets])
#   An OBJECT library that becomes part of libtai. Without sources it takes the
#   *.cpp below the current folder, so that adding a file needs no edit here; a
#   folder without any is skipped.
#   PLUGIN   part of TaiPlugin.so too: may use nothing but LLVM and MLIR
#   NO_MLIR  sees neither the generated headers nor the precompiled header
#   THREADS  what several threads use at a time: what TAI_SANITIZE is about
#   EXCEPTIONS  unwound when memory runs out (decision 0055); needs THREADS
#   LINK_LIBS  libraries other than LLVM and MLIR; libtai links them
function(add_tai_library name)
  cmake_parse_arguments(ARG "PLUGIN;NO_MLIR;THREADS;EXCEPTIONS" "" "LINK_LIBS;DEPENDS" ${ARGN})
  set(sources ${ARG_UNPARSED_ARGUMENTS})
  if(NOT sources)
    file(GLOB_RECURSE sources CONFIGURE_DEPENDS "${CMAKE_CURRENT_SOURCE_DIR}/*.cpp")
  endif()
  if(NOT sources)
    return()
  endif()
  add_library(${name} OBJECT ${sources})
  tai_cover(${sources})
  set(kinds)
  if(ARG_EXCEPTIONS)
    set(kinds EXCEPTIONS)
  endif()
  tai_compile_options(${name} ${kinds})
  if(ARG_THREADS)
    list(APPEND kinds THREADS)
    tai_sanitize(${name})
  endif()
  if(NOT ARG_NO_MLIR)
    tai_precompile(${name} ${kinds})
    add_dependencies(${name} tai-headers)
  endif()
  if(ARG_DEPENDS)
    add_dependencies(${name} ${ARG_DEPENDS})
  endif()
  target_link_libraries(${name} PRIVATE ${ARG_LINK_LIBS})
  set_property(GLOBAL APPEND PROPERTY TAI_LIBRARIES ${name})
  set_property(GLOBAL APPEND PROPERTY TAI_LINK_LIBS ${ARG_LINK_LIBS})
  if(ARG_PLUGIN)
    set_property(GLOBAL APPEND PROPERTY TAI_PLUGIN_LIBRARIES ${name})
  endif()
endfunction()

# The objects of the libraries in the global property `property`.
function(tai_objects property result)
  get_property(libraries GLOBAL PROPERTY ${property})
  list(TRANSFORM libraries REPLACE "(.+)" "$<TARGET_OBJECTS:\\1>")
  set(${result} "${libraries}" PARENT_SCOPE)
endfunction()

# tai_hide_upstream(<target>): of the symbols, those of tai and of MLIR's C API stay
# visible. The others are copies of templates of LLVM and of the C++ library.
function(tai_hide_upstream target)
  # The run times of sanitizers and of coverage look for symbols of their own.
  if(LLVM_USE_SANITIZER OR TAI_SANITIZE OR TAI_COVERAGE)
    return()
  endif()
  set(script "${PROJECT_SOURCE_DIR}/cmake/libtai.exports")
  target_link_options(${target} PRIVATE
    "-Wl,--version-script=${script}" -Wl,--undefined-version)
  set_property(TARGET ${target} APPEND PROPERTY LINK_DEPENDS "${script}")
endfunction()

# add_tai_shared_library(): libtai, from every add_tai_library() before it.
function(add_tai_shared_library)
  tai_objects(TAI_LIBRARIES objects)
  if(NOT objects)
    return()
  endif()
  if(TAI_SANITIZE)
    # Of an inline function that many objects hold, the linker takes the first:
    # it shall be one that is instrumented.
    list(REVERSE objects)
  endif()
  add_library(tai SHARED ${objects})
  # Minor versions may break the ABI: test/CAPI/abi lists what a version promises.
  set_target_properties(tai PROPERTIES LINKER_LANGUAGE CXX
    SOVERSION "${PROJECT_VERSION_MAJOR}.${PROJECT_VERSION_MINOR}")
  set(namelink)
  if(SKBUILD)
    # A wheel holds no links.
    set(namelink NAMELINK_SKIP)
  else()
    set_target_properties(tai PROPERTIES VERSION "${PROJECT_VERSION}")
  endif()
  get_property(libs GLOBAL PROPERTY TAI_LINK_LIBS)
  list(REMOVE_DUPLICATES libs)
  target_link_libraries(tai PRIVATE
    -Wl,--whole-archive ${TAI_UPSTREAM_CAPI_ARCHIVES} -Wl,--no-whole-archive ${libs})
  if(TAI_PORTABLE)
    tai_link_upstream(tai PRIVATE)
  else()
    tai_link_upstream(tai PUBLIC)
    tai_hide_upstream(tai)
  endif()
  install(TARGETS tai EXPORT TaiTargets
    LIBRARY COMPONENT library NAMELINK_COMPONENT headers ${namelink})
endfunction()

# add_tai_tool(<name> [sources] [LINK_LIBS libs] [DEPENDS targets])
#   An executable in bin/ that links libtai and the objects of tools/common;
#   *.cpp of the folder by default.
function(add_tai_tool name)
  cmake_parse_arguments(ARG "" "" "LINK_LIBS;DEPENDS" ${ARGN})
  set(sources ${ARG_UNPARSED_ARGUMENTS})
  if(NOT sources)
    file(GLOB sources CONFIGURE_DEPENDS "${CMAKE_CURRENT_SOURCE_DIR}/*.cpp")
  endif()
  if(NOT sources OR NOT TARGET tai)
    return()
  endif()
  add_library(${name}-objects OBJECT ${sources})
  tai_compile_options(${name}-objects)
  tai_precompile(${name}-objects)
  add_dependencies(${name}-objects tai-headers ${ARG_DEPENDS})
  target_link_libraries(${name}-objects PRIVATE TaiToolsCommon ${ARG_LINK_LIBS})
  add_executable(${name} $<TARGET_OBJECTS:${name}-objects>)
  set_target_properties(${name} PROPERTIES LINKER_LANGUAGE CXX)
  target_link_libraries(${name} PRIVATE tai TaiToolsCommon ${ARG_LINK_LIBS})
  install(TARGETS ${name} RUNTIME COMPONENT tools)
  set_property(GLOBAL APPEND PROPERTY TAI_TOOLS ${name})
endfunction()

# add_tai_unittest(<name> [sources] [LINK_LIBS libs])
#   One GoogleTest program, of *.cpp below the current folder by default.
function(add_tai_unittest name)
  cmake_parse_arguments(ARG "" "" "LINK_LIBS" ${ARGN})
  set(sources ${ARG_UNPARSED_ARGUMENTS})
  if(NOT sources)
    file(GLOB_RECURSE sources CONFIGURE_DEPENDS "${CMAKE_CURRENT_SOURCE_DIR}/*.cpp")
  endif()
  if(NOT sources OR NOT TARGET tai)
    return()
  endif()
  add_executable(${name} ${sources})
  tai_compile_options(${name})
  tai_sanitize(${name})
  tai_precompile(${name} THREADS)
  add_dependencies(${name} tai-headers)
  target_link_libraries(${name} PRIVATE tai GTest::gtest GTest::gtest_main ${ARG_LINK_LIBS})
endfunction()
