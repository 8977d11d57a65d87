//===- Section.h - Work that handlers must not enter again ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A mutex for work that passes safepoints, such as a copy that waits for a
// device. At a safepoint, the host's handler may call the library on the thread
// that holds the mutex: with a plain mutex, the thread would wait for itself;
// with a recursive mutex, the call would find the work half done.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_THREADS_SECTION_H
#define TAI_RUNTIME_THREADS_SECTION_H

#include "tai/Runtime/Threads/Safepoint.h"
#include "tai/Support/Status.h"
#include <algorithm>
#include <mutex>

namespace mlir::tai::runtime {

/// The failure of a call made by a handler that has interrupted work, where the
/// call needs this work to be complete.
Status failAsInterruptedWork();

/// The failure of work that the host has interrupted.
inline Status failAsInterrupted() {
  return Status::failure(StatusCode::Interrupted, "interrupted");
}

namespace safepoint {
/// Calls work(first, count) for pieces of [0, count), with safepoints in
/// between if there are several. Fails if a piece fails, or if the host
/// interrupts the work and `canStop`.
template <typename Work>
Status runInPieces(int64_t count, int64_t piece, bool canStop,
                   const Work &work) {
  Watch watch;
  // Passes a first safepoint if there are several pieces, because the clock of
  // safepoints possibly stands still, and a safepoint starts it.
  bool goesOn = count < 2 * piece || look();
  for (int64_t first = 0; first < count; first += piece) {
    if (first > 0 && goesOn)
      goesOn = watch.look();
    if (!goesOn && canStop)
      return failAsInterrupted();
    Status status = work(first, std::min(piece, count - first));
    if (!status)
      return status;
  }
  return Status::success();
}
} // namespace safepoint

class Section {
public:
  /// Locks the section for its lifetime. A call that is a part of the locked
  /// work can lock the section again.
  class Entry {
  public:
    explicit Entry(Section &section)
        : section(section), guard(section.mutex), outerDepth(section.depth),
          again(section.entries > 0 &&
                section.depth < safepoint::handlerDepth()) {
      ++section.entries;
      section.depth = safepoint::handlerDepth();
    }
    ~Entry() {
      --section.entries;
      section.depth = outerDepth;
    }
    Entry(const Entry &) = delete;
    Entry &operator=(const Entry &) = delete;

    /// True if a handler, which was called at a safepoint within work of this
    /// section, runs on this thread and locks the section again.
    bool isAgain() const { return again; }
    /// Fails if isAgain().
    Status check() const {
      return again ? failAsInterruptedWork() : Status::success();
    }

  private:
    Section &section;
    safepoint::Guard<std::recursive_timed_mutex> guard;
    unsigned outerDepth;
    bool again;
  };

private:
  std::recursive_timed_mutex mutex;
  /// Both are guarded by the mutex of the section. entries: the number of Entry
  /// objects that exist. depth: the number of handlers around the one that was
  /// made last.
  unsigned entries = 0, depth = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_THREADS_SECTION_H
