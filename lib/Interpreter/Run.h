//===- Run.h - One execution of a function ----------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The state of an execution, which handlers of operations (Handlers.h) read and
// change.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_INTERPRETER_RUN_H
#define TAI_LIB_INTERPRETER_RUN_H

#include "FunctionCode.h"
#include "tai/Support/Places.h"
#include <map>
#include <random>

namespace mlir::tai::interpreter {

using Numbers = SmallVector<Number, 1>;

/// The memory of a memref: the caller's, or owned by the run.
struct Array {
  char *data = nullptr;
  SmallVector<int64_t> extents;
  Type element;
  std::unique_ptr<char[]> owned;
};

/// The memory of a variable (`tai.alloca`), or a stack of scalars.
struct Variable {
  Numbers value;
};

/// An undefined result: the operation that yields it, and the reason. Using
/// such a value is an error.
struct Undefined {
  Operation *op;
  std::string problem;
};

/// The value of an SSA value: the components of a scalar, vector or matrix, or
/// a handle.
struct Datum {
  Numbers numbers;
  /// The undefined components of a value, by position; null if there are none.
  std::shared_ptr<std::map<size_t, Undefined>> undefined;
  std::shared_ptr<Variable> variable;
  std::shared_ptr<Array> array;

  Datum() = default;
  Datum(Number number) { numbers.push_back(std::move(number)); }
  Datum(Numbers numbers) : numbers(std::move(numbers)) {}
};
using Data = SmallVector<Datum, 2>;

/// Counts random draws, by iteration and by the call path of the draw.
struct DrawCounter {
  /// The number of the current iteration of the parallel loop.
  int64_t iteration = 0;
  std::vector<Operation *> calls;
  std::map<std::vector<Operation *>, uint32_t> drawn;

  /// Returns the count of numbers that a random draw has drawn in this
  /// iteration.
  uint32_t &at(Operation *draw) {
    std::vector<Operation *> path = calls;
    path.push_back(draw);
    return drawn[path];
  }
};

/// Values to show in a message, in the form that the runtime takes.
struct Message {
  SmallVector<int32_t> kinds, shapes;
  SmallVector<uint64_t> slots;
};

/// The state of one run of a function in the interpreter.
struct Run {
  Run(const FunctionCode &program, TaiFrame *frame)
      : program(program), frame(frame),
        order(program.getOptions().orderSeed + frame->launch) {}

  /// Fails the launch at an operation with a message.
  LogicalResult fail(Operation *op, const Twine &message,
                     int32_t failure = TAI_FAIL_CHECK);
  /// Reports a failure at an operation, and lets the run continue.
  void report(Operation *op, StringRef message, ValueRange values,
              int32_t failure);
  Message getMessage(ValueRange values);
  /// Passes a safepoint, which checks for interrupts; called at each iteration
  /// of a loop.
  LogicalResult passSafepoint();

  Datum &get(Value value) { return values[value]; }
  const Number &getNumber(Value value) { return get(value).numbers.front(); }
  SmallVector<int64_t> getIndices(ValueRange indices);
  Data getOperands(Operation *op);
  void set(Value value, Datum datum) { values[value] = std::move(datum); }
  void setResults(Operation *op, const Data &results);
  /// getField: the field that an operation accesses. getTree: the base of the
  /// field's tree.
  const FieldPlace &getField(Operation *op);
  char *getTree(const FieldPlace &field) {
    return static_cast<char *>(frame->trees[field.tree]);
  }

  LogicalResult execute(Operation *op) {
    if (hasUndefined && failed(checkDefined(op)))
      return failure();
    return program.getHandler(op)(*this, op);
  }
  /// Fails if an operation uses an undefined value. Arithmetic propagates such
  /// a value, and a select may discard it.
  LogicalResult checkDefined(Operation *op);
  LogicalResult runBlock(Block &block, ArrayRef<Datum> arguments);

  const FunctionCode &program;
  TaiFrame *frame;
  /// Draws the order of the iterations of parallel loops, if that is random.
  std::mt19937_64 order;
  llvm::DenseMap<Value, Datum> values;
  /// The operands of the terminator of the block that ran last.
  Data ended;
  /// Some value is undefined.
  bool hasUndefined = false;
  /// True if stores to inactive cells do nothing; see `tai.kernel`.
  bool keepsActivity = false;
  DrawCounter draws;
};

} // namespace mlir::tai::interpreter

#endif // TAI_LIB_INTERPRETER_RUN_H
