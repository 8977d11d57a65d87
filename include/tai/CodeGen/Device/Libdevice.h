//===- Libdevice.h - CUDA's math library ------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_DEVICE_LIBDEVICE_H
#define TAI_CODEGEN_DEVICE_LIBDEVICE_H

#include "llvm/Support/MemoryBufferRef.h"
#include <optional>
#include <string>

namespace mlir::tai {

/// The bitcode of libdevice, cached for the process. Returns no value if it is
/// not found; `searched` then lists the paths that were tried.
std::optional<llvm::MemoryBufferRef> getLibdevice(std::string &searched);

} // namespace mlir::tai

#endif // TAI_CODEGEN_DEVICE_LIBDEVICE_H
