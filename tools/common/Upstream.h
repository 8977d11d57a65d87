//===- Upstream.h - Upstream's part of a tool -------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What the tools register of upstream MLIR. Linked with the shared libraries
// that is everything. The portable library would carry every dialect and every
// backend for it, three times its size, so there it is what programs of tai use
// on their way to machine code.
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
