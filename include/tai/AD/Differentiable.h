//===- Differentiable.h - Former place --------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// This header has moved; including it by this name works for one more release.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_DIFFERENTIABLE_H
#define TAI_AD_DIFFERENTIABLE_H

#include "tai/Interfaces/Differentiable.h"

#endif // TAI_AD_DIFFERENTIABLE_H
