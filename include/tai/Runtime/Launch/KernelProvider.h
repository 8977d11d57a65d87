//===- KernelProvider.h - What the runtime needs of a compiler --*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The one interface through which the runtime asks for code. A kernel asks its
// provider when something is first needed, holds the lock of the kernel while
// it does, and keeps the answer; a failure is not kept, and the next launch
// asks again.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_KERNELPROVIDER_H
#define TAI_RUNTIME_LAUNCH_KERNELPROVIDER_H

#include "tai/ABI/Abi.h"
#include "tai/Support/Status.h"
#include <memory>
#include <string>

namespace mlir::tai::runtime {

class Kernel;
using KernelPtr = std::shared_ptr<Kernel>;
struct AdjointPlan;
struct CheckedKernel;
struct KernelFlows;

/// Which code of an adjoint is meant.
struct AdjointVariant {
  /// It leaves zero in the adjoints of the elements that the kernel stores.
  bool zeroes = false;
  /// It loads what the kernel has stored.
  bool readsStored = false;
};

class KernelProvider {
public:
  virtual ~KernelProvider();

  /// The function that a launch calls. May call Kernel::setTrees and others
  /// that say what it is given. Without an override, there is none to make.
  virtual Status compile(Kernel &kernel, TaiKernelFn &function);

  /// The adjoint. A null kernel with success: there is nothing to
  /// differentiate, or no variant that loads what is stored. Without an
  /// override that is an error of the caller, or no such variant.
  virtual Status makeAdjoint(Kernel &kernel, AdjointVariant variant,
                             KernelPtr &adjoint);
  /// Whether there are adjoints that zero.
  virtual bool makesZeroingAdjoints() const { return false; }
  /// What the adjoint asks of memory; asked when the kernel is first recorded.
  /// Without an override, it may read all that the kernel touches.
  virtual Status planAdjoint(Kernel &kernel, AdjointPlan &plan);
  /// Which values depend on which.
  virtual KernelFlows findFlows(const Kernel &kernel);

  /// The form of the kernel that checks the access rules as it runs. It has no
  /// fields where there is nothing to check.
  virtual Status makeChecked(CheckedKernel &checked);
  /// What is launched in the place of the kernel in forward mode; null if it
  /// carries no tangents.
  virtual Status makeTangent(KernelPtr &tangent);

  /// What to tell the user where a device does not take the code, for the
  /// reason that the device gave.
  virtual std::string explainRefusal(const std::string &reason) {
    return reason;
  }
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_KERNELPROVIDER_H
