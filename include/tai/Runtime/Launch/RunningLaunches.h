//===- RunningLaunches.h - Running launches of all threads ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A tree that a running kernel uses cannot be freed, and a tape cannot hold a
// field that a running kernel of another thread changes. A launch pays little
// for this: it stores which kernel it runs; the thread that frees a tree or
// holds a field looks at all launches.
//
// A fence is needed between that store and the following loads of a launch. A
// launch is too short for a fence, so the other thread executes it for all
// processors (membarrier): it changes the state of the runtime, then calls
// `publishState`, then looks at the launches. A launch that it does not find
// sees the new state, and checks the storage and the holds again.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_RUNNINGLAUNCHES_H
#define TAI_RUNTIME_LAUNCH_RUNNINGLAUNCHES_H

#include "tai/Runtime/Host/OtherLaunches.h"
#include <vector>

namespace mlir::tai::runtime {

class ForkGuard;
class Kernel;
class TreeStore;
struct Launch;

class RunningLaunches final : public OtherLaunches {
public:
  RunningLaunches();
  ~RunningLaunches() override;

  /// Registers a launch object that the calling thread has made, and will use
  /// first.
  void add(Launch &launch);
  /// Removes all launch objects from the registry.
  void clear();
  /// Drops the launches of threads that do not exist in a forked child. Must be
  /// called before a thread takes a launch object that another thread may have
  /// used.
  void noteFork() {
    if (__builtin_expect(!isSameProcess(), false))
      forgetParents();
  }
  /// Calls `visit` for each running launch. The kernel of the launch is kept
  /// alive for that time.
  void visit(const std::function<void(const Launch &, const Kernel &)> &visit);
  /// Waits until no other thread visits a kernel. Must be called before a
  /// kernel that has been launched is destroyed.
  void waitForVisits() const { std::lock_guard<std::mutex> lock(mutex); }
  /// Fails if a running kernel uses the tree. The caller ensures that no launch
  /// begins to use the tree from now on.
  Status checkUnused(const Tree &tree, const TreeStore &store);

  bool areAny() const override;
  void publishState() const override;
  void visitChanges(
      const std::function<void(const std::string &kernel, const Field &field,
                               HoldKind kind)> &visit) override;

private:
  bool isSameProcess() const;
  void forgetParents();

  mutable std::mutex mutex;
  std::vector<Launch *> launches;
  /// The number of launch objects, and the thread that made the first of them.
  std::atomic<size_t> count{0};
  std::atomic<const void *> first{nullptr};
  std::unique_ptr<ForkGuard> guard;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_RUNNINGLAUNCHES_H
