//===- PerfMap.h - Names of compiled functions for perf ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The profiler of Linux finds the names of functions that no file holds in
// /tmp/perf-<process>.map. With TAI_PERF_MAP=1 the linker writes it.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CODEGEN_PERFMAP_H
#define TAI_LIB_CODEGEN_PERFMAP_H

#include <memory>

namespace llvm::orc {
class LinkGraphLinkingLayer;
} // namespace llvm::orc

namespace mlir::tai {

/// Lets a layer note the functions that it links, if the environment asks.
void addPerfMap(llvm::orc::LinkGraphLinkingLayer &layer);

} // namespace mlir::tai

#endif // TAI_LIB_CODEGEN_PERFMAP_H
