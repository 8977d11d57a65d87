//===- OutputFilter.h - Messages beside those of the server -----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The server of MLIR writes to the standard output. A thread passes on its
// messages, so that answers of this program come between them, not within one.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TOOLS_TAI_LSP_SERVER_OUTPUTFILTER_H
#define TAI_TOOLS_TAI_LSP_SERVER_OUTPUTFILTER_H

#include "llvm/Support/JSON.h"

namespace mlir::tai {

/// Replaces the standard output by a pipe to a thread. `isPretty`: messages are
/// indented, as in tests.
void filterStandardOutput(bool isPretty);

/// Notes that the server has got a request, which it answers.
void noteRequest();

/// Writes an answer to the standard output, after those of the server to the
/// requests before.
void writeAnswer(llvm::json::Value answer);

/// Writes the rest of the pipe.
void finishStandardOutput();

} // namespace mlir::tai

#endif // TAI_TOOLS_TAI_LSP_SERVER_OUTPUTFILTER_H
