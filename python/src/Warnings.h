//===- Warnings.h - Warnings of the compiler in Python ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Kernels are compiled on any thread, also in the background. Warnings of the
// compiler are kept until a call of libtai returns to Python, and are then
// issued as Python warnings.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_PYTHON_WARNINGS_H
#define TAI_PYTHON_WARNINGS_H

#include "tai-c/Tai.h"

namespace taipy {

/// A handler of taiContextSetWarningHandler.
void keepWarning(const TaiWarning *warning, void *user);

} // namespace taipy

#endif // TAI_PYTHON_WARNINGS_H
