//===- TaiOps.td - Ops of the tai dialect ------------------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
// The ops, by group. This file only collects them.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TAIOPS_TD
#define TAI_DIALECT_TAI_IR_TAIOPS_TD

include "tai/Dialect/Tai/IR/TaiLayoutOps.td"
include "tai/Dialect/Tai/IR/TaiKernelOps.td"
include "tai/Dialect/Tai/IR/TaiAccessOps.td"
include "tai/Dialect/Tai/IR/TaiStackOps.td"
include "tai/Dialect/Tai/IR/TaiMatrixOps.td"
include "tai/Dialect/Tai/IR/TaiHostOps.td"

#endif // TAI_DIALECT_TAI_IR_TAIOPS_TD
