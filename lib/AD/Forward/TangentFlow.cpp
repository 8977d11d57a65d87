//===- TangentFlow.cpp - Values that may have a tangent -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The tangents that loops and branches carry must be known before their bodies
// are extended. The function is walked to a fixed point: once, and once more
// for each level of nested loops.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Interfaces/ControlFlowInterfaces.h"
#include "tai/AD/Forward/TangentBuilder.h"
#include "tai/Analysis/Activity.h"
#include "tai/Analysis/DerivativePaths.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// One walk over the function, which adds values to the two sets of
/// TangentFlow: values that may have a tangent, and values whose tangent may be
/// non-finite.
class FlowWalk {
public:
  FlowWalk(TangentFlow &flow, FloatFacts &facts,
           function_ref<bool(Storage)> hasTangent)
      : flow(flow), facts(facts), hasTangent(hasTangent) {}

  /// Walks over the function once. Returns true if a set of values has grown.
  bool run(FunctionOpInterface function) {
    grown = false;
    function.walk<WalkOrder::PreOrder>([&](Operation *op) { visit(op); });
    return grown;
  }

private:
  void visit(Operation *op);
  void visitAccess(DifferentiableAccessInterface access);
  void visitBranch(RegionBranchOpInterface op);

  void mark(Value value, bool mayBeNonFinite) {
    if (!isFloatOrVector(value.getType()) &&
        !isa<BaseMemRefType, LocalType, StackType>(value.getType()))
      return;
    grown |= flow.varied.insert(value).second;
    if (mayBeNonFinite)
      grown |= flow.nonFinite.insert(value).second;
  }
  /// Notes that `to` may have a tangent if `from` may have one.
  void pass(Value from, Value to) {
    if (flow.varied.contains(from))
      mark(to, flow.nonFinite.contains(from));
  }
  void pass(ValueRange from, ValueRange to) {
    for (auto [source, target] : llvm::zip(from, to))
      pass(source, target);
  }

  TangentFlow &flow;
  FloatFacts &facts;
  function_ref<bool(Storage)> hasTangent;
  bool grown = false;
};
} // namespace

void FlowWalk::visitAccess(DifferentiableAccessInterface access) {
  Storage storage = access.getAccessedStorage();
  Value array = storage.memref;
  bool mayBeNonFinite = array && flow.nonFinite.contains(array);
  if (hasTangent(storage) || (array && flow.varied.contains(array)))
    for (Value result : access->getResults())
      mark(result, mayBeNonFinite);
  if (access.getAccessKind() != AccessKind::Read && array)
    pass(access.getAccessedValue(), array);
}

void FlowWalk::visitBranch(RegionBranchOpInterface op) {
  forEachForwarding(op, [&](OperandRange operands, ValueRange inputs) {
    pass(operands, inputs);
  });
}

void FlowWalk::visit(Operation *op) {
  if (auto access = dyn_cast<DifferentiableAccessInterface>(op))
    return visitAccess(access);
  if (auto load = dyn_cast<LocalLoadOp>(op))
    return pass(load.getLocal(), load.getValue());
  if (auto store = dyn_cast<LocalStoreOp>(op))
    return pass(store.getValue(), store.getLocal());
  if (auto pop = dyn_cast<StackPopOp>(op))
    return pass(pop.getStack(), pop.getValue());
  if (auto push = dyn_cast<StackPushOp>(op))
    return pass(push.getValue(), push.getStack());
  if (auto parallel = dyn_cast<scf::ParallelOp>(op)) {
    pass(parallel.getInitVals(), parallel.getResults());
    pass(parallel.getBody()->getTerminator()->getOperands(),
         parallel.getResults());
    return;
  }
  if (auto branch = dyn_cast<RegionBranchOpInterface>(op))
    return visitBranch(branch);
  if (op->hasTrait<OpTrait::IsTerminator>())
    return;
  bool isVaried = false, mayBeNonFinite = false, usesNonFinite = false;
  for (OpOperand &operand : op->getOpOperands()) {
    Value value = operand.get();
    usesNonFinite |= facts.mayBeNonFinite(value);
    // An operand can also be an array: a view passes on the array's tangents.
    if (!flow.varied.contains(value) || !carriesDerivative(operand))
      continue;
    isVaried = true;
    mayBeNonFinite |= flow.nonFinite.contains(value);
  }
  if (!isVaried)
    return;
  mayBeNonFinite =
      mayBeNonFinite || usesNonFinite || mayHaveNonFinitePartial(op, facts);
  for (Value result : op->getResults())
    mark(result, mayBeNonFinite);
}

TangentFlow::TangentFlow(FunctionOpInterface function, FloatFacts &facts,
                         function_ref<bool(Storage)> hasTangent) {
  FlowWalk walk(*this, facts, hasTangent);
  for (BlockArgument argument : function.getArguments())
    if (isa<MemRefType>(argument.getType()) && hasTangent(Storage(argument)))
      varied.insert(argument);
  while (walk.run(function))
    ;
}
