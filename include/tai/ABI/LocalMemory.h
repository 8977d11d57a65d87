//===- LocalMemory.h - Memory of threads of a device ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Functions that device code calls in the place of malloc and free: the device
// library has them, but for the last one, which stands for its argument. Where
// the first or the last gives null, the calling function does nothing more.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ABI_LOCALMEMORY_H
#define TAI_ABI_LOCALMEMORY_H

namespace mlir::tai {

constexpr char kLocalAllocate[] = "tai_rt_local_alloc";
constexpr char kLocalFree[] = "tai_rt_local_free";
constexpr char kLocalGiven[] = "tai_rt_local_given";
/// Asks whether a loop that may be long goes on, every so many iterations: null
/// where it does not.
constexpr char kGoOn[] = "tai_rt_go_on";

} // namespace mlir::tai

#endif // TAI_ABI_LOCALMEMORY_H
