# What the presets asan and tsan need besides LLVM's own flags.
#
# asan instruments all of this project (LLVM_USE_SANITIZER, LLVM_UBSAN_FLAGS).
# tsan (TAI_SANITIZE=thread) instruments the runtime and what starts threads in
# it, but not the libraries of passes: those run on LLVM's threads, whose
# atomics it cannot see, since the package's libraries are not instrumented.
set(TAI_SANITIZE "" CACHE STRING "Sanitizer of the runtime alone: thread or address")

if(TAI_SANITIZE STREQUAL "thread")
  set(flags -fsanitize=thread)
  set(name tsan)
elseif(TAI_SANITIZE STREQUAL "address")
  set(flags -fsanitize=address,undefined -fno-sanitize=vptr,function -fno-sanitize-recover=all)
  set(name asan)
elseif(LLVM_USE_SANITIZER)
  set(flags)
  set(name asan)
endif()
set(TAI_SANITIZE_FLAGS ${flags} -gline-tables-only -fno-omit-frame-pointer)

# tai_sanitize(<target>): what TAI_SANITIZE is about.
function(tai_sanitize target)
  if(TAI_SANITIZE)
    target_compile_options(${target} PRIVATE $<$<COMPILE_LANGUAGE:C,CXX>:${TAI_SANITIZE_FLAGS}>)
  endif()
endfunction()

if(NOT name)
  return()
endif()

# One shared run time for the tools and for the Python module: an interpreter
# that was built without it loads it before all else (LD_PRELOAD).
execute_process(
  COMMAND "${CMAKE_CXX_COMPILER}" "-print-file-name=libclang_rt.${name}-${CMAKE_SYSTEM_PROCESSOR}.so"
  OUTPUT_VARIABLE TAI_SANITIZER_RUNTIME OUTPUT_STRIP_TRAILING_WHITESPACE)
if(NOT IS_ABSOLUTE "${TAI_SANITIZER_RUNTIME}")
  message(FATAL_ERROR "${TAI_SANITIZER_RUNTIME} is missing: install libclang-rt-22-dev")
endif()
cmake_path(GET TAI_SANITIZER_RUNTIME PARENT_PATH folder)
list(JOIN flags " " flags)
foreach(kind EXE SHARED MODULE)
  string(APPEND CMAKE_${kind}_LINKER_FLAGS " ${flags} -shared-libsan -Wl,-rpath,${folder}")
endforeach()
