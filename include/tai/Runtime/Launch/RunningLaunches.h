//===- RunningLaunches.h - Which kernels run in which thread ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A tree that a running kernel uses cannot be freed, and a tape cannot use what
// a kernel changes that another thread has launched before. Neither is for the
// launch to find out, which began first: a launch stores which kernel it runs,
// and whoever wants to know looks at all launches.
//
// Between that store and the loads that a launch does next there has to be a
// fence. A launch is too short for one, so the other side makes the processors
// execute it: whoever changes the state of the runtime calls `letThemSee`
// before it looks. Then a launch that it does not find sees the new state, and
// looks at the storage and at the holds again.
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

  /// A launch that the calling thread has made, and will use first.
  void add(Launch &launch);
  /// None is there any more.
  void clear();
  /// To be called before a thread takes a launch that another one may have had:
  /// a forked child has none of the threads whose launches ran.
  void noteFork() {
    if (__builtin_expect(!isSameProcess(), false))
      forgetParents();
  }
  /// Calls `visit` for each launch whose code runs. The kernel stays for so
  /// long.
  void visit(const std::function<void(const Launch &, const Kernel &)> &visit);
  /// To be called before a kernel goes that has been launched: returns when no
  /// other thread visits it.
  void waitForVisits() const { std::lock_guard<std::mutex> lock(mutex); }
  /// Fails where a running kernel uses the tree, which no launch begins to use
  /// from now on.
  Status checkUnused(const Tree &tree, const TreeStore &store);

  bool areThere() const override;
  void letThemSee() const override;
  void visitChanges(
      const std::function<void(const std::string &kernel, const Field &field,
                               HoldKind kind)> &visit) override;

private:
  bool isSameProcess() const;
  void forgetParents();

  mutable std::mutex mutex;
  std::vector<Launch *> launches;
  /// How many there are, and the thread that has made the first one.
  std::atomic<size_t> count{0};
  std::atomic<const void *> first{nullptr};
  std::unique_ptr<ForkGuard> guard;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_RUNNINGLAUNCHES_H
