//===- Program.h - What the interpreter runs, and a run of it ---*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_INTERPRETER_PROGRAM_H
#define TAI_LIB_INTERPRETER_PROGRAM_H

#include "Numbers.h"
#include "mlir/Interfaces/DataLayoutInterfaces.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Interpreter/Interpreter.h"
#include "llvm/ADT/DenseMap.h"
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

/// What an SSA value holds: the components of a scalar, vector or matrix, or a
/// handle.
struct Datum {
  Numbers numbers;
  std::shared_ptr<Variable> variable;
  std::shared_ptr<Array> array;

  Datum() = default;
  Datum(Number number) { numbers.push_back(std::move(number)); }
  Datum(Numbers numbers) : numbers(std::move(numbers)) {}
};
using Data = SmallVector<Datum, 2>;

/// A field: where it lies, and how cells on the way are numbered.
struct FieldPlace {
  FieldLayout layout;
  FieldStorage storage;
  SmallVector<SparseNode> nodes;
  unsigned tree; // among those of the module
  Type scalar;
  SmallVector<int64_t> elementShape;
};

class Run;
using Handler = LogicalResult (Run::*)(Operation *);

/// A function, the handler of each of its operations, and the fields it names.
class Program {
public:
  /// Null, with diagnostics, where something in it cannot be run.
  static std::unique_ptr<Program> create(ModuleOp module, StringRef function,
                                         const InterpreterOptions &options);

  const InterpreterOptions &getOptions() const { return options; }
  FunctionOpInterface getFunction() const { return function; }
  Handler getHandler(Operation *op) const { return handlers.lookup(op); }
  ScalarFunction getScalarFunction(Operation *op) const {
    return scalarFunctions.lookup(op);
  }
  const FieldPlace &getField(StringAttr name) const {
    return *fields.find(name)->second;
  }
  /// The function that a `func.call` calls.
  Operation *getCallee(Operation *call) const { return callees.lookup(call); }

private:
  LogicalResult prepare(Operation *function);
  LogicalResult prepareField(Operation *user, StringAttr name);

  InterpreterOptions options;
  ModuleOp module;
  mutable FunctionOpInterface function;
  llvm::DenseMap<Operation *, Handler> handlers;
  llvm::DenseMap<Operation *, ScalarFunction> scalarFunctions;
  llvm::DenseMap<Operation *, Operation *> callees;
  llvm::DenseMap<StringAttr, std::unique_ptr<FieldPlace>> fields;
  SmallPtrSet<Operation *, 4> prepared;
};

/// One run of a function. A handler that fails has said why, to the launch.
class Run {
public:
  Run(const Program &program, TaiFrame *frame)
      : program(program), frame(frame),
        random(program.getOptions().orderSeed + frame->launch) {}

  int32_t run();

  /// The handler for operations of that name, or null.
  static Handler findHandler(StringRef name);

private:
  /// Fails the launch at an operation.
  LogicalResult fail(Operation *op, const Twine &message,
                     int32_t failure = TAI_FAIL_CHECK);
  /// Says so, and goes on.
  void report(Operation *op, StringRef message, ValueRange values,
              int32_t failure);
  /// At each iteration of a loop.
  LogicalResult passSafepoint();

  // Values.
  Datum &get(Value value) { return values[value]; }
  const Number &getNumber(Value value) { return get(value).numbers.front(); }
  SmallVector<int64_t> getIndices(ValueRange indices);
  void set(Value value, Datum datum) { values[value] = std::move(datum); }

  // Control flow.
  LogicalResult runBlock(Block &block, ArrayRef<Datum> arguments);
  LogicalResult execute(Operation *op);
  Data getOperands(Operation *terminator);
  void setResults(Operation *op, const Data &results);
  LogicalResult runTerminator(Operation *op);
  LogicalResult runFor(Operation *op);
  LogicalResult runWhile(Operation *op);
  LogicalResult runIf(Operation *op);
  LogicalResult runSwitch(Operation *op);
  LogicalResult runScfParallel(Operation *op);
  LogicalResult runCall(Operation *op);
  LogicalResult runParallelFor(Operation *op);
  LogicalResult runIteration(ParallelForOp loop, ArrayRef<int64_t> indices,
                             int64_t number);
  LogicalResult runBox(ParallelForOp loop);
  LogicalResult runStructFor(ParallelForOp loop);
  /// Runs `iterate` for 0, 1, ..., or in the order of the seed.
  LogicalResult forEach(int64_t count, bool serial,
                        function_ref<LogicalResult(int64_t)> iterate);

  // Numbers, vectors and matrices.
  LogicalResult runConstant(Operation *op);
  LogicalResult runScalars(Operation *op);
  LogicalResult runSinCos(Operation *op);
  LogicalResult runSelect(Operation *op);
  LogicalResult runBroadcast(Operation *op);
  LogicalResult runExtract(Operation *op);
  LogicalResult runInsert(Operation *op);
  LogicalResult runFromElements(Operation *op);
  LogicalResult runToElements(Operation *op);
  LogicalResult runShuffle(Operation *op);
  LogicalResult runReduction(Operation *op);
  LogicalResult runForward(Operation *op);
  LogicalResult runMatmul(Operation *op);
  LogicalResult runTranspose(Operation *op);
  LogicalResult runDot(Operation *op);
  LogicalResult runSum(Operation *op);
  LogicalResult runCross(Operation *op);
  LogicalResult runOuter(Operation *op);
  LogicalResult runNorm(Operation *op);
  LogicalResult runTrace(Operation *op);
  LogicalResult runDeterminant(Operation *op);
  LogicalResult runInverse(Operation *op);
  LogicalResult runSolve(Operation *op);
  LogicalResult runPolar(Operation *op);
  LogicalResult runSvd(Operation *op);
  LogicalResult runSymEig(Operation *op);

  // Memory.
  LogicalResult runAlloca(Operation *op);
  LogicalResult runLocalLoad(Operation *op);
  LogicalResult runLocalStore(Operation *op);
  LogicalResult runStackPush(Operation *op);
  LogicalResult runStackPop(Operation *op);
  LogicalResult runNothing(Operation *op) { return success(); }
  LogicalResult runAlloc(Operation *op);
  LogicalResult runDim(Operation *op);
  LogicalResult runArrayLoad(Operation *op);
  LogicalResult runArrayStore(Operation *op);
  LogicalResult runArrayAtomic(Operation *op);
  FailureOr<char *> locate(Operation *op, Value array, ValueRange indices);
  LogicalResult runLoad(Operation *op);
  LogicalResult runStore(Operation *op);
  LogicalResult runAtomic(Operation *op);
  LogicalResult runActivate(Operation *op);
  LogicalResult runDeactivate(Operation *op);
  LogicalResult runIsActive(Operation *op);
  LogicalResult runVisitsAll(Operation *op);
  LogicalResult runAppend(Operation *op);
  LogicalResult runLength(Operation *op);

  const FieldPlace &getField(Operation *op);
  char *getTree(const FieldPlace &field) {
    return static_cast<char *>(frame->trees[field.tree]);
  }
  /// Fails the launch unless the indices are in range; makes them count from
  /// zero.
  LogicalResult checkIndices(Operation *op, const FieldPlace &field,
                             SmallVector<int64_t> &indices);
  /// The address of an element, or of one of its components, in range.
  FailureOr<char *> locate(Operation *op, const FieldPlace &field,
                           SmallVector<int64_t> indices, ValueRange components,
                           bool activates, bool &exists);
  int64_t getCell(const FieldPlace &field, unsigned level,
                  ArrayRef<int64_t> indices);
  bool isActive(const FieldPlace &field, FieldStorage::SparseLevel level,
                int64_t cell);
  int64_t getListLength(const FieldPlace &field, unsigned node, int64_t list);
  /// The sparse level that a topology operation means, or null.
  const FieldStorage::SparseLevel *findLevel(const FieldPlace &field,
                                             int64_t up);
  /// The list that `append` and `length` mean, and the number of its dimension.
  FailureOr<FieldStorage::SparseLevel>
  findList(Operation *op, const FieldPlace &field, unsigned &dimension);

  // Services.
  LogicalResult runRandom(Operation *op);
  LogicalResult runAssert(Operation *op);
  LogicalResult runPrecondition(Operation *op);
  LogicalResult checkPreconditions(Block &body);
  LogicalResult evaluate(Value value);
  LogicalResult runPrint(Operation *op);
  LogicalResult runLaunch(Operation *op);
  LogicalResult runTape(Operation *op);
  LogicalResult runCheckGradient(Operation *op);
  LogicalResult runCheckClose(Operation *op);
  void readArguments(FunctionOpInterface function, Data &arguments);
  void writeResults(Operation *terminator);

  /// Values as the runtime wants them for its messages.
  struct Message {
    SmallVector<int32_t> kinds, shapes;
    SmallVector<uint64_t> slots;
  };
  Message getMessage(ValueRange values);

  const Program &program;
  TaiFrame *frame;
  std::mt19937_64 random;
  llvm::DenseMap<Value, Datum> values;
  /// The operands of the terminator that ended the last block.
  Data ended;
  /// Stores to inactive cells do nothing; see kKeepsActivityAttrName.
  bool keepsActivity = false;
  /// Of the parallel loop at hand.
  int64_t iteration = 0;
  /// What each operation has drawn in this iteration, by the calls that led to
  /// it.
  std::map<std::vector<Operation *>, uint32_t> draws;
  std::vector<Operation *> calls;
};

/// "file:line:column", or empty.
std::string describePlaceOf(Operation *op);

} // namespace mlir::tai::interpreter

#endif // TAI_LIB_INTERPRETER_PROGRAM_H
