//===- Numbers.h - Operations on single numbers -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What the operations of arith and math make of numbers.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_INTERPRETER_NUMBERS_H
#define TAI_LIB_INTERPRETER_NUMBERS_H

#include "mlir/IR/BuiltinTypes.h"
#include "mlir/IR/Operation.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/ADT/APFloat.h"
#include "llvm/ADT/APInt.h"
#include <variant>

namespace mlir::tai::interpreter {

/// An integer (or index, of 64 bits) or a float, in the width of its type.
using Number = std::variant<llvm::APInt, llvm::APFloat>;

/// Bits of an integer or index type.
unsigned getWidth(Type type);
Number getZero(Type type);
/// The number that an attribute stands for.
Number getNumber(Attribute attribute);

inline bool isTrue(const Number &number) {
  return !std::get<llvm::APInt>(number).isZero();
}
inline int64_t toIndex(const Number &number) {
  return std::get<llvm::APInt>(number).getSExtValue();
}
inline Number fromIndex(int64_t index) {
  return llvm::APInt(64, static_cast<uint64_t>(index), /*isSigned=*/true);
}
/// A float as f64, which holds every number of the narrower types.
double toDouble(const Number &number);
/// Rounds to the float type.
Number fromDouble(long double number, Type type);

// The numbers of a type as they lie in memory: i1 in a byte, index in eight.
int64_t getByteSize(Type type);
Number readNumber(const char *from, Type type);
void writeNumber(const Number &number, char *to);

/// What came out: a number, or why there is none.
struct Outcome {
  std::optional<Number> number;
  std::string problem;
  /// Where a result is defined all the same, but not asked for: reported in
  /// debug mode only.
  bool isTolerated = false;

  Outcome(llvm::APInt number) : number(std::move(number)) {}
  Outcome(llvm::APFloat number) : number(std::move(number)) {}
  Outcome(Number number) : number(std::move(number)) {}
  static Outcome undefined(const Twine &problem) {
    Outcome outcome(llvm::APInt(1, 0));
    outcome.number.reset();
    outcome.problem = problem.str();
    return outcome;
  }
};

/// One component of an operation whose operands and result have one shape.
/// `type`: of the component of the result.
using ScalarFunction = Outcome (*)(Operation *op, ArrayRef<Number> operands,
                                   Type type);
/// The function for operations of this name, or null.
ScalarFunction findScalarFunction(StringRef name);

/// a * b and the like, on numbers of one type.
Number combine(AtomicKind kind, const Number &a, const Number &b);
Number add(const Number &a, const Number &b);
Number subtract(const Number &a, const Number &b);
Number multiply(const Number &a, const Number &b);

} // namespace mlir::tai::interpreter

#endif // TAI_LIB_INTERPRETER_NUMBERS_H
