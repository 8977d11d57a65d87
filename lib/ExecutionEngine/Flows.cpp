//===- Flows.cpp - Which stored values depend on which that are read ------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A tape wants to know whether a value that it differentiates by gets lost in a
// field without gradient. So values are followed from each read of floats to
// each store of floats, through ops that carry derivatives, whether the fields
// have gradients or not.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/AccessOrder.h"
#include "tai/Analysis/Activity.h"
#include "tai/ExecutionEngine/Diagnostics.h"
#include "tai/ExecutionEngine/Session.h"
#include "llvm/ADT/SmallBitVector.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// For each value, the storages that it depends on.
class FlowFinder {
public:
  explicit FlowFinder(KernelOp kernel) {
    kernel.walk([&](Operation *op) {
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
    do {
      grown = false;
      kernel.walk([&](Operation *op) { visit(op); });
    } while (grown);
  }

  SmallVector<Storage> storages;
  SmallVector<DifferentiableAccessInterface> reads, writes;

  const llvm::SmallBitVector &sourcesOf(Value value) { return sources[value]; }

private:
  unsigned number(Storage storage) {
    auto *it = llvm::find(storages, storage);
    if (it == storages.end())
      it = storages.insert(it, storage);
    return static_cast<unsigned>(it - storages.begin());
  }
  void add(Value to, const llvm::SmallBitVector &more) {
    llvm::SmallBitVector &known = sources[to];
    known.resize(storages.size());
    grown |= more.test(known);
    known |= more;
  }
  void pass(Value from, Value to) {
    auto it = sources.find(from);
    if (it == sources.end() || it->second.none())
      return;
    add(to, llvm::SmallBitVector(it->second));
  }
  void visit(Operation *op);

  DenseMap<Value, llvm::SmallBitVector> sources;
  bool grown = false;
};
} // namespace

void FlowFinder::visit(Operation *op) {
  if (auto access = dyn_cast<DifferentiableAccessInterface>(op)) {
    for (Value result : op->getResults()) {
      if (!isFloatOrVector(result.getType()))
        continue;
      llvm::SmallBitVector own(storages.size());
      own.set(number(access.getAccessedStorage()));
      add(result, own);
    }
    return;
  }
  if (auto load = dyn_cast<LocalLoadOp>(op))
    return pass(load.getLocal(), load.getValue());
  if (auto store = dyn_cast<LocalStoreOp>(op))
    return pass(store.getValue(), store.getLocal());
  if (auto branch = dyn_cast<RegionBranchOpInterface>(op))
    return forEachHandover(branch, [&](OperandRange from, ValueRange to) {
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

std::vector<runtime::ValueFlow>
mlir::tai::findFlows(KernelOp kernel, ArrayRef<runtime::Access> summary) {
  FlowFinder finder(kernel);
  auto findField = [&](Storage storage) {
    if (storage.field)
      for (const runtime::Access &access : summary)
        if (access.field->name() == storage.field.getValue())
          return access.field;
    return runtime::FieldPtr();
  };
  std::vector<runtime::ValueFlow> flows;
  for (DifferentiableAccessInterface write : finder.writes) {
    bool isReadAgain =
        llvm::any_of(finder.reads, [&](DifferentiableAccessInterface read) {
          return read.getAccessedStorage() == write.getAccessedStorage() &&
                 mayReachLater(write, read);
        });
    const llvm::SmallBitVector &sources =
        finder.sourcesOf(write.getAccessedValue());
    for (unsigned source : sources.set_bits()) {
      runtime::ValueFlow flow{findField(finder.storages[source]),
                              findField(write.getAccessedStorage()),
                              describePlace(write->getLoc()), isReadAgain};
      if (flow.from && flow.to)
        flows.push_back(std::move(flow));
    }
  }
  return flows;
}
