//===- EmulatedCode.h - Code of the emulated device -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_COMPILE_EMULATEDCODE_H
#define TAI_EXECUTIONENGINE_COMPILE_EMULATEDCODE_H

#include "tai/Runtime/Device/Device.h"

namespace mlir::tai {

/// Links the code of the emulated device into memory. The code has its own
/// linker, and keeps it alive, because the code can outlive the session's
/// compiler.
runtime::ObjectLinker makeObjectLinker();

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_COMPILE_EMULATEDCODE_H
