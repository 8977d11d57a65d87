//===- StoredOutputs.cpp - Values that a kernel leaves in fields ----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "StoredOutputs.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/Interfaces/CallInterfaces.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/Cost.h"
#include "tai/Dialect/Tai/IR/Layout.h"

using namespace mlir;
using namespace mlir::tai;

/// The nanoseconds of work that a load must save: a function of the math
/// library, or a long sum. A smaller saving is negligible on a CPU, and less
/// than the cost of the memory traffic on a GPU.
constexpr double kWorthLoading = 8;

//===----------------------------------------------------------------------===//
// Values in fields
//===----------------------------------------------------------------------===//

/// True for values that the adjoint can compute at the start of any mirror of
/// their block: arguments of the function, induction variables, and arithmetic
/// on these.
static bool isPlainIndex(Value value, unsigned depth = 16) {
  if (auto argument = dyn_cast<BlockArgument>(value)) {
    Operation *parent = argument.getOwner()->getParentOp();
    if (auto loop = dyn_cast<scf::ForOp>(parent))
      return argument == loop.getInductionVar();
    return isa<FunctionOpInterface, ParallelForOp>(parent);
  }
  Operation *op = value.getDefiningOp();
  return depth != 0 && op->getNumRegions() == 0 && isMemoryEffectFree(op) &&
         llvm::all_of(op->getOperands(), [&](Value operand) {
           return isPlainIndex(operand, depth - 1);
         });
}

/// True if the element still holds the value that `store` has stored when the
/// kernel ends, whatever other iterations do.
static bool holdsAfterwards(StoreOp store, const AccessTable &accesses) {
  // A store to a sparse field may find its cell inactive.
  FieldLayout layout =
      *getFieldLayout(lookupField(store, store.getFieldAttr()));
  if (layout.path.getFirstSparse())
    return false;
  // Stores to gradients are not reused, because a tape does not track writes to
  // them.
  for (FieldOp other : store->getParentOfType<ModuleOp>().getOps<FieldOp>())
    if (other.getAdjointAttr() == store.getFieldAttr())
      return false;
  auto access = cast<DifferentiableAccessInterface>(store.getOperation());
  if (accesses.findLaterWrite(access))
    return false;
  // If several iterations write the element, it is unknown which value remains.
  Operation *loop = getOutermostParallelLoop(store);
  if (!loop)
    return true;
  SmallVector<Operation *> writes;
  for (DifferentiableAccessInterface other :
       accesses.getStorages().find(getStorageKey(store))->second)
    if (other.getAccessKind() != AccessKind::Read &&
        loop->isProperAncestor(other))
      writes.push_back(other);
  return isExclusive(writes);
}

StoredOutputs::StoredOutputs(FunctionOpInterface function,
                             const AccessTable &accesses) {
  // The effects of a function that was not inlined are not known.
  if (!isa<KernelOp>(function.getOperation()) ||
      function->walk([](CallOpInterface) { return WalkResult::interrupt(); })
          .wasInterrupted())
    return;
  function->walk([&](StoreOp store) {
    auto isPlain = [](Value index) { return isPlainIndex(index); };
    Value stored = store.getValue();
    Operation *maker = stored.getDefiningOp();
    if (!maker || !isFloatOrVector(stored.getType()) ||
        !llvm::all_of(store.getIndices(), isPlain) ||
        !llvm::all_of(store.getComponents(), isPlain) ||
        !holdsAfterwards(store, accesses))
      return;
    // Only values from the block of the store are certain to be stored. Results
    // of loops are not loaded: a loop that is recomputed for one of its results
    // is recomputed for all of them.
    auto add = [&](Value value, int64_t component) {
      Operation *op = value.getDefiningOp();
      if (op && op->getBlock() == store->getBlock() && !isa<LoadOp>(op) &&
          op->getNumRegions() == 0 && !op->hasTrait<OpTrait::ConstantLike>())
        places.try_emplace(value, Place{store, component});
    };
    add(stored, -1);
    if (auto elements = dyn_cast<vector::FromElementsOp>(maker))
      for (auto [i, element] : llvm::enumerate(elements.getElements()))
        add(element, static_cast<int64_t>(i));
  });
}

//===----------------------------------------------------------------------===//
// Loading stored values
//===----------------------------------------------------------------------===//

/// True if computing `value` in the frame takes longer than loading it.
static bool isDear(Frame &frame, Value value) {
  double cost = 0;
  DenseSet<Operation *> seen;
  SmallVector<Value> pending = {value};
  while (!pending.empty()) {
    Value next = pending.pop_back_val();
    Operation *op = next.getDefiningOp();
    if (!op || op->getBlock() != frame.primal || frame.values.contains(next) ||
        !seen.insert(op).second)
      continue;
    if (!isa<LoadOp>(op))
      cost += estimateNanoseconds(op);
    if (cost >= kWorthLoading)
      return true;
    llvm::append_range(pending, op->getOperands());
  }
  return false;
}

Value StoredOutputs::load(AdjointBuilder &b, Frame &frame, Value value) {
  const Place *place = find(value);
  if (!place)
    return {};
  StoreOp store = place->store;
  if (b.getPlan().accumulated.contains(
          store.getFieldAttr().getAsOpaquePointer()) ||
      !isDear(frame, value))
    return {};
  used.insert(store);
  OpBuilder::InsertionGuard guard(b);
  Location loc = b.getLoc();
  auto scope = b.enter(frame);
  b.setInsertionPoint(frame.recomputeBegin);
  b.setLoc(store.getLoc());
  // The indices of the load are computed at the start of the mirror, by copies
  // of their ops: the values that the sweep recomputes possibly come after the
  // load.
  DenseMap<Value, Value> copies;
  std::function<Value(Value)> copy = [&](Value index) -> Value {
    Operation *op = index.getDefiningOp();
    if (!op)
      return b.getPrimal(index);
    if (Value known = copies.lookup(index))
      return known;
    IRMapping mapping;
    for (Value operand : op->getOperands())
      mapping.map(operand, copy(operand));
    Operation *made = b.insert(op->clone(mapping));
    for (auto [from, to] : llvm::zip(op->getResults(), made->getResults()))
      copies[from] = to;
    return copies[index];
  };
  SmallVector<Value> indices = llvm::map_to_vector(store.getIndices(), copy);
  SmallVector<Value> components =
      llvm::map_to_vector(store.getComponents(), copy);
  if (place->component >= 0) {
    int64_t rest = place->component;
    auto type = cast<VectorType>(store.getValue().getType());
    for (int64_t extent : llvm::reverse(type.getShape())) {
      components.insert(components.begin(),
                        arith::ConstantIndexOp::create(b, rest % extent));
      rest /= extent;
    }
  }
  Value loaded = LoadOp::create(b, value.getType(), store.getFieldAttr(),
                                indices, components);
  b.setLoc(loc);
  return loaded;
}
