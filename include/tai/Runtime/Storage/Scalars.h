//===- Scalars.h - Conversions of scalars -----------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Loads and stores of one scalar of any kind as double or int64_t.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_STORAGE_SCALARS_H
#define TAI_RUNTIME_STORAGE_SCALARS_H

#include "tai/Runtime/Storage/Field.h"

namespace mlir::tai::runtime {

struct RuntimeSymbol;

double loadF64(ScalarKind kind, const char *address);
int64_t loadI64(ScalarKind kind, const char *address);
void storeF64(ScalarKind kind, char *address, double value);
void storeI64(ScalarKind kind, char *address, int64_t value);

/// Conversions of f64 to IEEE binary16 and bfloat16, rounded to nearest, ties
/// to even.
uint16_t halfFromDouble(double value);
uint16_t bfloatFromDouble(double value);
double doubleFromHalf(uint16_t bits);
double doubleFromBfloat(uint16_t bits);

/// Appends the functions of LibraryCalls.cpp, such as conversions of 16-bit
/// floats, to the symbols of compiled code.
void appendLibraryCalls(std::vector<RuntimeSymbol> &symbols);

/// Sets `step` to the stride in bytes of elements along an index with these
/// layout levels; false if the stride is not uniform.
bool findConstantStep(const std::vector<LayoutLevel> &levels, int64_t &step);

/// The stride in bytes of elements in row-major order; 0 if the stride is not
/// uniform. For a single element, its size.
int64_t findEvenStep(const FieldLayout &layout,
                     const std::vector<int64_t> &shape, int64_t elementBytes);

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_STORAGE_SCALARS_H
