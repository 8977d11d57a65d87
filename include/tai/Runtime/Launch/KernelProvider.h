//===- KernelProvider.h - The interface to a compiler -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The interface through which the runtime gets code. A kernel calls its
// provider when something is first needed, with the kernel's lock held, and
// caches the result; failures are not cached, and the next launch calls again.
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
struct AdjointAccesses;
struct CheckedKernel;
struct KernelFlows;

/// Selects a variant of an adjoint kernel.
struct AdjointVariant {
  /// True if the adjoint also zeroes the adjoints of the elements that the
  /// kernel stores.
  bool zeroes = false;
  /// True if the adjoint loads outputs that the kernel has stored, instead of
  /// recomputing them.
  bool readsStored = false;
};

class KernelProvider {
public:
  virtual ~KernelProvider();

  /// Compiles the function that a launch of `kernel` calls. May call
  /// Kernel::setTrees and the other setters. The default implementation fails.
  virtual Status compile(Kernel &kernel, TaiKernelFn &function);

  /// Makes a variant of the kernel's adjoint. Succeeds with a null `adjoint` if
  /// there is nothing to differentiate, or no variant with stored outputs. The
  /// default implementation fails or, for stored outputs, yields null.
  virtual Status makeAdjoint(Kernel &kernel, AdjointVariant variant,
                             KernelPtr &adjoint);
  /// True if makeAdjoint can make variants that zero the adjoints of stored
  /// elements.
  virtual bool makesZeroingAdjoints() const { return false; }
  /// Plans the adjoint of a kernel; called when the kernel is first recorded.
  /// By default, the adjoint is assumed to read all memory that the kernel
  /// accesses.
  virtual Status planAdjoint(Kernel &kernel, AdjointAccesses &plan);
  /// Finds the data flow of floats through the kernel, from reads to stores.
  virtual KernelFlows findFlows(const Kernel &kernel);

  /// Makes the variant of the kernel that checks the access rules at run time.
  /// `checked` has no fields if there is nothing to check.
  virtual Status makeChecked(CheckedKernel &checked);
  /// Makes the variant of the kernel for forward mode; null if the kernel has
  /// no tangents.
  virtual Status makeTangent(KernelPtr &tangent);

  /// Makes the error message for device code that a device rejected for the
  /// given reason.
  virtual std::string explainRefusal(const std::string &reason) {
    return reason;
  }
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_KERNELPROVIDER_H
