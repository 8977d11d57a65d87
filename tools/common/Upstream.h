//===- Upstream.h - Parts of MLIR for the tools -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The upstream parts of MLIR that the tools register. With shared libraries,
// these are all parts. In the portable library, all parts would include every
// dialect and backend and triple its size; it has only the parts that tai's own
// lowerings use.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TOOLS_COMMON_UPSTREAM_H
#define TAI_TOOLS_COMMON_UPSTREAM_H

namespace mlir {
class DialectRegistry;

namespace tai {

/// Registers upstream dialects and the interfaces attached to them.
void registerUpstreamDialects(DialectRegistry &registry);

/// Registers upstream passes and pipelines by name.
void registerUpstreamPasses();

/// Registers upstream translations by name.
void registerUpstreamTranslations();

} // namespace tai
} // namespace mlir

#endif // TAI_TOOLS_COMMON_UPSTREAM_H
