//===- Run.h - A run of a function ------------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The state of a run, and what handlers of operations do to it. The handlers
// are functions, in tables by name: Handlers.h.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_INTERPRETER_RUN_H
#define TAI_LIB_INTERPRETER_RUN_H

#include "Program.h"
#include "tai/Support/Places.h"
#include <map>
#include <random>

namespace mlir::tai::interpreter {

using Numbers = SmallVector<Number, 1>;

/// The memory of a memref: of the caller, or of the run.
struct Array {
  char *data = nullptr;
  SmallVector<int64_t> extents;
  Type element;
  std::unique_ptr<char[]> owned;
};

/// A variable (`tai.alloca`), or a stack of scalars.
struct Variable {
  Numbers value;
};

/// Why an operation has no result: an error where something is made of it.
struct Undefined {
  Operation *op;
  std::string problem;
};

/// What an SSA value holds: the components of a scalar, vector or matrix, or a
/// handle.
struct Datum {
  Numbers numbers;
  /// The components that are undefined, by their positions. Null is none.
  std::shared_ptr<std::map<size_t, Undefined>> undefined;
  std::shared_ptr<Variable> variable;
  std::shared_ptr<Array> array;

  Datum() = default;
  Datum(Number number) { numbers.push_back(std::move(number)); }
  Datum(Numbers numbers) : numbers(std::move(numbers)) {}
};
using Data = SmallVector<Datum, 2>;

/// Where random numbers are drawn: they are counted by iteration and by the
/// calls that led to the draw.
struct DrawCounter {
  /// Of the parallel loop at hand.
  int64_t iteration = 0;
  std::vector<Operation *> calls;
  std::map<std::vector<Operation *>, uint32_t> drawn;

  /// How many numbers the operation has drawn in this iteration.
  uint32_t &at(Operation *draw) {
    std::vector<Operation *> path = calls;
    path.push_back(draw);
    return drawn[path];
  }
};

/// Values as the runtime wants them for its messages.
struct Message {
  SmallVector<int32_t> kinds, shapes;
  SmallVector<uint64_t> slots;
};

/// One run of a function.
struct Run {
  Run(const Program &program, TaiFrame *frame)
      : program(program), frame(frame),
        order(program.getOptions().orderSeed + frame->launch) {}

  /// Fails the launch at an operation.
  LogicalResult fail(Operation *op, const Twine &message,
                     int32_t failure = TAI_FAIL_CHECK);
  /// Says so, and goes on.
  void report(Operation *op, StringRef message, ValueRange values,
              int32_t failure);
  Message getMessage(ValueRange values);
  /// At each iteration of a loop.
  LogicalResult passSafepoint();

  Datum &get(Value value) { return values[value]; }
  const Number &getNumber(Value value) { return get(value).numbers.front(); }
  SmallVector<int64_t> getIndices(ValueRange indices);
  Data getOperands(Operation *op);
  void set(Value value, Datum datum) { values[value] = std::move(datum); }
  void setResults(Operation *op, const Data &results);
  /// The field that an operation names, and the tree that it lies in.
  const FieldPlace &getField(Operation *op);
  char *getTree(const FieldPlace &field) {
    return static_cast<char *>(frame->trees[field.tree]);
  }

  LogicalResult execute(Operation *op) {
    if (hasUndefined && failed(checkDefined(op)))
      return failure();
    return program.getHandler(op)(*this, op);
  }
  /// Fails where an operation makes something of what is undefined. Arithmetic
  /// hands it on, and a select may leave it aside.
  LogicalResult checkDefined(Operation *op);
  LogicalResult runBlock(Block &block, ArrayRef<Datum> arguments);

  const Program &program;
  TaiFrame *frame;
  /// Of iterations, where they run in the order of a seed.
  std::mt19937_64 order;
  llvm::DenseMap<Value, Datum> values;
  /// The operands of the terminator that ended the last block.
  Data ended;
  /// Something undefined has come out.
  bool hasUndefined = false;
  /// Stores to inactive cells do nothing; see `tai.kernel`.
  bool keepsActivity = false;
  DrawCounter draws;
};

} // namespace mlir::tai::interpreter

#endif // TAI_LIB_INTERPRETER_RUN_H
