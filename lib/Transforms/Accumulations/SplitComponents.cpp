//===- SplitComponents.cpp - Updates of components of a vector ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "SplitComponents.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/SharedElements.h"

using namespace mlir;
using namespace mlir::tai;

using Position = SmallVector<int64_t>;

/// The position in the vector of component number `i`, in row-major order.
static Position getPosition(VectorType type, int64_t i) {
  Position position(type.getRank());
  for (int64_t dim = type.getRank() - 1; dim >= 0; --dim) {
    position[dim] = i % type.getDimSize(dim);
    i /= type.getDimSize(dim);
  }
  return position;
}

static bool isScalarAt(vector::ExtractOp extract) {
  return !extract.hasDynamicPosition() &&
         !isa<VectorType>(extract.getResult().getType());
}

namespace {
/// A component of a stored vector.
struct Component {
  Position position;
  /// The new value of the component; null if the component keeps its value.
  Value value;
};

class ComponentSplitter {
public:
  explicit ComponentSplitter(ParallelForOp loop) : loop(loop), same(loop) {}
  void run();

private:
  bool find(Value vector, Component &component,
            llvm::function_ref<bool(Value)> isBase) const;
  Value findBase(Value vector, StoreOp store) const;
  void splitCarried(Value vector, StoreOp store);
  void splitBranches(OpResult vector, StoreOp store);
  void splitLoop(OpResult vector, StoreOp store);
  void split(StoreOp store);
  void split(LoadOp load);
  bool isOld(Value vector, StoreOp store) const;

  ParallelForOp loop;
  /// The carried vectors of the serial loops that are being split, as they are
  /// at the beginning of an iteration.
  llvm::SmallDenseSet<Value> begins;
  SameIteration same;
  llvm::DenseMap<const void *, unsigned> writes;
};
} // namespace

/// True if the vector is loaded from the same element that the store writes.
bool ComponentSplitter::isOld(Value vector, StoreOp store) const {
  auto load = vector.getDefiningOp<LoadOp>();
  return load && load.getFieldAttr() == store.getFieldAttr() &&
         load.getComponents().empty() &&
         same.areEqual(load.getIndices(), store.getIndices());
}

/// Finds the value of a component of a vector that insertions and lists of
/// elements build; null if the component is the one of the original vector.
/// False if another op has built the vector.
bool ComponentSplitter::find(Value vector, Component &component,
                             llvm::function_ref<bool(Value)> isBase) const {
  if (isBase(vector))
    return true;
  if (auto insert = vector.getDefiningOp<vector::InsertOp>()) {
    if (insert.hasDynamicPosition() ||
        isa<VectorType>(insert.getValueToStore().getType()))
      return false;
    if (insert.getStaticPosition() != ArrayRef(component.position))
      return find(insert.getDest(), component, isBase);
    component.value = insert.getValueToStore();
  } else if (auto elements = vector.getDefiningOp<vector::FromElementsOp>()) {
    auto type = cast<VectorType>(vector.getType());
    int64_t number = 0;
    for (auto [dim, at] : llvm::enumerate(component.position))
      number = number * type.getDimSize(dim) + at;
    component.value = elements.getElements()[number];
  } else {
    return false;
  }
  auto extract = component.value.getDefiningOp<vector::ExtractOp>();
  if (extract && isScalarAt(extract) &&
      extract.getStaticPosition() == ArrayRef(component.position) &&
      isBase(extract.getSource()))
    component.value = {};
  return true;
}

/// Skips insertions of components: returns the vector into which components
/// were inserted.
static Value skipInserts(Value vector) {
  while (auto insert = vector.getDefiningOp<vector::InsertOp>())
    vector = insert.getDest();
  return vector;
}

/// Returns the vector that insertions have changed: the loaded vector, or the
/// carried vector at the beginning of an iteration. Null for other vectors.
Value ComponentSplitter::findBase(Value vector, StoreOp store) const {
  vector = skipInserts(vector);
  return isOld(vector, store) || begins.contains(vector) ? vector : Value();
}

/// If branches or serial loops yield the vector, makes them yield the
/// components that they change.
void ComponentSplitter::splitCarried(Value vector, StoreOp store) {
  auto result = dyn_cast<OpResult>(skipInserts(vector));
  if (!result)
    return;
  if (isa<scf::IfOp>(result.getOwner()))
    splitBranches(result, store);
  else if (isa<scf::ForOp>(result.getOwner()))
    splitLoop(result, store);
}

/// Makes an scf.if yield those components that one of its sides changes. After
/// the scf.if, the components are inserted into the former vector.
void ComponentSplitter::splitBranches(OpResult vector, StoreOp store) {
  auto branches = cast<scf::IfOp>(vector.getOwner());
  unsigned number = vector.getResultNumber();
  scf::YieldOp yields[] = {branches.thenYield(), branches.elseYield()};
  // Nested ones first.
  for (scf::YieldOp yield : yields)
    splitCarried(yield.getOperand(number), store);
  Value old;
  for (scf::YieldOp yield : yields) {
    Value found = findBase(yield.getOperand(number), store);
    if (!found)
      continue;
    // An iteration of a serial loop may begin with a vector other than the
    // loaded one, in which case the branch is not split.
    if (old && old != found && (begins.contains(old) || begins.contains(found)))
      return;
    Operation *load = found.getDefiningOp();
    Operation *scope =
        load ? load->getBlock()->findAncestorOpInBlock(*branches) : nullptr;
    if (!load || (scope && load->isBeforeInBlock(scope)))
      old = found;
  }
  if (!old)
    return;
  auto isBase = [&](Value value) {
    return begins.contains(old) ? value == old : isOld(value, store);
  };
  auto type = cast<VectorType>(vector.getType());
  SmallVector<Component> before;
  SmallVector<std::pair<Component, Component>> changed;
  for (int64_t i = 0, e = type.getNumElements(); i != e; ++i) {
    Component then{getPosition(type, i), {}}, otherwise = then;
    if (!find(yields[0].getOperand(number), then, isBase) ||
        !find(yields[1].getOperand(number), otherwise, isBase))
      return;
    if (!then.value && !otherwise.value)
      continue;
    if (then.value == otherwise.value)
      before.push_back(std::move(then));
    else
      changed.emplace_back(std::move(then), std::move(otherwise));
  }
  for (size_t side : {0, 1}) {
    OpBuilder builder(yields[side]);
    MutableOperandRange operands = yields[side].getResultsMutable();
    operands.erase(number);
    for (auto &[then, otherwise] : changed) {
      const Component &component = side == 0 ? then : otherwise;
      Value value = component.value;
      if (!value)
        value = vector::ExtractOp::create(builder, branches.getLoc(), old,
                                          component.position);
      operands.append(value);
    }
  }
  OpBuilder builder(branches);
  SmallVector<Type> types(branches.getResultTypes());
  types.erase(types.begin() + number);
  types.append(changed.size(), type.getElementType());
  auto made = scf::IfOp::create(builder, branches.getLoc(), types,
                                branches.getCondition());
  made.getThenRegion().takeBody(branches.getThenRegion());
  made.getElseRegion().takeBody(branches.getElseRegion());
  made->setDiscardableAttrs(branches->getDiscardableAttrDictionary());
  Value result = old;
  for (const Component &component : before)
    result =
        vector::InsertOp::create(builder, branches.getLoc(), component.value,
                                 result, component.position);
  ValueRange scalars = made.getResults().take_back(changed.size());
  for (auto [components, scalar] : llvm::zip(changed, scalars))
    result = vector::InsertOp::create(builder, branches.getLoc(), scalar,
                                      result, components.first.position);
  vector.replaceAllUsesWith(result);
  for (auto [index, former] : llvm::enumerate(branches.getResults()))
    if (index != number)
      former.replaceAllUsesWith(
          made.getResult(index < number ? index : index - 1));
  branches.erase();
}

/// Makes a serial loop carry those components that an iteration changes. Inside
/// of the loop and after it, the components are inserted into the former
/// vector.
void ComponentSplitter::splitLoop(OpResult vector, StoreOp store) {
  auto serial = cast<scf::ForOp>(vector.getOwner());
  unsigned number = vector.getResultNumber();
  splitCarried(serial.getInitArgs()[number], store);
  Value former = serial.getInitArgs()[number];
  if (!findBase(former, store))
    return;
  Value begin = serial.getRegionIterArg(number);
  begins.insert(begin);
  splitCarried(serial.getYieldedValues()[number], store);
  begins.erase(begin);
  Value yielded = serial.getYieldedValues()[number];
  auto type = cast<VectorType>(vector.getType());
  SmallVector<Component> changed;
  for (int64_t i = 0, e = type.getNumElements(); i != e; ++i) {
    Component component{getPosition(type, i), {}};
    if (!find(yielded, component, [&](Value value) { return value == begin; }))
      return;
    if (component.value)
      changed.push_back(std::move(component));
  }
  Location loc = serial.getLoc();
  IRRewriter rewriter(serial);
  SmallVector<Value> inits;
  for (const Component &component : changed)
    inits.push_back(
        vector::ExtractOp::create(rewriter, loc, former, component.position));
  auto insertAll = [&](ValueRange values) {
    Value result = former;
    for (auto [component, value] : llvm::zip(changed, values))
      result = vector::InsertOp::create(rewriter, loc, value, result,
                                        component.position);
    return result;
  };
  auto yieldAll = [&](OpBuilder &, Location, ArrayRef<BlockArgument>) {
    return llvm::map_to_vector(
        changed, [](const Component &component) { return component.value; });
  };
  auto made = cast<scf::ForOp>(*serial.replaceWithAdditionalYields(
      rewriter, inits, /*replaceInitOperandUsesInLoop=*/false, yieldAll));
  rewriter.setInsertionPointToStart(made.getBody());
  BlockArgument carried = made.getRegionIterArg(number);
  carried.replaceAllUsesWith(
      insertAll(made.getRegionIterArgs().take_back(changed.size())));
  rewriter.setInsertionPointAfter(made);
  made.getResult(number).replaceAllUsesWith(
      insertAll(made.getResults().take_back(changed.size())));
  // The loop still carries the vector, which has no use any more. The vector
  // now begins with zero, which reads no element.
  made.getBody()->getTerminator()->setOperand(number, carried);
  rewriter.setInsertionPoint(made);
  made.getInitArgsMutable()[number].assign(arith::ConstantOp::create(
      rewriter, loc, type, rewriter.getZeroAttr(type)));
}

static SmallVector<Value> makeIndices(OpBuilder &builder, Location loc,
                                      ArrayRef<int64_t> position) {
  return llvm::map_to_vector(position, [&](int64_t at) -> Value {
    return arith::ConstantIndexOp::create(builder, loc, at);
  });
}

/// Makes `extract` read the vector as it was before the insertions of other
/// components.
static void lookThroughInserts(vector::ExtractOp extract) {
  while (auto insert = extract.getSource().getDefiningOp<vector::InsertOp>()) {
    if (insert.hasDynamicPosition() ||
        isa<VectorType>(insert.getValueToStore().getType()))
      return;
    if (insert.getStaticPosition() == extract.getStaticPosition()) {
      extract.replaceAllUsesWith(insert.getValueToStore());
      extract.erase();
      return;
    }
    extract.getSourceMutable().set(insert.getDest());
  }
}

void ComponentSplitter::split(StoreOp store) {
  auto type = cast<VectorType>(store.getValue().getType());
  SmallVector<Component> components;
  for (int64_t i = 0, e = type.getNumElements(); i != e; ++i) {
    Component component{getPosition(type, i), {}};
    if (!find(store.getValue(), component,
              [&](Value value) { return isOld(value, store); }))
      return;
    if (component.value)
      components.push_back(std::move(component));
  }
  // If components keep their value, the store of the whole vector also
  // overwrites other writes to these components.
  if (writes.lookup(getStorageKey(store)) != 1 &&
      static_cast<int64_t>(components.size()) != type.getNumElements())
    return;
  OpBuilder builder(store);
  Location loc = store.getLoc();
  for (const Component &component : components)
    StoreOp::create(builder, loc, component.value, store.getFieldAttr(),
                    store.getIndices(),
                    makeIndices(builder, loc, component.position));
  store.erase();
}

void ComponentSplitter::split(LoadOp load) {
  for (Operation *user : llvm::make_early_inc_range(load->getUsers())) {
    auto extract = dyn_cast<vector::ExtractOp>(user);
    if (!extract || !isScalarAt(extract))
      continue;
    OpBuilder builder(load->getContext());
    builder.setInsertionPointAfter(load);
    Location loc = load.getLoc();
    Value part = LoadOp::create(
        builder, loc, extract.getType(), load.getFieldAttr(), load.getIndices(),
        makeIndices(builder, loc, extract.getStaticPosition()));
    extract.replaceAllUsesWith(part);
    extract.erase();
  }
}

void ComponentSplitter::run() {
  SmallVector<LoadOp> loads;
  SmallVector<StoreOp> stores;
  loop.walk([&](DifferentiableAccessInterface access) {
    if (access.getAccessKind() != AccessKind::Read)
      ++writes[getStorageKey(access)];
    Operation *op = access;
    if (auto load = dyn_cast<LoadOp>(op); load && load.getComponents().empty())
      loads.push_back(load);
    if (auto store = dyn_cast<StoreOp>(op))
      stores.push_back(store);
  });
  auto isOfVector = [](LoadOp load) {
    return isa<VectorType>(load.getResult().getType());
  };
  llvm::erase_if(loads, [&](LoadOp load) { return !isOfVector(load); });
  if (loads.empty())
    return;
  SmallVector<LoadOp> old;
  for (StoreOp store : stores) {
    auto access = cast<DifferentiableAccessInterface>(store.getOperation());
    if (getSharing(access, loop) == Sharing::Own)
      continue;
    bool reads = false;
    for (LoadOp load : loads)
      if (isOld(load.getResult(), store)) {
        reads = true;
        if (!llvm::is_contained(old, load))
          old.push_back(load);
      }
    if (!reads)
      continue;
    if (isa<VectorType>(store.getValue().getType()))
      splitCarried(store.getValue(), store);
    SmallVector<vector::ExtractOp> extracts;
    loop.walk([&](vector::ExtractOp extract) {
      if (isScalarAt(extract))
        extracts.push_back(extract);
    });
    llvm::for_each(extracts, lookThroughInserts);
    if (isa<VectorType>(store.getValue().getType()))
      split(store);
  }
  for (LoadOp load : old)
    split(load);
  // Unused loads and vectors are erased, because they would count as reads of
  // the element.
  bool changed = !old.empty();
  while (changed) {
    changed = false;
    loop.walk([&](Operation *op) {
      if (!isa<vector::InsertOp, vector::FromElementsOp, vector::ExtractOp,
               LoadOp>(op) ||
          !op->use_empty())
        return;
      op->erase();
      changed = true;
    });
  }
}

void mlir::tai::splitComponents(ParallelForOp loop) {
  ComponentSplitter(loop).run();
}
