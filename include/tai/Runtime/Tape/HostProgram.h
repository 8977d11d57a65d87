//===- HostProgram.h - Functions that run on the host -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_TAPE_HOSTPROGRAM_H
#define TAI_RUNTIME_TAPE_HOSTPROGRAM_H

#include "tai/Runtime/Launch/Runtime.h"

namespace mlir::tai::runtime {

/// Callbacks and facts that a host program (a `func.func` run on the host)
/// needs.
struct HostModule {
  std::function<Kernel *(std::string_view name)> findKernel;
  /// True if the program itself loads or stores elements of fields, which must
  /// then be current on the host while the program runs.
  bool usesTrees = true;
};

/// Runs a host program, which may launch kernels and open tapes.
Status runHost(Runtime &runtime, TaiKernelFn function,
               const std::vector<TreePtr> &trees, HostModule &module,
               const uint64_t *args, uint64_t *results);

/// Runs `region` under a tape, and compares the gradient of `loss` by each
/// field of `wrt` with central differences along random directions. Afterwards
/// all fields hold the values that the first run and its sweep left.
Status checkGradient(Runtime &runtime, const FieldPtr &loss,
                     const std::vector<FieldPtr> &wrt, double tolerance,
                     std::function<Status()> region);

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_TAPE_HOSTPROGRAM_H
