//===- TextLimits.h - Text that MLIR's parser cannot read -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// MLIR's parser descends by recursion and has no limit: nested text ends the
// process. So text that comes from elsewhere is looked at first.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TEXTLIMITS_H
#define TAI_DIALECT_TAI_IR_TEXTLIMITS_H

#include "mlir/Support/LLVM.h"
#include <optional>
#include <string>

namespace mlir::tai {

/// The most brackets, and minus signs in a row, that may be open at once. The
/// parser needs up to 4 KB of the stack for each.
inline constexpr unsigned kMostNested = 512;

struct TextProblem {
  /// The byte at which the text is refused.
  size_t at;
  std::string message;
  /// From 1.
  unsigned line, column;
};

/// Where the text of a module, an attribute or a type asks for what MLIR's
/// parser dies of or does not finish. Strings and comments are passed over;
/// brackets of all kinds count, and those of the aliases that are used. MLIR's
/// bytecode is no text, but holds affine maps as text: looks at these.
std::optional<TextProblem> findTextProblem(StringRef text);
/// Reports a type of more dimensions than text may have.
LogicalResult checkDimensions(Operation *module);

/// For tools that leave the reading of files to MLIR: looks at the files among
/// the arguments, and at the standard input if it is read instead, which can
/// be read again afterwards. Returns false after a message.
bool checkToolInput(int argc, char **argv);

} // namespace mlir::tai

#endif // TAI_DIALECT_TAI_IR_TEXTLIMITS_H
