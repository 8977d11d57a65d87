//===- Completion.h - Completion of symbols ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The parser of MLIR completes ops, values, types and keywords. It does not
// complete symbols, which a document defines in any order, nor the names of
// places in a layout. Both are found in the text.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TOOLS_TAI_LSP_SERVER_COMPLETION_H
#define TAI_TOOLS_TAI_LSP_SERVER_COMPLETION_H

#include "llvm/ADT/StringRef.h"
#include "llvm/Support/JSON.h"

namespace mlir::tai {

/// Returns the completions at a position of `text`, as items of the protocol;
/// none if there is neither a symbol nor a place. `character` counts UTF-16
/// units, as the protocol does.
std::optional<llvm::json::Array>
completeSymbol(llvm::StringRef text, unsigned line, unsigned character);

} // namespace mlir::tai

#endif // TAI_TOOLS_TAI_LSP_SERVER_COMPLETION_H
