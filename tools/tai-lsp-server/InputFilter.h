//===- InputFilter.h - Keeps unreadable text from the server ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The server of MLIR reads the standard input and parses documents by itself.
// So a thread reads the messages before, and ends a document where it nests
// deeper than the parser can follow: the server reports an error there.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TOOLS_TAI_LSP_SERVER_INPUTFILTER_H
#define TAI_TOOLS_TAI_LSP_SERVER_INPUTFILTER_H

namespace mlir::tai {

/// Puts a pipe in the place of the standard input. `isDelimited`: lines
/// `// -----` stand between messages, as in tests, and no headers.
void filterStandardInput(bool isDelimited);

} // namespace mlir::tai

#endif // TAI_TOOLS_TAI_LSP_SERVER_INPUTFILTER_H
