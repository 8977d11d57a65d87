//===- RunInParallel.h - Compilations side by side --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_EXECUTIONENGINE_SESSION_RUNINPARALLEL_H
#define TAI_LIB_EXECUTIONENGINE_SESSION_RUNINPARALLEL_H

#include "tai/Runtime/Threads/Safepoint.h"
#include "tai/Support/Status.h"
#include "tai/Support/Thread.h"
#include "llvm/ADT/STLFunctionalExtras.h"
#include <algorithm>
#include <atomic>
#include <optional>
#include <thread>
#include <vector>

namespace mlir::tai {

/// Runs task(0) to task(count - 1), on up to as many threads as there are
/// cores, until one fails. Returns the number of the task that failed first:
/// later failures may be mere consequences of being stopped.
inline std::optional<size_t>
runInParallel(size_t count,
              llvm::function_ref<const runtime::Status &(size_t)> task) {
  std::atomic<size_t> next{0};
  std::atomic<bool> hasFailed{false};
  std::atomic<size_t> failed{count};
  auto work = [&] {
    for (size_t i = next++; i < count && !hasFailed; i = next++) {
      if (task(i).ok())
        continue;
      size_t none = count;
      failed.compare_exchange_strong(none, i);
      hasFailed = true;
    }
  };
  auto help = [&] {
    runtime::safepoint::follow(&hasFailed);
    work();
  };
  size_t helpers = std::min<size_t>(
      count, std::max(1u, std::thread::hardware_concurrency()));
  // There are fewer threads if the system cannot start more; destructors join
  // them.
  std::vector<runtime::Thread> threads(helpers ? helpers - 1 : 0);
  for (runtime::Thread &thread : threads)
    if (!thread.start(help, "tai-compile"))
      break;
  work();
  // The threads are joined before the flags that they read are destroyed.
  threads.clear();
  return failed < count ? std::optional(failed.load()) : std::nullopt;
}

} // namespace mlir::tai

#endif // TAI_LIB_EXECUTIONENGINE_SESSION_RUNINPARALLEL_H
