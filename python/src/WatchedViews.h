//===- WatchedViews.h - Fields that other libraries may write ---*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A library that has a view of a field by DLPack may write to it between two
// recorded launches, which the tape does not see. While a thread records, the
// memory of such fields is compared between launches: a few pieces of it, or
// all of it under validation.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_PYTHON_WATCHEDVIEWS_H
#define TAI_PYTHON_WATCHEDVIEWS_H

#include "Core.h"

namespace taipy {

enum class Changed { No, Yes, /* A Python exception has been raised. */ Error };
/// The number of threads that watch views; changed with Python's lock held.
extern int watchingViews;
/// Finds out whether the memory of a view differs from its contents after the
/// last recorded launch, and Python has not written to a field since.
Changed compareViews();
inline Changed haveViewsChanged() {
  return __builtin_expect(watchingViews == 0, true) ? Changed::No
                                                    : compareViews();
}
/// To be called after a recorded launch. False if an exception has been raised.
bool digestViews();
inline bool renewViews() {
  return __builtin_expect(watchingViews == 0, true) || digestViews();
}

void bindWatchedViews(py::module_ &module);

} // namespace taipy

#endif // TAI_PYTHON_WATCHEDVIEWS_H
