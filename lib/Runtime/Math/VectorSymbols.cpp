//===- VectorSymbols.cpp - Symbols of functions of vectors ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Math/VectorSymbols.h"

using namespace mlir::tai::runtime;

#if defined(__x86_64__)
// These declarations serve to take addresses, so their types are not the actual
// ones: the functions are defined in sources that are compiled for certain
// processors, and only compiled kernels call them.
extern "C" {
#define TAI_WIDE_FUNCTION(name, arguments)                                     \
  void tai_wide_##name##_1();                                                  \
  void tai_wide_##name##_4();                                                  \
  void tai_wide_##name##_8();                                                  \
  void tai_wide_##name##_16();
#define TAI_WIDE_F64_FUNCTION(name)                                            \
  void tai_wide_##name##_f64_1();                                              \
  void tai_wide_##name##_f64_2();                                              \
  void tai_wide_##name##_f64_4();                                              \
  void tai_wide_##name##_f64_8();
#include "tai/ABI/VectorMath.def"
}
#endif

std::vector<std::pair<const char *, void *>>
mlir::tai::runtime::vectorMathSymbols() {
  std::vector<std::pair<const char *, void *>> symbols;
#if defined(__x86_64__)
  auto add = [&](const char *name, void (*function)()) {
    symbols.emplace_back(name, reinterpret_cast<void *>(function));
  };
#define TAI_WIDE_FUNCTION(name, arguments)                                     \
  add("tai_wide_" #name "_1", tai_wide_##name##_1);                            \
  add("tai_wide_" #name "_4", tai_wide_##name##_4);                            \
  add("tai_wide_" #name "_8", tai_wide_##name##_8);                            \
  add("tai_wide_" #name "_16", tai_wide_##name##_16);
#define TAI_WIDE_F64_FUNCTION(name)                                            \
  add("tai_wide_" #name "_f64_1", tai_wide_##name##_f64_1);                    \
  add("tai_wide_" #name "_f64_2", tai_wide_##name##_f64_2);                    \
  add("tai_wide_" #name "_f64_4", tai_wide_##name##_f64_4);                    \
  add("tai_wide_" #name "_f64_8", tai_wide_##name##_f64_8);
#include "tai/ABI/VectorMath.def"
#endif
  return symbols;
}
