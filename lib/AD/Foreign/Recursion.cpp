//===- Recursion.cpp - Functions that call themselves ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A function with one call of itself becomes three loops. The first one counts
// the calls, the second one runs the part before the call of each, and the
// third one runs the parts after it, from the innermost call to the outermost.
// Values from before the call that are used after it are kept in arrays, which
// are the stack. The part before the call runs twice, and must write nothing.
//
//===----------------------------------------------------------------------===//

#include "Recursion.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "llvm/ADT/SetVector.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// A block around the call, and its op that contains the call or is the call.
struct Level {
  Block *block;
  Operation *op;
};

class Recursion {
public:
  explicit Recursion(func::FuncOp function)
      : function(function), b(function.getLoc(), function.getContext()) {}

  LogicalResult run();

private:
  LogicalResult match();
  LogicalResult findSaved();
  LogicalResult refuse(const Twine &note);
  void mapArguments(IRMapping &mapping, ValueRange numbers);
  void cloneBefore(IRMapping &mapping, const Level &level) {
    for (Operation &op : *level.block) {
      if (&op == level.op)
        break;
      b.clone(op, mapping);
    }
  }
  SmallVector<Value> getNext(IRMapping &mapping) {
    SmallVector<Value> next;
    for (unsigned i : numbers)
      next.push_back(mapping.lookupOrDefault(call.getOperand(i)));
    return next;
  }
  SmallVector<Value> createStep(size_t level, IRMapping &mapping,
                                ValueRange arguments);
  Value createCount();
  SmallVector<Value> createBase(ValueRange arguments);
  SmallVector<Value> createAfter(IRMapping &mapping);

  func::FuncOp function;
  func::CallOp call;
  SmallVector<Level> levels;
  /// The positions of arguments that are numbers; the others are the same in
  /// all calls.
  SmallVector<unsigned> numbers;
  /// Values from before the call that are used after it.
  llvm::SetVector<Value> saved;
  /// Constants among these, which are made again.
  llvm::SetVector<Operation *> constants;
  ImplicitLocOpBuilder b;
  Block *made = nullptr;
};
} // namespace

LogicalResult Recursion::refuse(const Twine &note) {
  InFlightDiagnostic diag = call.emitError("cannot differentiate this call: '@")
                            << function.getName() << "' calls itself";
  diag.attachNote(function.getLoc())
      << note << ", or a loop in its place, 'scf.for' or 'scf.while'";
  return diag;
}

/// Finds the blocks around the call, and checks the part before it.
LogicalResult Recursion::match() {
  for (Operation *op = call; op != function; op = op->getParentOp()) {
    if (op != call && !isa<scf::IfOp>(op))
      return refuse("expects the call outside of loops");
    levels.insert(levels.begin(), Level{op->getBlock(), op});
  }
  for (const Level &level : levels)
    for (Operation &op : *level.block) {
      if (&op == level.op)
        break;
      auto effects = getEffectsRecursively(&op);
      if (!effects || llvm::any_of(*effects, [](const auto &effect) {
            return !isa<MemoryEffects::Read>(effect.getEffect());
          }))
        return refuse("expects that nothing is written or allocated before "
                      "the call");
    }
  for (auto [i, argument] : llvm::enumerate(function.getArguments())) {
    if (argument.getType().isIntOrIndexOrFloat())
      numbers.push_back(i);
    else if (call.getOperand(i) != argument)
      return refuse("expects the same arrays in each call");
  }
  if (!llvm::all_of(function.getResultTypes(),
                    [](Type type) { return type.isIntOrIndexOrFloat(); }))
    return refuse("expects a function that returns numbers");
  return findSaved();
}

LogicalResult Recursion::findSaved() {
  auto isBefore = [&](Value value) {
    for (const Level &level : levels)
      if (value.getParentBlock() == level.block)
        return !value.getDefiningOp() ||
               value.getDefiningOp()->isBeforeInBlock(level.op);
    return false;
  };
  bool isGood = true;
  for (const Level &level : levels)
    for (Operation *op = level.op->getNextNode(); op; op = op->getNextNode())
      op->walk([&](Operation *inner) {
        for (Value value : inner->getOperands()) {
          if (!isBefore(value))
            continue;
          Operation *maker = value.getDefiningOp();
          if (maker && maker->hasTrait<OpTrait::ConstantLike>())
            constants.insert(maker);
          else if (value.getType().isIntOrIndexOrFloat())
            saved.insert(value);
          else if (maker)
            isGood = false;
        }
      });
  return isGood ? success()
                : refuse("expects that numbers alone are used after the call "
                         "of those before it");
}

/// Maps the arguments of the function to those of one call.
void Recursion::mapArguments(IRMapping &mapping, ValueRange values) {
  mapping.map(function.getArguments(), made->getArguments());
  for (auto [i, value] : llvm::zip(numbers, values))
    mapping.map(function.getArgument(i), value);
}

/// Returns whether the function calls itself, and the numbers that it passes:
/// `arguments` if it does not.
SmallVector<Value> Recursion::createStep(size_t level, IRMapping &mapping,
                                         ValueRange arguments) {
  cloneBefore(mapping, levels[level]);
  auto yes = [&](bool value) -> Value {
    return arith::ConstantOp::create(b, b.getBoolAttr(value));
  };
  SmallVector<Value> results;
  if (levels[level].op == call) {
    results.push_back(yes(true));
    llvm::append_range(results, getNext(mapping));
    return results;
  }
  auto branch = cast<scf::IfOp>(levels[level].op);
  SmallVector<Type> types{b.getI1Type()};
  llvm::append_range(types, arguments.getTypes());
  auto copy = scf::IfOp::create(b, types,
                                mapping.lookupOrDefault(branch.getCondition()),
                                /*withElseRegion=*/true);
  bool isThen = levels[level + 1].block == branch.thenBlock();
  OpBuilder::InsertionGuard guard(b);
  b.setInsertionPointToStart(isThen ? copy.thenBlock() : copy.elseBlock());
  scf::YieldOp::create(b, createStep(level + 1, mapping, arguments));
  b.setInsertionPointToStart(isThen ? copy.elseBlock() : copy.thenBlock());
  results.push_back(yes(false));
  llvm::append_range(results, arguments);
  scf::YieldOp::create(b, results);
  return SmallVector<Value>(copy.getResults());
}

/// Emits a loop that counts the calls.
Value Recursion::createCount() {
  SmallVector<Value> inits;
  for (unsigned i : numbers)
    inits.push_back(made->getArgument(i));
  inits.push_back(arith::ConstantIndexOp::create(b, 0));
  SmallVector<Type> types(ValueRange(inits).getTypes());
  auto loop = scf::WhileOp::create(b, types, inits);
  SmallVector<Location> places(types.size(), b.getLoc());
  OpBuilder::InsertionGuard guard(b);
  Block *before = b.createBlock(&loop.getBefore(), {}, types, places);
  IRMapping mapping;
  mapArguments(mapping, before->getArguments().drop_back());
  SmallVector<Value> step =
      createStep(0, mapping, before->getArguments().drop_back());
  Value number = before->getArguments().back();
  Value more =
      arith::AddIOp::create(b, number, arith::ConstantIndexOp::create(b, 1));
  SmallVector<Value> next(llvm::drop_begin(step));
  next.push_back(arith::SelectOp::create(b, step[0], more, number));
  scf::ConditionOp::create(b, step[0], next);
  Block *after = b.createBlock(&loop.getAfter(), {}, types, places);
  scf::YieldOp::create(b, after->getArguments());
  return loop.getResults().back();
}

/// Runs the innermost call, which does not call itself.
SmallVector<Value> Recursion::createBase(ValueRange arguments) {
  IRMapping mapping;
  mapArguments(mapping, arguments);
  Block &body = *levels.front().block;
  SmallVector<Operation *> copies;
  for (Operation &op : body.without_terminator())
    copies.push_back(b.clone(op, mapping));
  SmallVector<Value> results;
  for (Value value : body.getTerminator()->getOperands())
    results.push_back(mapping.lookupOrDefault(value));
  SmallVector<func::CallOp> calls;
  for (Operation *copy : copies)
    copy->walk([&](func::CallOp inner) {
      if (inner.getCallee() == function.getName())
        calls.push_back(inner);
    });
  for (func::CallOp inner : calls) {
    OpBuilder::InsertionGuard guard(b);
    b.setInsertionPoint(inner);
    SmallVector<Value> zeroes;
    for (Type type : inner.getResultTypes())
      zeroes.push_back(arith::ConstantOp::create(b, b.getZeroAttr(type)));
    inner.replaceAllUsesWith(zeroes);
    inner.erase();
  }
  return results;
}

/// Runs the part after the call, and returns the results of the function.
SmallVector<Value> Recursion::createAfter(IRMapping &mapping) {
  SmallVector<Value> results;
  for (size_t i = levels.size(); i-- != 0;) {
    if (i + 1 != levels.size())
      mapping.map(levels[i].op->getResults(), results);
    for (Operation *op = levels[i].op->getNextNode();
         op != levels[i].block->getTerminator(); op = op->getNextNode())
      b.clone(*op, mapping);
    results.clear();
    for (Value value : levels[i].block->getTerminator()->getOperands())
      results.push_back(mapping.lookupOrDefault(value));
  }
  return results;
}

LogicalResult Recursion::run() {
  SmallVector<func::CallOp> calls;
  function.walk([&](func::CallOp op) {
    if (op.getCallee() == function.getName())
      calls.push_back(op);
  });
  if (calls.empty())
    return success();
  call = calls.back();
  b.setLoc(call.getLoc());
  if (calls.size() > 1)
    return refuse("expects one call of itself");
  if (failed(match()))
    return failure();
  Block &old = function.getBody().front();
  made = new Block;
  for (BlockArgument argument : function.getArguments())
    made->addArgument(argument.getType(), argument.getLoc());
  function.getBody().push_back(made);
  b.setInsertionPointToEnd(made);
  Value zero = arith::ConstantIndexOp::create(b, 0);
  Value one = arith::ConstantIndexOp::create(b, 1);
  Value count = createCount();
  SmallVector<Value> stacks;
  for (Value value : saved)
    stacks.push_back(memref::AllocOp::create(
        b, MemRefType::get({ShapedType::kDynamic}, value.getType()), count));
  SmallVector<Value> outermost;
  for (unsigned i : numbers)
    outermost.push_back(made->getArgument(i));
  auto down = scf::ForOp::create(b, zero, count, one, outermost);
  if (numbers.empty())
    down.getBody()->getTerminator()->erase();
  b.setInsertionPointToEnd(down.getBody());
  IRMapping mapping;
  mapArguments(mapping, down.getRegionIterArgs());
  for (const Level &level : levels)
    cloneBefore(mapping, level);
  for (auto [value, stack] : llvm::zip(saved, stacks))
    memref::StoreOp::create(b, mapping.lookup(value), stack,
                            down.getInductionVar());
  scf::YieldOp::create(b, getNext(mapping));
  b.setInsertionPointToEnd(made);
  SmallVector<Value> results = createBase(down.getResults());
  auto up = scf::ForOp::create(b, zero, count, one, results);
  if (results.empty())
    up.getBody()->getTerminator()->erase();
  b.setInsertionPointToEnd(up.getBody());
  mapping = IRMapping();
  mapping.map(function.getArguments(), made->getArguments());
  for (Operation *constant : constants)
    b.clone(*constant, mapping);
  Value last = arith::SubIOp::create(b, count, one);
  Value depth = arith::SubIOp::create(b, last, up.getInductionVar());
  for (auto [value, stack] : llvm::zip(saved, stacks))
    mapping.map(value, Value(memref::LoadOp::create(b, stack, depth)));
  mapping.map(call.getResults(), up.getRegionIterArgs());
  scf::YieldOp::create(b, createAfter(mapping));
  b.setInsertionPointToEnd(made);
  func::ReturnOp::create(b, up.getResults());
  old.dropAllReferences();
  old.erase();
  return success();
}

LogicalResult mlir::tai::unrollRecursion(func::FuncOp function) {
  return Recursion(function).run();
}
