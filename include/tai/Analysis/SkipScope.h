//===- SkipScope.h - Counters of what passes leave out ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Passes count on the thread that runs them; whoever runs them takes the sums.
// Nothing of it is in the IR.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_SKIPSCOPE_H
#define TAI_ANALYSIS_SKIPSCOPE_H

#include "tai/Support/Skips.h"

namespace mlir::tai {

/// While it lives, takes what is counted on this thread. Those around it do not
/// hear of it, so that attempts that come to nothing can be left out.
class SkipScope {
public:
  SkipScope();
  ~SkipScope();
  SkipScope(const SkipScope &) = delete;
  SkipScope &operator=(const SkipScope &) = delete;

  const SkipAmounts &getAmounts() const { return amounts; }

  /// Counts for the innermost scope of this thread, if there is one.
  static void count(SkipCount counter, int64_t amount = 1);

private:
  SkipAmounts amounts{};
  SkipScope *outer;
};

} // namespace mlir::tai

#endif // TAI_ANALYSIS_SKIPSCOPE_H
