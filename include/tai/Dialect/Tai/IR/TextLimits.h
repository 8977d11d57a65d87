//===- TextLimits.h - Text that MLIR's parser cannot read -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// MLIR's parser recurses without a limit: deeply nested text overflows the
// stack and ends the process. So text from outside the process is checked
// first.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TEXTLIMITS_H
#define TAI_DIALECT_TAI_IR_TEXTLIMITS_H

#include "mlir/Support/LLVM.h"
#include <optional>
#include <string>

namespace mlir::tai {

/// The greatest depth to which brackets and consecutive minus signs nest. The
/// parser needs up to 4 KB of the stack for each level.
inline constexpr unsigned kMostNested = 512;

struct TextProblem {
  /// The position of the byte at which the text is refused.
  size_t at;
  std::string message;
  /// From 1.
  unsigned line, column;
};

/// Finds text of a module, an attribute or a type that would crash MLIR's
/// parser or keep it busy without end. Skips strings and comments. Brackets of
/// all kinds count, including brackets in aliases that the text uses. In MLIR's
/// bytecode, which holds affine maps as text, only the maps are checked.
std::optional<TextProblem> findTextProblem(StringRef text);
/// Emits an error and fails if a type in `module` has too many dimensions.
LogicalResult checkDimensions(Operation *module);

/// For tools that leave the reading of files to MLIR: checks the files named in
/// the arguments, or the standard input if the tool reads that instead. The
/// standard input can be read again afterwards. Returns false after printing a
/// message.
bool checkToolInput(int argc, char **argv);

} // namespace mlir::tai

#endif // TAI_DIALECT_TAI_IR_TEXTLIMITS_H
