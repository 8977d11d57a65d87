//===- Activity.cpp - Values that carry derivatives -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Two worklists over the uses and definitions of values: forward from reads,
// backward from writes. Values cross regions along the edges that
// RegionBranchOpInterface reports; where it reports none, every float operand
// is assumed to reach every result.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Activity.h"
#include "mlir/Interfaces/ControlFlowInterfaces.h"
#include "tai/Analysis/DerivativePaths.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// The edges along which ops with regions forward values: from an operand of
/// the op or of a terminator to an argument of a region or a result.
struct RegionEdges {
  DenseMap<OpOperand *, SmallVector<Value, 2>> targets;
  DenseMap<Value, SmallVector<Value, 2>> sources;

  void add(OperandRange operands, ValueRange inputs) {
    MutableArrayRef<OpOperand> uses;
    if (!operands.empty()) {
      OpOperand *first = operands.getBase();
      uses = MutableArrayRef<OpOperand>(first, operands.size());
    }
    for (auto [use, input] : llvm::zip(uses, inputs)) {
      targets[&use].push_back(input);
      sources[input].push_back(use.get());
    }
  }
};
} // namespace

void mlir::tai::forEachForwarding(
    RegionBranchOpInterface op,
    llvm::function_ref<void(OperandRange, ValueRange)> pass) {
  SmallVector<RegionSuccessor> successors;
  op.getSuccessorRegions(RegionBranchPoint::parent(), successors);
  for (RegionSuccessor &successor : successors)
    pass(op.getEntrySuccessorOperands(successor),
         successor.getSuccessorInputs());
  for (Region &region : op->getRegions())
    for (Block &block : region) {
      auto terminator =
          dyn_cast<RegionBranchTerminatorOpInterface>(block.back());
      if (!terminator)
        continue;
      successors.clear();
      op.getSuccessorRegions(RegionBranchPoint(terminator), successors);
      for (RegionSuccessor &successor : successors)
        pass(terminator.getSuccessorOperands(successor),
             successor.getSuccessorInputs());
    }
}

/// True if the edges that regions define say where the operands of `op` go:
/// `op` has regions, or is the terminator of one.
static bool passesThroughRegions(Operation *op) {
  return op->getNumRegions() != 0 || op->hasTrait<OpTrait::IsTerminator>();
}

Activity::Activity(FunctionOpInterface function,
                   llvm::function_ref<bool(Storage)> hasAdjoint,
                   ArrayRef<Value> inputs, ArrayRef<Value> outputs,
                   bool assumeVaried) {
  RegionEdges edges;
  SmallVector<DifferentiableAccessInterface> reads, writes;
  function.walk([&](Operation *op) {
    if (auto access = dyn_cast<DifferentiableAccessInterface>(op)) {
      if (isFloatOrVector(access.getAccessedValue().getType()) &&
          hasAdjoint(access.getAccessedStorage()))
        (access.getAccessKind() == AccessKind::Read ? reads : writes)
            .push_back(access);
    } else if (auto branch = dyn_cast<RegionBranchOpInterface>(op)) {
      forEachForwarding(branch, [&](OperandRange operands, ValueRange inputs) {
        edges.add(operands, inputs);
      });
    }
  });

  SmallVector<Value> worklist;
  auto markVaried = [&](Value value) {
    if (varied.insert(value).second)
      worklist.push_back(value);
  };
  llvm::for_each(inputs, markVaried);
  for (DifferentiableAccessInterface read : reads)
    markVaried(read.getAccessedValue());
  // The result of a read-modify-write is the value that it reads.
  for (DifferentiableAccessInterface write : writes)
    for (Value result : write->getResults())
      markVaried(result);
  while (!worklist.empty()) {
    Value value = worklist.pop_back_val();
    for (OpOperand &use : value.getUses()) {
      Operation *user = use.getOwner();
      if (isa<DifferentiableAccessInterface>(user))
        continue;
      if (auto it = edges.targets.find(&use); it != edges.targets.end()) {
        llvm::for_each(it->second, markVaried);
        continue;
      }
      if (!passesThroughRegions(user)) {
        if (carriesDerivative(use))
          llvm::for_each(user->getResults(), markVaried);
      } else if (isFloatOrVector(value.getType())) {
        // No edge says where this float goes, and it is neither a condition nor
        // a bound: assume that it reaches every result of the op.
        bool isEnd = user->hasTrait<OpTrait::IsTerminator>();
        Operation *op = isEnd ? user->getParentOp() : user;
        llvm::for_each(op->getResults(), markVaried);
      }
    }
  }

  auto markUseful = [&](Value value) {
    if (useful.insert(value).second)
      worklist.push_back(value);
  };
  auto markFloatsUseful = [&](Operation *op) {
    for (Value operand : op->getOperands())
      if (isFloatOrVector(operand.getType()))
        markUseful(operand);
  };
  llvm::for_each(outputs, markUseful);
  for (DifferentiableAccessInterface write : writes) {
    markUseful(write.getAccessedValue());
    // The result of a multiplicative or extreme update depends on the old
    // element too.
    if (assumeVaried || varied.contains(write.getAccessedValue()) ||
        write.getAccessKind() == AccessKind::Update)
      activeAccesses.insert(write);
  }
  while (!worklist.empty()) {
    Value value = worklist.pop_back_val();
    if (auto it = edges.sources.find(value); it != edges.sources.end()) {
      llvm::for_each(it->second, markUseful);
      continue;
    }
    Operation *op = value.getDefiningOp();
    if (!op || isa<DifferentiableAccessInterface>(op))
      continue;
    if (op->getNumRegions() != 0) {
      markFloatsUseful(op);
      for (Region &region : op->getRegions())
        for (Block &block : region)
          if (!block.empty())
            markFloatsUseful(&block.back());
      continue;
    }
    for (OpOperand &operand : op->getOpOperands())
      if (carriesDerivative(operand))
        markUseful(operand.get());
  }
  if (assumeVaried)
    for (Value value : useful) {
      Operation *op = value.getDefiningOp();
      if (isFloatOrVector(value.getType()) &&
          (op ? isa<DifferentiableOpInterface, RegionBranchOpInterface>(op)
              : edges.sources.contains(value)))
        assumed.insert(value);
    }
  for (DifferentiableAccessInterface read : reads)
    if (isActive(read.getAccessedValue()))
      activeAccesses.insert(read);

  for (Operation *access : activeAccesses)
    for (Operation *parent = access->getParentOp();
         parent && parent != function && holders.insert(parent).second;
         parent = parent->getParentOp())
      ;
}
