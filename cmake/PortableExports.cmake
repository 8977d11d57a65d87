# Script: writes, from the symbols of the tools' objects (OBJECTS), the version
# script of libtai (SCRIPT) and a linker script that makes the linker take what
# the tools alone use from the archives (ROOTS).
execute_process(COMMAND "${NM}" --format=just-symbols --undefined-only ${OBJECTS}
  OUTPUT_VARIABLE undefined COMMAND_ERROR_IS_FATAL ANY)
# Symbols that are in libtai too and must be one: inline variables, type ids.
execute_process(COMMAND "${NM}" --format=just-symbols --defined-only --extern-only ${OBJECTS}
  OUTPUT_VARIABLE defined COMMAND_ERROR_IS_FATAL ANY)
string(REGEX MATCHALL "(_Z|LLVM)[^\n:]+" undefined "${undefined}")
string(REGEX MATCHALL "(_Z|LLVM)[^\n:]+" defined "${defined}")
# The C++ library's own come from libstdc++.so.
list(FILTER undefined EXCLUDE REGEX "^_Z(N?K?St|T[VIS]N10__cxxabiv1|T[VIS]N?K?St|n[wa]|d[la])")
list(REMOVE_DUPLICATES undefined)
list(REMOVE_DUPLICATES defined)
list(REMOVE_ITEM undefined ${defined})
list(JOIN undefined ")\nEXTERN(" roots)
file(WRITE "${ROOTS}" "EXTERN(${roots})\n")
list(JOIN undefined ";\n    " exports)
list(JOIN defined ";\n    " shared)
file(WRITE "${SCRIPT}" "{
  global:
    mlir*;
    tai*;
    ${exports};
    ${shared};
  local: *;
};
")
