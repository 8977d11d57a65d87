//===- TapedKernel.h - Kernel internals for tapes ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_TAPEDKERNEL_H
#define TAI_RUNTIME_LAUNCH_TAPEDKERNEL_H

#include "tai/Runtime/Launch/Launch.h"

namespace mlir::tai::runtime {

/// Gives tapes access to private parts of kernels.
struct TapedKernel {
  static KernelInfo &info(Kernel &kernel) { return kernel.info; }
  static const KernelInfo &info(const Kernel &kernel) { return kernel.info; }
  static Status bind(Kernel &kernel, uint64_t epoch) {
    return kernel.bind(epoch);
  }
  static std::atomic<uint64_t> &lastLaunch(Kernel &kernel) {
    return kernel.prepared.lastLaunch;
  }
  /// True if a launch of the kernel only calls its function with trees and
  /// arguments, without sparse cells, results or adjoints of the caller.
  static bool isDirect(const Kernel &kernel) {
    return kernel.sparseNodes.empty() && kernel.loopLevels.empty() &&
           kernel.info.resultSlots == 0 &&
           kernel.info.callerAdjoints.slots == 0;
  }
  static int32_t call(Kernel &kernel, Launch &launch) {
    launch.trees = kernel.bases.data();
    launch.loopTimes = &kernel.loopTimes;
    return kernel.function.load(std::memory_order_relaxed)(&launch);
  }
  /// The data that the tape with this stamp has stored by setKnown; null if
  /// another tape was the last to call setKnown.
  static const void *knownTo(const Kernel &kernel, uint64_t stamp) {
    return kernel.tapeStamp == stamp ? kernel.tapeUses : nullptr;
  }
  static void setKnown(Kernel &kernel, uint64_t stamp, const void *uses) {
    kernel.tapeUses = uses;
    kernel.tapeStamp = stamp;
  }

  /// targets: fields whose adjoints the kernel's adjoint adds to. sources:
  /// fields whose adjoints it reads. overwritten: the sources that the kernel
  /// overwrites. changedAdjoints: adjoints that a launch of the kernel may
  /// change.
  static const std::vector<Field *> &targets(const Kernel &kernel) {
    return kernel.adjointTargets;
  }
  static const std::vector<Field *> &sources(const Kernel &kernel) {
    return kernel.adjointSources;
  }
  static const std::vector<Field *> &overwritten(const Kernel &kernel) {
    return kernel.overwritten;
  }
  static const std::vector<Field *> &changedAdjoints(const Kernel &kernel) {
    return kernel.changedAdjoints;
  }
  static const std::vector<SparseNode *> &sparseNodes(const Kernel &kernel) {
    return kernel.sparseNodes;
  }
  static const AdjointAccesses &adjointPlan(const Kernel &kernel) {
    return *kernel.adjointPlan;
  }
  static bool adjointReexecutes(const Kernel &kernel) {
    return kernel.adjointPlan && kernel.adjointPlan->reexecutes;
  }
  static bool loadsStored(const Kernel &kernel) {
    return kernel.adjointPlan && kernel.adjointPlan->stored;
  }
  /// True if the adjoint always zeroes the adjoints of the elements that the
  /// kernel overwrites.
  static bool alwaysZeroes(const Kernel &kernel) {
    return kernel.adjointPlan && kernel.adjointPlan->zeroes;
  }

  /// known: the variant of the adjoint that has been resolved, or null.
  /// isAsked: whether the variant has been requested from the provider.
  static Kernel *known(const Kernel &kernel, bool zeroes, bool stored) {
    return form(kernel, zeroes, stored).known.load(std::memory_order_acquire);
  }
  static bool isAsked(const Kernel &kernel, bool zeroes, bool stored) {
    const Kernel::AdjointForm &found = form(kernel, zeroes, stored);
    return found.known.load(std::memory_order_relaxed) || found.asked;
  }

private:
  static const Kernel::AdjointForm &form(const Kernel &kernel, bool zeroes,
                                         bool stored) {
    return stored ? kernel.storedForms[zeroes] : kernel.adjointForms[zeroes];
  }
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_TAPEDKERNEL_H
