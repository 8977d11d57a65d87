# Script: writes a C++ source (OUTPUT) that defines the bytes of a file (INPUT)
# as `mlir::tai::NAME` and their number as `mlir::tai::NAMESize`.
file(READ "${INPUT}" bytes HEX)
string(LENGTH "${bytes}" size)
math(EXPR size "${size} / 2")
string(REGEX REPLACE "(................................)" "\\1\n" bytes "${bytes}")
string(REGEX REPLACE "([0-9a-f][0-9a-f])" "0x\\1," bytes "${bytes}")
file(WRITE "${OUTPUT}" "// Made by EmbedBytes.cmake.
namespace mlir::tai {
extern const unsigned char ${NAME}[];
extern const unsigned long ${NAME}Size;
alignas(16) const unsigned char ${NAME}[] = {
${bytes}};
const unsigned long ${NAME}Size = ${size};
} // namespace mlir::tai
")
