//===- ValueFlows.cpp - Dependence of values on loads ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/ValueFlows.h"
#include "tai/Analysis/Activity.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

ValueFlows::ValueFlows(FunctionOpInterface function,
                       ArrayRef<Value> arguments) {
  function.walk([&](Operation *op) {
    auto access = dyn_cast<DifferentiableAccessInterface>(op);
    if (access && isFloatOrVector(access.getAccessedValue().getType()))
      (access.getAccessKind() == AccessKind::Read ? reads : writes)
          .push_back(access);
  });
  for (DifferentiableAccessInterface read : reads)
    (void)number(read.getAccessedStorage());
  for (DifferentiableAccessInterface write : writes)
    if (!write->getResults().empty())
      (void)number(write.getAccessedStorage());
  for (Value argument : arguments)
    (void)number(argument);
  for (Value argument : arguments)
    addOwn(argument, argument);
  do {
    grown = false;
    function.walk([&](Operation *op) { visit(op); });
  } while (grown);
}

unsigned ValueFlows::number(Storage storage) {
  auto *it = llvm::find(storages, storage);
  if (it == storages.end())
    it = storages.insert(it, storage);
  return static_cast<unsigned>(it - storages.begin());
}

void ValueFlows::add(Value to, const llvm::SmallBitVector &more) {
  llvm::SmallBitVector &known = sources[to];
  known.resize(storages.size());
  grown |= more.test(known);
  known |= more;
}

void ValueFlows::addOwn(Value to, Storage storage) {
  llvm::SmallBitVector own(storages.size());
  own.set(number(storage));
  add(to, own);
}

void ValueFlows::pass(Value from, Value to) {
  auto it = sources.find(from);
  if (it == sources.end() || it->second.none())
    return;
  add(to, llvm::SmallBitVector(it->second));
}

void ValueFlows::visit(Operation *op) {
  if (auto access = dyn_cast<DifferentiableAccessInterface>(op)) {
    for (Value result : op->getResults())
      if (isFloatOrVector(result.getType()))
        addOwn(result, access.getAccessedStorage());
    return;
  }
  if (auto load = dyn_cast<LocalLoadOp>(op))
    return pass(load.getLocal(), load.getValue());
  if (auto store = dyn_cast<LocalStoreOp>(op))
    return pass(store.getValue(), store.getLocal());
  if (auto branch = dyn_cast<RegionBranchOpInterface>(op))
    return forEachForwarding(branch, [&](OperandRange from, ValueRange to) {
      for (auto [operand, input] : llvm::zip(from, to))
        pass(operand, input);
    });
  if (op->hasTrait<OpTrait::IsTerminator>())
    return;
  auto rule = dyn_cast<DifferentiableOpInterface>(op);
  for (OpOperand &operand : op->getOpOperands())
    if (isFloatOrVector(operand.get().getType()) &&
        (!rule || rule.carriesDerivative(operand)))
      for (Value result : op->getResults())
        if (isFloatOrVector(result.getType()))
          pass(operand.get(), result);
}
