//===- Slopes.cpp - Derivatives inside a kernel ---------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The ops between the source and the values are copied to a separate function,
// which forward mode extends. Its body is copied back, once for each direction,
// so that the rules and conventions are those of forward mode.
//
//===----------------------------------------------------------------------===//

#include "Slopes.h"
#include "mlir/Analysis/TopologicalSortUtils.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "mlir/Transforms/RegionUtils.h"
#include "tai/AD/Forward/TangentBuilder.h"
#include "tai/AD/Prepare/SpectralForms.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Support/SilencedDiagnostics.h"

using namespace mlir;
using namespace mlir::tai;

/// Finds the values computed from `source`, directly or through other values,
/// but not through memory.
static DenseSet<Value> getDependents(Value source) {
  DenseSet<Value> found;
  SmallVector<Value> worklist = {source};
  auto mark = [&](ValueRange values) {
    for (Value value : values)
      if (found.insert(value).second)
        worklist.push_back(value);
  };
  auto markAll = [&](Operation *op) {
    mark(op->getResults());
    for (Region &region : op->getRegions())
      for (Block &block : region)
        mark(block.getArguments());
  };
  while (!worklist.empty())
    for (Operation *user : worklist.pop_back_val().getUsers()) {
      markAll(user);
      if (!user->hasTrait<OpTrait::IsTerminator>())
        continue;
      Operation *parent = user->getParentOp();
      if (!isa<FunctionOpInterface>(parent))
        markAll(parent);
    }
  return found;
}

namespace {
/// The ops by which the values to differentiate depend on `source`, and the
/// other values that these ops read.
struct Path {
  llvm::SetVector<Operation *> ops;
  llvm::SetVector<Value> captured;
};
} // namespace

/// True for a read of memory that the function makes: the value may depend on
/// the source.
static bool isLocalRead(Value value) {
  Operation *op = value.getDefiningOp();
  if (auto load = dyn_cast_if_present<memref::LoadOp>(op))
    return !isa<BlockArgument>(load.getMemref());
  return isa_and_present<LocalLoadOp, StackPopOp>(op);
}

static FailureOr<Path> findPath(Value source, ValueRange values) {
  DenseSet<Value> dependents = getDependents(source);
  Path path;
  SmallVector<Value> worklist(values);
  DenseSet<Value> seen;
  while (!worklist.empty()) {
    Value value = worklist.pop_back_val();
    if (value == source || !seen.insert(value).second)
      continue;
    Operation *op = value.getDefiningOp();
    if (!dependents.contains(value)) {
      if (isLocalRead(value))
        return failure();
      // Constants are copied into the new function, because derivative rules
      // look for constant operands.
      if (op && op->hasTrait<OpTrait::ConstantLike>())
        path.ops.insert(op);
      else
        path.captured.insert(value);
      continue;
    }
    if (!op || !isMemoryEffectFree(op) || isa<CallOpInterface>(op))
      return failure();
    path.ops.insert(op);
    llvm::append_range(worklist, op->getOperands());
    SetVector<Value> above;
    getUsedValuesDefinedAbove(op->getRegions(), above);
    llvm::append_range(worklist, above);
  }
  path.ops = topologicalSort(path.ops);
  return path;
}

FailureOr<SmallVector<SmallVector<Value>>>
mlir::tai::createSlopes(ImplicitLocOpBuilder &builder,
                        FunctionOpInterface function, Value source,
                        ArrayRef<int64_t> positions, ValueRange values) {
  FailureOr<Path> path = findPath(source, values);
  if (failed(path))
    return failure();
  auto type = cast<VectorType>(source.getType());
  SmallVector<Value> nothing(values.size());
  if (path->ops.empty())
    return SmallVector<SmallVector<Value>>(positions.size(), nothing);

  // The arguments of the derivative function: memory of the source, memory of
  // its tangent, then the captured values.
  auto memory = MemRefType::get({}, type);
  SmallVector<Type> inputs = {memory, memory};
  for (Value value : path->captured)
    inputs.push_back(value.getType());
  Location loc = builder.getLoc();
  OwningOpRef<func::FuncOp> holder = func::FuncOp::create(
      loc, "slopes", builder.getFunctionType(inputs, values.getTypes()));
  if (Attribute chosen = function->getAttr("conventions"))
    holder->getOperation()->setAttr("tai.conventions", chosen);
  if (Attribute chosen = function->getAttr("tai.conventions"))
    holder->getOperation()->setAttr("tai.conventions", chosen);
  Block *body = holder->addEntryBlock();
  OpBuilder inner = OpBuilder::atBlockEnd(body);
  auto load = memref::LoadOp::create(inner, loc, body->getArgument(0));
  IRMapping into;
  into.map(source, load.getResult());
  for (auto [value, argument] :
       llvm::zip(path->captured, body->getArguments().drop_front(2)))
    into.map(value, argument);
  for (Operation *op : path->ops)
    inner.clone(*op, into);
  // The operands of this return are the values to differentiate. Forward mode
  // rebuilds loops and branches, and keeps these operands up to date.
  auto ends = func::ReturnOp::create(
      inner, loc, llvm::map_to_vector(values, [&](Value value) {
        return into.lookup(value);
      }));

  // If forward mode cannot extend the function, no error is reported: the
  // product is then differentiated by the rules of its ops.
  SilencedDiagnostics silence(builder.getContext());
  auto extended = cast<FunctionOpInterface>(holder->getOperation());
  TangentBuilder tangents(extended, [&](Storage storage) -> Storage {
    return storage.memref == body->getArgument(0) ? body->getArgument(1)
                                                  : Value();
  });
  if (failed(tangents.build()))
    return failure();

  IRMapping known;
  auto stop = [&](Value value) -> Value {
    if (!isa<FloatType>(getElementTypeOrSelf(value.getType())))
      return value;
    return createConstantForm(builder, value);
  };
  for (auto [value, argument] :
       llvm::zip(path->captured, body->getArguments().drop_front(2)))
    known.map(argument, stop(value));
  Value stopped = stop(source);
  SmallVector<SmallVector<Value>> slopes;
  for (int64_t position : positions) {
    SmallVector<Attribute> seed(type.getNumElements(),
                                builder.getFloatAttr(type.getElementType(), 0));
    seed[position] = builder.getFloatAttr(type.getElementType(), 1);
    Value direction =
        arith::ConstantOp::create(builder, DenseElementsAttr::get(type, seed));
    IRMapping out = known;
    for (Operation &op : body->without_terminator()) {
      // The derivative function loads only the source and its tangent.
      if (auto read = dyn_cast<memref::LoadOp>(op))
        out.map(read.getResult(),
                read.getMemref() == body->getArgument(0) ? stopped : direction);
      else
        builder.clone(op, out);
    }
    SmallVector<Value> &row = slopes.emplace_back();
    for (Value value : ends.getOperands()) {
      Value tangent = tangents.getTangent(value);
      row.push_back(tangent ? out.lookup(tangent) : Value());
    }
  }
  return slopes;
}
