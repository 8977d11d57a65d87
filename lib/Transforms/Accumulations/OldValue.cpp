//===- OldValue.cpp - The value of an element before a store --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "OldValue.h"
#include "mlir/Dialect/SCF/IR/SCF.h"

using namespace mlir;
using namespace mlir::tai;

OldValue::OldValue(DifferentiableAccessInterface store, ParallelForOp loop,
                   ArrayRef<DifferentiableAccessInterface> reads,
                   const SameIteration &same)
    : store(store), loop(loop), same(same) {
  SmallVector<Value> worklist;
  auto add = [&](ValueRange values) {
    for (Value value : values)
      if (dependents.insert(value).second)
        worklist.push_back(value);
  };
  for (DifferentiableAccessInterface load : reads) {
    if (!same.areEqual(load.getAccessIndices(), store.getAccessIndices()))
      continue;
    ValueRange parts = load.getAccessComponents();
    if (parts.empty() || store.getAccessComponents().empty() ||
        same.areEqual(parts, store.getAccessComponents()))
      add(load->getResults());
  }
  while (!worklist.empty()) {
    Value value = worklist.pop_back_val();
    for (OpOperand &use : value.getUses()) {
      Operation *user = use.getOwner(), *parent = user->getParentOp();
      if (isa<scf::YieldOp>(user) && isa<scf::IfOp, scf::ForOp>(parent)) {
        add(parent->getResult(use.getOperandNumber()));
        if (auto serial = dyn_cast<scf::ForOp>(parent))
          add(serial.getRegionIterArg(use.getOperandNumber()));
        continue;
      }
      auto serial = dyn_cast<scf::ForOp>(user);
      if (serial && use.getOperandNumber() >= serial.getNumControlOperands()) {
        unsigned number =
            use.getOperandNumber() - serial.getNumControlOperands();
        add(serial.getResult(number));
        add(serial.getRegionIterArg(number));
        continue;
      }
      // The results of a branch depend on its condition, and the results of a
      // loop on the condition of each iteration.
      Operation *op = user->hasTrait<OpTrait::IsTerminator>() && parent != loop
                          ? parent
                          : user;
      add(op->getResults());
      if (isa<LoopLikeOpInterface>(op) && op != loop)
        for (Region &region : op->getRegions())
          for (Block &block : region)
            add(block.getArguments());
    }
  }
}

bool OldValue::isLoaded(Value value) const {
  auto load =
      dyn_cast_or_null<DifferentiableAccessInterface>(value.getDefiningOp());
  return load && load.getAccessKind() == AccessKind::Read &&
         loop->isAncestor(load) && same.reachSame(load, store);
}
