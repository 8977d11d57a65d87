//===- Numbers.h - Operations on single numbers -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Scalar semantics of the operations of arith and math.
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

/// Returns the number of bits of an integer or index type.
unsigned getWidth(Type type);
Number getZero(Type type);
/// Returns the value of a constant attribute.
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
/// Converts a float to f64, exactly.
double toDouble(const Number &number);
/// Rounds a number to the float type `type`.
Number fromDouble(long double number, Type type);

// The representation of numbers in memory: i1 takes a byte, index eight.
int64_t getByteSize(Type type);
Number readNumber(const char *from, Type type);
void writeNumber(const Number &number, char *to);

/// The result of interpreting an operation: a number, or the reason why it is
/// undefined.
struct Outcome {
  std::optional<Number> number;
  std::string problem;
  /// The result is defined but most likely a mistake (such as a division by
  /// zero): reported in debug mode only.
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

/// Computes one component of an elementwise operation. `type` is the type of
/// the result's component.
using ScalarFunction = Outcome (*)(Operation *op, ArrayRef<Number> operands,
                                   Type type);
/// Finds the function that computes operations of this name; null if there is
/// none.
ScalarFunction findScalarFunction(StringRef name);

/// Combines two numbers of the same type by an atomic operation such as
/// addition.
Number combine(AtomicKind kind, const Number &a, const Number &b);
Number add(const Number &a, const Number &b);
Number subtract(const Number &a, const Number &b);
Number multiply(const Number &a, const Number &b);

} // namespace mlir::tai::interpreter

#endif // TAI_LIB_INTERPRETER_NUMBERS_H
