//===- SkipScope.h - Counters of skips in passes ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Passes count skipped work (see Skips.h) on the thread that runs them; the
// caller of the pass pipeline collects the sums. The IR is not involved.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_SKIPSCOPE_H
#define TAI_ANALYSIS_SKIPSCOPE_H

#include "tai/Support/Skips.h"

namespace mlir::tai {

/// Collects counts of this thread during its lifetime. Enclosing scopes do not
/// receive these counts, so that failed attempts can be discarded.
class SkipScope {
public:
  SkipScope();
  ~SkipScope();
  SkipScope(const SkipScope &) = delete;
  SkipScope &operator=(const SkipScope &) = delete;

  const SkipAmounts &getAmounts() const { return amounts; }

  /// Adds `amount` to a counter of skipped work in the innermost SkipScope of
  /// this thread; does nothing without a scope.
  static void count(SkipCount counter, int64_t amount = 1);

private:
  SkipAmounts amounts{};
  SkipScope *outer;
};

} // namespace mlir::tai

#endif // TAI_ANALYSIS_SKIPSCOPE_H
