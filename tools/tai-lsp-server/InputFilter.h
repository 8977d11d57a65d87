//===- InputFilter.h - Keeps unreadable text from the server ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The server of MLIR reads the standard input and parses documents itself. A
// thread therefore reads the messages first, and cuts off a document where it
// nests deeper than the parser can follow: the server then reports an error
// there. It also answers requests for the completion of symbols.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TOOLS_TAI_LSP_SERVER_INPUTFILTER_H
#define TAI_TOOLS_TAI_LSP_SERVER_INPUTFILTER_H

namespace mlir::tai {

/// Replaces the standard input by a pipe from this thread. `isDelimited`: lines
/// `// -----` separate the messages, as in tests, instead of headers.
void filterStandardInput(bool isDelimited);

} // namespace mlir::tai

#endif // TAI_TOOLS_TAI_LSP_SERVER_INPUTFILTER_H
