//===- LocalMemory.h - Memory of threads of a device ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Functions that device code calls instead of malloc and free. The device
// library defines kLocalAllocate and kLocalFree; kLocalGiven only marks its
// argument, memory that an earlier function of the kernel allocated. The
// calling thread exits where kLocalAllocate or kGoOn returns null, or where the
// memory that kLocalGiven marks is null.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ABI_LOCALMEMORY_H
#define TAI_ABI_LOCALMEMORY_H

namespace mlir::tai {

constexpr char kLocalAllocate[] = "tai_rt_local_alloc";
constexpr char kLocalFree[] = "tai_rt_local_free";
constexpr char kLocalGiven[] = "tai_rt_local_given";
/// The function that device code calls as a safepoint in loops that may run
/// long. It returns null if the thread must exit.
constexpr char kGoOn[] = "tai_rt_go_on";

} // namespace mlir::tai

#endif // TAI_ABI_LOCALMEMORY_H
