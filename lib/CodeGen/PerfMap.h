//===- PerfMap.h - Names of compiled functions for perf ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Linux's profiler finds the names of functions that are in no file in
// /tmp/perf-<process>.map. With TAI_PERF_MAP=1, the linker writes this file.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_PERFMAP_H
#define TAI_LIB_CODEGEN_PERFMAP_H

#include <memory>

namespace llvm::orc {
class LinkGraphLinkingLayer;
} // namespace llvm::orc

namespace mlir::tai {

/// Makes the linking layer record the functions that it links for `perf`, if
/// TAI_PERF_MAP is set.
void addPerfMap(llvm::orc::LinkGraphLinkingLayer &layer);

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_PERFMAP_H
