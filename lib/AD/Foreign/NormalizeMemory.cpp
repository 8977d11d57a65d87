//===- NormalizeMemory.cpp - Views, copies and chosen arrays --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The adjoint of an array is another array, found by the array's SSA value. So
// each access of a view becomes an access of the array that was allocated or
// passed. Loops and branches carry a number in place of an array, and an access
// of such an array becomes a branch over the possible arrays, decided by the
// number.
//
//===----------------------------------------------------------------------===//

#include "ByteViews.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/IR/Dominance.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "tai/AD/Foreign/Foreign.h"
#include "tai/Analysis/HelpfulPasses.h"
#include "llvm/ADT/MapVector.h"
#include "llvm/ADT/SetVector.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// The memref operand of an op that accesses one element of a memref; null for
/// other ops.
OpOperand *getArray(Operation *op) {
  if (isa<memref::LoadOp>(op))
    return &op->getOpOperand(0);
  if (isa<memref::StoreOp, memref::AtomicRMWOp>(op))
    return &op->getOpOperand(1);
  return nullptr;
}

MutableOperandRange getIndices(Operation *op) {
  if (auto load = dyn_cast<memref::LoadOp>(op))
    return load.getIndicesMutable();
  if (auto store = dyn_cast<memref::StoreOp>(op))
    return store.getIndicesMutable();
  return cast<memref::AtomicRMWOp>(op).getIndicesMutable();
}

bool isView(Operation *op) {
  if (auto view = dyn_cast_if_present<memref::ReshapeOp>(op)) {
    auto type = dyn_cast<MemRefType>(view.getType());
    return type && type.hasStaticShape();
  }
  return isa_and_present<memref::CastOp, memref::SubViewOp,
                         memref::ExpandShapeOp, memref::CollapseShapeOp,
                         memref::TransposeOp, memref::ReinterpretCastOp,
                         memref::AssumeAlignmentOp, memref::MemorySpaceCastOp>(
      op);
}

/// Emits sizes of arrays and indices of their elements before an op.
class Elements {
public:
  explicit Elements(Operation *before)
      : b(before->getLoc(), OpBuilder(before).getContext()) {
    b.setInsertionPoint(before);
  }

  Value toValue(OpFoldResult value) {
    return getValueOrCreateConstantIndexOp(b, b.getLoc(), value);
  }
  Value add(Value lhs, Value rhs) {
    return b.createOrFold<arith::AddIOp>(lhs, rhs);
  }
  Value multiply(Value lhs, Value rhs) {
    return b.createOrFold<arith::MulIOp>(lhs, rhs);
  }
  /// The size of dimension `dim` of an array, taken from the op that makes the
  /// array.
  Value getSize(Value array, int64_t dim);
  SmallVector<Value> getSizes(Value array) {
    SmallVector<Value> sizes;
    for (int64_t i = 0; i != cast<MemRefType>(array.getType()).getRank(); ++i)
      sizes.push_back(getSize(array, i));
    return sizes;
  }
  /// Rewrites an access of a view to an access of the view's source. Fails for
  /// an unsupported view.
  LogicalResult step(Value &array, SmallVector<Value> &indices);

private:
  Value linearize(ArrayRef<Value> indices, ArrayRef<Value> sizes) {
    Value sum = toValue(b.getIndexAttr(0));
    for (auto [index, size] : llvm::zip(indices, sizes))
      sum = add(multiply(sum, size), index);
    return sum;
  }
  void delinearize(Value number, ArrayRef<Value> sizes,
                   SmallVectorImpl<Value> &indices) {
    size_t first = indices.size();
    indices.resize(first + sizes.size());
    for (size_t i = sizes.size(); i-- > 1;) {
      indices[first + i] = b.createOrFold<arith::RemUIOp>(number, sizes[i]);
      number = b.createOrFold<arith::DivUIOp>(number, sizes[i]);
    }
    if (!sizes.empty())
      indices[first] = number;
  }

  ImplicitLocOpBuilder b;
};
} // namespace

Value Elements::getSize(Value array, int64_t dim) {
  auto type = cast<MemRefType>(array.getType());
  if (!type.isDynamicDim(dim))
    return toValue(b.getIndexAttr(type.getDimSize(dim)));
  Operation *op = array.getDefiningOp();
  if (isa_and_present<memref::AllocOp, memref::AllocaOp>(op))
    return op->getOperand(type.getDynamicDimIndex(dim));
  if (isa_and_present<memref::CastOp, memref::MemorySpaceCastOp,
                      memref::AssumeAlignmentOp>(op) &&
      isa<MemRefType>(op->getOperand(0).getType()))
    return getSize(op->getOperand(0), dim);
  if (auto view = dyn_cast_if_present<memref::SubViewOp>(op)) {
    llvm::SmallBitVector dropped = view.getDroppedDims();
    for (auto [i, size] : llvm::enumerate(view.getMixedSizes()))
      if (!dropped.test(i) && dim-- == 0)
        return toValue(size);
  }
  if (auto view = dyn_cast_if_present<memref::ReinterpretCastOp>(op))
    return toValue(view.getMixedSizes()[dim]);
  if (auto view = dyn_cast_if_present<memref::ExpandShapeOp>(op))
    return toValue(view.getMixedOutputShape()[dim]);
  if (auto view = dyn_cast_if_present<memref::TransposeOp>(op))
    return getSize(view.getIn(), view.getPermutation().getDimPosition(dim));
  if (auto view = dyn_cast_if_present<memref::CollapseShapeOp>(op)) {
    Value product = toValue(b.getIndexAttr(1));
    for (int64_t i : view.getReassociationIndices()[dim])
      product = multiply(product, getSize(view.getSrc(), i));
    return product;
  }
  return memref::DimOp::create(b, array, dim);
}

LogicalResult Elements::step(Value &array, SmallVector<Value> &indices) {
  Operation *op = array.getDefiningOp();
  Value source = op->getOperand(0);
  SmallVector<Value> moved;
  if (isa<memref::CastOp, memref::MemorySpaceCastOp, memref::AssumeAlignmentOp>(
          op)) {
    if (!isa<MemRefType>(source.getType()))
      return failure();
    moved = indices;
  } else if (auto view = dyn_cast<memref::SubViewOp>(op)) {
    llvm::SmallBitVector dropped = view.getDroppedDims();
    size_t next = 0;
    for (auto [i, offset, stride] :
         llvm::enumerate(view.getMixedOffsets(), view.getMixedStrides())) {
      Value index = toValue(offset);
      if (!dropped.test(i))
        index = add(index, multiply(indices[next++], toValue(stride)));
      moved.push_back(index);
    }
  } else if (auto view = dyn_cast<memref::ExpandShapeOp>(op)) {
    for (ReassociationIndices group : view.getReassociationIndices()) {
      SmallVector<Value> parts, sizes;
      for (int64_t i : group) {
        parts.push_back(indices[i]);
        sizes.push_back(toValue(view.getMixedOutputShape()[i]));
      }
      moved.push_back(linearize(parts, sizes));
    }
  } else if (auto view = dyn_cast<memref::CollapseShapeOp>(op)) {
    for (auto [i, group] : llvm::enumerate(view.getReassociationIndices())) {
      SmallVector<Value> sizes;
      for (int64_t dim : group)
        sizes.push_back(getSize(source, dim));
      delinearize(indices[i], sizes, moved);
    }
    // A view without reassociation groups has one element, at index 0 in all
    // dimensions of the source.
    if (view.getReassociationIndices().empty())
      moved.resize(cast<MemRefType>(source.getType()).getRank(),
                   toValue(b.getIndexAttr(0)));
  } else if (isa<memref::ReshapeOp>(op)) {
    auto type = dyn_cast<MemRefType>(source.getType());
    if (!type || !type.getLayout().isIdentity())
      return failure();
    delinearize(linearize(indices, getSizes(array)), getSizes(source), moved);
  } else if (auto view = dyn_cast<memref::TransposeOp>(op)) {
    moved.resize(indices.size());
    for (auto [i, index] : llvm::enumerate(indices))
      moved[view.getPermutation().getDimPosition(i)] = index;
  } else {
    // The offset of a memref.reinterpret_cast counts from the start of the
    // underlying allocation, not from the view that is its operand.
    auto cast_ = cast<memref::ReinterpretCastOp>(op);
    while (isView(source.getDefiningOp()))
      source = source.getDefiningOp()->getOperand(0);
    auto type = dyn_cast<MemRefType>(source.getType());
    Operation *maker = source.getDefiningOp();
    if (!type || !type.getLayout().isIdentity() ||
        (maker &&
         !isa<memref::AllocOp, memref::AllocaOp, memref::GetGlobalOp>(maker)))
      return failure();
    Value number = toValue(cast_.getMixedOffsets().front());
    for (auto [index, stride] : llvm::zip(indices, cast_.getMixedStrides()))
      number = add(number, multiply(index, toValue(stride)));
    delinearize(number, getSizes(source), moved);
  }
  array = source;
  indices = moved;
  return success();
}

//===----------------------------------------------------------------------===//
// Copies
//===----------------------------------------------------------------------===//

static LogicalResult expandCopies(func::FuncOp function) {
  SmallVector<memref::CopyOp> copies;
  function.walk([&](memref::CopyOp copy) { copies.push_back(copy); });
  for (memref::CopyOp copy : copies) {
    Value source = copy.getSource(), target = copy.getTarget();
    if (!isa<MemRefType>(source.getType()) ||
        !isa<MemRefType>(target.getType()))
      return copy.emitError("cannot differentiate a copy of an array whose "
                            "rank is not known");
    Elements elements(copy);
    SmallVector<Value> sizes = elements.getSizes(source);
    OpBuilder b(copy);
    Value zero = arith::ConstantIndexOp::create(b, copy.getLoc(), 0);
    Value one = arith::ConstantIndexOp::create(b, copy.getLoc(), 1);
    SmallVector<Value> lower(sizes.size(), zero), steps(sizes.size(), one);
    scf::buildLoopNest(
        b, copy.getLoc(), lower, sizes, steps,
        [&](OpBuilder &nested, Location loc, ValueRange ivs) {
          Value value = memref::LoadOp::create(nested, loc, source, ivs);
          memref::StoreOp::create(nested, loc, value, target, ivs);
        });
    copy.erase();
  }
  return success();
}

//===----------------------------------------------------------------------===//
// Updates
//===----------------------------------------------------------------------===//

void mlir::tai::serialize(scf::ParallelOp loop) {
  ImplicitLocOpBuilder b(loop.getLoc(), loop);
  auto reduce = cast<scf::ReduceOp>(loop.getBody()->getTerminator());
  scf::LoopNest nest = scf::buildLoopNest(
      b, loop.getLoc(), loop.getLowerBound(), loop.getUpperBound(),
      loop.getStep(), loop.getInitVals(),
      [&](OpBuilder &nested, Location, ValueRange ivs, ValueRange sums) {
        // The ops of the body are moved, not copied, so that pointers to them
        // stay valid.
        for (auto [from, to] : llvm::zip(loop.getInductionVars(), ivs))
          from.replaceAllUsesWith(to);
        Block *body = nested.getInsertionBlock();
        body->getOperations().splice(
            nested.getInsertionPoint(), loop.getBody()->getOperations(),
            loop.getBody()->begin(), reduce->getIterator());
        scf::ValueVector next;
        for (auto [i, operand] : llvm::enumerate(reduce.getOperands())) {
          Block &combine = reduce.getReductions()[i].front();
          IRMapping mapping;
          mapping.map(combine.getArgument(0), sums[i]);
          mapping.map(combine.getArgument(1), operand);
          for (Operation &op : combine.without_terminator())
            nested.clone(op, mapping);
          next.push_back(
              mapping.lookupOrDefault(combine.getTerminator()->getOperand(0)));
        }
        return next;
      });
  loop->replaceAllUsesWith(nest.results);
  loop.erase();
}

/// An update of an element whose order matters becomes a load, an operation and
/// a store; the parallel loops around such an update become serial.
static void expandUpdates(func::FuncOp function) {
  auto isSimple = [](Operation *op) {
    auto atomic = dyn_cast<memref::AtomicRMWOp>(op);
    return atomic && atomic.getKind() == arith::AtomicRMWKind::addf &&
           atomic.getResult().use_empty();
  };
  SmallVector<scf::ParallelOp> loops;
  function.walk<WalkOrder::PreOrder>([&](scf::ParallelOp loop) {
    WalkResult found = loop.walk([&](Operation *op) {
      if (isa<memref::GenericAtomicRMWOp>(op) ||
          (isa<memref::AtomicRMWOp>(op) && !isSimple(op)))
        return WalkResult::interrupt();
      auto reduce = dyn_cast<scf::ReduceOp>(op);
      if (!reduce)
        return WalkResult::advance();
      for (Region &region : reduce.getReductions()) {
        Block &block = region.front();
        auto sum = dyn_cast<arith::AddFOp>(block.front());
        if (!sum || block.getOperations().size() != 2)
          return WalkResult::interrupt();
      }
      return WalkResult::advance();
    });
    if (found.wasInterrupted())
      loops.push_back(loop);
  });
  // Inner loops come first, because the serial copy of an outer loop contains
  // them.
  for (scf::ParallelOp loop : llvm::reverse(loops))
    serialize(loop);
  SmallVector<Operation *> updates;
  function.walk([&](Operation *op) {
    if (isa<memref::GenericAtomicRMWOp>(op) ||
        (isa<memref::AtomicRMWOp>(op) && !isSimple(op)))
      updates.push_back(op);
  });
  for (Operation *op : updates) {
    ImplicitLocOpBuilder b(op->getLoc(), op);
    Value old, made, array;
    SmallVector<Value> indices;
    if (auto generic = dyn_cast<memref::GenericAtomicRMWOp>(op)) {
      array = generic.getMemref();
      indices = llvm::to_vector(generic.getIndices());
      old = memref::LoadOp::create(b, array, indices);
      IRMapping mapping;
      Block *body = generic.getBody();
      mapping.map(body->getArgument(0), old);
      for (Operation &inner : body->without_terminator())
        b.clone(inner, mapping);
      made = mapping.lookupOrDefault(body->getTerminator()->getOperand(0));
    } else {
      auto atomic = cast<memref::AtomicRMWOp>(op);
      array = atomic.getMemref();
      indices = llvm::to_vector(atomic.getIndices());
      old = memref::LoadOp::create(b, array, indices);
      made = atomic.getKind() == arith::AtomicRMWKind::assign
                 ? atomic.getValue()
                 : arith::getReductionOp(atomic.getKind(), b, op->getLoc(), old,
                                         atomic.getValue());
    }
    memref::StoreOp::create(b, made, array, indices);
    // A memref.generic_atomic_rmw returns the new value of the element, a
    // memref.atomic_rmw the old value.
    op->replaceAllUsesWith(
        ValueRange{isa<memref::GenericAtomicRMWOp>(op) ? made : old});
    op->erase();
  }
}

//===----------------------------------------------------------------------===//
// Chosen arrays
//===----------------------------------------------------------------------===//

/// Returns the possible values of an array that a loop carries or a branch
/// chooses; empty for other arrays.
static SmallVector<OpOperand *> getSources(Value array) {
  SmallVector<OpOperand *> sources;
  auto addYield = [&](Block *block, unsigned i) {
    sources.push_back(&block->getTerminator()->getOpOperand(i));
  };
  if (auto argument = dyn_cast<BlockArgument>(array)) {
    Operation *parent = argument.getOwner()->getParentOp();
    unsigned i = argument.getArgNumber();
    if (auto loop = dyn_cast<scf::ForOp>(parent); loop && i > 0) {
      sources.push_back(&loop.getInitArgsMutable()[i - 1]);
      addYield(loop.getBody(), i - 1);
    } else if (auto loop = dyn_cast<scf::WhileOp>(parent)) {
      if (argument.getOwner() == loop.getBeforeBody()) {
        sources.push_back(&loop.getInitsMutable()[i]);
        addYield(loop.getAfterBody(), i);
      } else {
        addYield(loop.getBeforeBody(), i + 1);
      }
    }
    return sources;
  }
  Operation *op = array.getDefiningOp();
  unsigned i = cast<OpResult>(array).getResultNumber();
  if (auto select = dyn_cast<arith::SelectOp>(op)) {
    sources = {&select->getOpOperand(1), &select->getOpOperand(2)};
  } else if (auto branch = dyn_cast<scf::IfOp>(op)) {
    addYield(branch.thenBlock(), i);
    addYield(branch.elseBlock(), i);
  } else if (auto loop = dyn_cast<scf::ForOp>(op)) {
    sources.push_back(&loop.getInitArgsMutable()[i]);
    addYield(loop.getBody(), i);
  } else if (auto loop = dyn_cast<scf::WhileOp>(op)) {
    addYield(loop.getBeforeBody(), i + 1);
  }
  return sources;
}

namespace {
class ChosenArrays {
public:
  explicit ChosenArrays(func::FuncOp function)
      : function(function), dominance(function) {}

  LogicalResult run();

private:
  LogicalResult collect();
  bool hoist(Value array, Operation *before);
  void replaceUses();
  void carryNumbers();
  Value getNumber(Value array);

  func::FuncOp function;
  DominanceInfo dominance;
  /// Arrays that a loop carries or a branch chooses, each with all arrays that
  /// it can stand for at run time.
  llvm::MapVector<Value, SmallVector<Value>> chosen;
  llvm::MapVector<Value, Value> numbers;
};
} // namespace

/// Makes `array` available before the op `before`, by moving the views that
/// make it. False if that is impossible.
bool ChosenArrays::hoist(Value array, Operation *before) {
  if (dominance.properlyDominates(array, before))
    return true;
  Operation *op = array.getDefiningOp();
  if (!isView(op) || llvm::any_of(op->getOperands(), [&](Value operand) {
        return !hoist(operand, before);
      }))
    return false;
  op->moveBefore(before);
  return true;
}

LogicalResult ChosenArrays::collect() {
  auto visit = [&](Value value) {
    if (isa<MemRefType>(value.getType()) && !getSources(value).empty())
      chosen[value];
  };
  function.walk<WalkOrder::PreOrder>([&](Operation *op) {
    llvm::for_each(op->getResults(), visit);
    for (Region &region : op->getRegions())
      for (BlockArgument argument : region.getArguments())
        visit(argument);
  });
  for (auto &[array, grounds] : chosen) {
    llvm::SetVector<Value> seen;
    SmallVector<Value> pending = {array};
    seen.insert(array);
    while (!pending.empty()) {
      Value value = pending.pop_back_val();
      SmallVector<OpOperand *> sources = getSources(value);
      if (sources.empty())
        grounds.push_back(value);
      for (OpOperand *source : llvm::reverse(sources))
        if (seen.insert(source->get()))
          pending.push_back(source->get());
    }
    // Finds the first op that carries or chooses one of the arrays in `seen`.
    Operation *first = nullptr;
    for (Value value : seen)
      if (!getSources(value).empty()) {
        Operation *op = value.getDefiningOp();
        if (!op)
          op = cast<BlockArgument>(value).getOwner()->getParentOp();
        if (!first || op->isProperAncestor(first) ||
            (op->getBlock() == first->getBlock() && op->isBeforeInBlock(first)))
          first = op;
      }
    for (Value ground : grounds)
      if (!hoist(ground, first)) {
        Operation *maker = ground.getDefiningOp();
        InFlightDiagnostic diag =
            (maker ? maker : first)
                ->emitError("cannot differentiate an array that is made in a "
                            "loop or branch and used outside of it");
        diag.attachNote(first->getLoc())
            << "one of several arrays is chosen here; make them before, or "
               "copy to one of them ('memref.copy')";
        return failure();
      }
  }
  return success();
}

Value ChosenArrays::getNumber(Value array) {
  auto *it = numbers.find(array);
  if (it != numbers.end())
    return it->second;
  OpBuilder b = OpBuilder::atBlockBegin(&function.getBody().front());
  Value number = arith::ConstantIndexOp::create(
      b, array.getLoc(), static_cast<int64_t>(numbers.size()));
  return numbers[array] = number;
}

/// Emits a copy of `op` for each array that its operand can be, in a chain of
/// branches on the number of the array.
static SmallVector<Value> branch(ImplicitLocOpBuilder &b, Operation *op,
                                 unsigned operand, Value number,
                                 ArrayRef<std::pair<Value, Value>> arrays) {
  auto createCopy = [&](OpBuilder &nested, Value array) {
    IRMapping none;
    Operation *copy = op->clone(none);
    copy->setOperand(operand, array);
    nested.insert(copy);
    return SmallVector<Value>(copy->getResults());
  };
  if (arrays.size() == 1)
    return createCopy(b, arrays.front().second);
  Value isFirst = arith::CmpIOp::create(b, arith::CmpIPredicate::eq, number,
                                        arrays.front().first);
  auto made = scf::IfOp::create(b, op->getResultTypes(), isFirst,
                                /*withElseRegion=*/true);
  for (auto [i, region] : llvm::enumerate(made->getRegions())) {
    OpBuilder::InsertionGuard guard(b);
    // An scf.if without results is created with terminators.
    if (region.front().mightHaveTerminator())
      region.front().getTerminator()->erase();
    b.setInsertionPointToEnd(&region.front());
    SmallVector<Value> results =
        i == 0 ? createCopy(b, arrays.front().second)
               : branch(b, op, operand, number, arrays.drop_front());
    scf::YieldOp::create(b, results);
  }
  return SmallVector<Value>(made->getResults());
}

void ChosenArrays::replaceUses() {
  for (auto &[array, grounds] : chosen) {
    SmallVector<std::pair<Value, Value>> arrays;
    for (Value ground : grounds)
      arrays.emplace_back(getNumber(ground), ground);
    for (OpOperand &use : llvm::make_early_inc_range(array.getUses())) {
      Operation *op = use.getOwner();
      if (isa<memref::DeallocOp>(op)) {
        op->erase();
        continue;
      }
      OpOperand *accessed = getArray(op);
      if (accessed != &use && !isa<memref::DimOp>(op))
        continue;
      ImplicitLocOpBuilder b(op->getLoc(), op);
      SmallVector<Value> results =
          branch(b, op, use.getOperandNumber(), numbers.lookup(array), arrays);
      op->replaceAllUsesWith(results);
      op->erase();
    }
  }
}

/// Changes loops and branches so that they carry and yield the number of an
/// array in place of the array.
void ChosenArrays::carryNumbers() {
  Type index = IndexType::get(function.getContext());
  SmallVector<std::pair<OpOperand *, Value>> handed;
  for (auto &[array, grounds] : chosen) {
    if (array.getDefiningOp<arith::SelectOp>())
      continue;
    for (OpOperand *source : getSources(array))
      handed.emplace_back(source, source->get());
  }
  for (auto &[operand, value] : handed)
    operand->set(getNumber(value));
  for (auto &[array, grounds] : chosen)
    if (!array.getDefiningOp<arith::SelectOp>())
      array.setType(index);
}

LogicalResult ChosenArrays::run() {
  if (failed(collect()))
    return failure();
  if (chosen.empty())
    return success();
  // For an array that an arith.select chooses, a select of numbers is made
  // below. Arrays from loops and branches need no op: these carry the number.
  for (auto &[array, grounds] : chosen)
    for (Value ground : grounds)
      getNumber(ground);
  for (auto &[array, grounds] : chosen)
    if (!array.getDefiningOp<arith::SelectOp>())
      numbers[array] = array;
  for (auto &[array, grounds] : chosen)
    if (auto select = array.getDefiningOp<arith::SelectOp>()) {
      OpBuilder b(select);
      // The list of chosen arrays is in program order, so the arrays that this
      // select chooses from already have numbers.
      numbers[array] = arith::SelectOp::create(
          b, select.getLoc(), IndexType::get(b.getContext()),
          select.getCondition(), getNumber(select.getTrueValue()),
          getNumber(select.getFalseValue()));
    }
  // The numbers of arrays are carried first, so that comparisons of numbers get
  // operands of type index.
  carryNumbers();
  replaceUses();
  for (auto &[array, grounds] : chosen)
    if (auto select = array.getDefiningOp<arith::SelectOp>();
        select && select.use_empty())
      select.erase();
  return success();
}

//===----------------------------------------------------------------------===//
// Views
//===----------------------------------------------------------------------===//

static LogicalResult foldViews(func::FuncOp function) {
  SmallVector<Operation *> ops;
  function.walk([&](Operation *op) {
    OpOperand *array = getArray(op);
    if (array || isa<memref::DimOp>(op))
      ops.push_back(op);
  });
  for (Operation *op : ops) {
    if (auto dim = dyn_cast<memref::DimOp>(op)) {
      std::optional<int64_t> index = dim.getConstantIndex();
      Value source = dim.getSource();
      if (!index || !isa<MemRefType>(source.getType()) ||
          isa<BlockArgument>(source) || !getSources(source).empty())
        continue;
      Value size = Elements(op).getSize(source, *index);
      if (size.getDefiningOp<memref::DimOp>() &&
          size.getDefiningOp<memref::DimOp>().getSource() == source) {
        size.getDefiningOp()->erase();
        continue;
      }
      dim.replaceAllUsesWith(size);
      dim.erase();
      continue;
    }
    OpOperand *operand = getArray(op);
    Value array = operand->get();
    MutableOperandRange range = getIndices(op);
    SmallVector<Value> indices;
    for (OpOperand &index : range)
      indices.push_back(index.get());
    Elements elements(op);
    while (isView(array.getDefiningOp()))
      if (failed(elements.step(array, indices))) {
        InFlightDiagnostic diag =
            op->emitError("cannot differentiate an access of this view");
        diag.attachNote(array.getLoc())
            << "made here, of memory whose layout is not known; view an array "
               "with the identity layout";
        return diag;
      }
    Operation *maker = array.getDefiningOp();
    bool isKnown =
        maker
            ? isa<memref::AllocOp, memref::AllocaOp, memref::GetGlobalOp>(maker)
            : array.getParentRegion() == &function.getBody();
    if (!isKnown && getSources(array).empty()) {
      InFlightDiagnostic diag = op->emitError(
          "cannot differentiate an access of an array of unknown origin");
      diag.attachNote(array.getLoc()) << "it comes from here";
      return diag;
    }
    operand->set(array);
    range.assign(indices);
  }
  return success();
}

/// Erases the views and sizes that are no longer used.
static void eraseDeadViews(func::FuncOp function) {
  SmallVector<Operation *> ops;
  function.walk([&](Operation *op) {
    if (isView(op) || isa<memref::DimOp>(op))
      ops.push_back(op);
  });
  for (Operation *op : llvm::reverse(ops))
    if (op->use_empty())
      op->erase();
}

//===----------------------------------------------------------------------===//
// Lifetimes
//===----------------------------------------------------------------------===//

/// Frees local arrays at the ends of their blocks, because their values are no
/// longer used outside of them.
static LogicalResult freeAtEnds(func::FuncOp function) {
  SmallVector<Operation *> makers;
  SmallVector<memref::DeallocOp> deallocs;
  WalkResult result = function.walk([&](Operation *op) {
    if (isa<memref::AllocOp, memref::AllocaOp>(op))
      makers.push_back(op);
    if (auto dealloc = dyn_cast<memref::DeallocOp>(op))
      deallocs.push_back(dealloc);
    if (isa<func::ReturnOp>(op) &&
        llvm::any_of(op->getOperandTypes(),
                     [](Type type) { return isa<BaseMemRefType>(type); })) {
      InFlightDiagnostic diag = op->emitError(
          "cannot differentiate a function that returns an array");
      attachHelpfulPass(diag, op);
      return WalkResult::interrupt();
    }
    return WalkResult::advance();
  });
  if (result.wasInterrupted())
    return failure();
  for (memref::DeallocOp dealloc : deallocs) {
    Value array = dealloc.getMemref();
    while (isView(array.getDefiningOp()))
      array = array.getDefiningOp()->getOperand(0);
    if (array.getDefiningOp<memref::AllocOp>())
      dealloc.erase();
  }
  for (Operation *op : makers) {
    Value array = op->getResult(0);
    if (auto alloca = dyn_cast<memref::AllocaOp>(op)) {
      // An alloca in a loop would take stack space in every iteration.
      if (!op->getParentOfType<LoopLikeOpInterface>())
        continue;
      OpBuilder b(op);
      auto alloc = memref::AllocOp::create(
          b, op->getLoc(), alloca.getType(), alloca.getDynamicSizes(),
          alloca.getSymbolOperands(), alloca.getAlignmentAttr());
      alloca.replaceAllUsesWith(alloc.getResult());
      alloca.erase();
      array = alloc;
    }
    OpBuilder b(array.getParentBlock()->getTerminator());
    memref::DeallocOp::create(b, array.getLoc(), array);
  }
  return success();
}

LogicalResult mlir::tai::normalizeMemory(func::FuncOp function) {
  if (failed(splitByteViews(function)) || failed(expandCopies(function)))
    return failure();
  expandUpdates(function);
  // Views are folded twice: first views of an array that a loop or branch
  // chooses, then views of the arrays that it is chosen from.
  if (failed(foldViews(function)) || failed(ChosenArrays(function).run()) ||
      failed(foldViews(function)))
    return failure();
  eraseDeadViews(function);
  return freeAtEnds(function);
}
