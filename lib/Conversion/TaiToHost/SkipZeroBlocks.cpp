//===- SkipZeroBlocks.cpp - Blocks of iterations without adjoints ---------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An iteration of most adjoints adds products of adjoints that it loads to
// other adjoints, and leaves memory as it is where those are zero. A test of
// each iteration would end vectorisation, so this pass tests blocks of them.
// The test of a block that has an adjoint in its first iteration ends there.
//
// Results have the same bits: a block is skipped only if the loads of adjoints
// are positive zeros, and the other factors of the products are finite by what
// the test has seen. Guards that replace a product by zero need no such proof.
//
//===----------------------------------------------------------------------===//

#include "../AdjointAccess.h"
#include "Magnitudes.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/IR/IRMapping.h"
#include "mlir/IR/Matchers.h"
#include "tai/Analysis/Cost.h"
#include "tai/Analysis/ZeroTests.h"
#include "tai/Conversion/Passes.h"
#include "tai/Conversion/TaiToHost/RuntimeCalls.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "llvm/ADT/TypeSwitch.h"

namespace mlir::tai {
#define GEN_PASS_DEF_SKIPZEROBLOCKS
#include "tai/Conversion/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// Iterations in a block: few enough to find gaps, enough to fill vectors.
static constexpr int64_t kBlock = 128;
/// The greatest number of loads that a test reads in an iteration.
static constexpr size_t kMostTests = 16;

/// The greatest body that is analysed, in operations.
static constexpr size_t kMostOps = 4000;

static bool isTestable(Type type) { return type.isF32() || type.isF64(); }

/// The greatest depth of two addresses that are compared.
static constexpr unsigned kMostDepth = 8;

/// True if two addresses are computed alike, from the same values.
static bool isSameAddress(Value a, Value b, unsigned depth = 0) {
  if (a == b)
    return true;
  Operation *own = a.getDefiningOp(), *other = b.getDefiningOp();
  return own && other && depth < kMostDepth && isMemoryEffectFree(own) &&
         OperationEquivalence::isEquivalentTo(
             own, other,
             [&](Value x, Value y) {
               return success(isSameAddress(x, y, depth + 1));
             },
             /*markEquivalent=*/nullptr, OperationEquivalence::IgnoreLocations);
}

/// True for code without guards that gives the results of the code with guards
/// in the other arm of a branch.
static bool isWithoutGuards(Operation *op, Operation *loop) {
  for (; op != loop; op = op->getParentOp())
    if (auto branch = dyn_cast<scf::IfOp>(op->getParentOp());
        branch && branch->hasAttr(kGuardVersions) &&
        op->getParentRegion() == &branch.getThenRegion())
      return true;
  return false;
}

/// True for the zero of either sign.
static bool isZeroConstant(Value value) {
  return matchPattern(value, m_AnyZeroFloat());
}

namespace {
/// Analyses one loop, and divides it into blocks.
class ZeroBlocks {
public:
  explicit ZeroBlocks(scf::ForOp loop)
      : loop(loop), magnitudes([this](Value value) { return isLeaf(value); }) {}

  bool matches(double minNanoseconds);
  /// Emits the blocks. `counts` are two slots of i64, for iterations that run
  /// and iterations that are skipped.
  void emit(Value counts);

private:
  bool isParallel(Operation *op) const;
  bool isMovable(Operation *op);
  bool isSource(LLVM::LoadOp load);
  bool isLeaf(Value value);
  bool isGuardOfZero(arith::SelectOp select) const;
  bool isZero(Value value) const {
    return zeros.contains(value) || isZeroConstant(value);
  }
  bool staysZero(Value value);
  bool staysZeroResult(Operation *op, unsigned number);
  Value getZeroCondition(Value value);
  bool isUnchanged(Value value, Value address, Value &condition);
  bool isHarmless(Operation *op);
  void findZeros();
  void collectTests();
  bool canZeroAlone(LLVM::StoreOp store);
  void emitZeros(OpBuilder &builder, Location loc, Value begin, Value end);
  IRMapping cloneFor(OpBuilder &builder, ArrayRef<Value> values, Value iv);
  Value emitTest(OpBuilder &builder, Location loc, Value iv);
  Value emitOuterTest(OpBuilder &builder, Location loc);

  scf::ForOp loop;
  ArrayRef<LLVM::AccessGroupAttr> groups;
  int64_t step = 0;
  DenseSet<Value> zeros;
  DenseMap<Operation *, bool> movable;
  Magnitudes magnitudes;
  SmallVector<LLVM::LoadOp> sources;
  llvm::SetVector<Value> leaves;
  /// Stores to adjoints that count as zero on a condition: if it is true, a
  /// block that is skipped must set them to zero.
  SmallVector<std::pair<LLVM::StoreOp, Value>> zeroed;
};
} // namespace

/// True for an access that does not depend on those of other iterations.
bool ZeroBlocks::isParallel(Operation *op) const {
  auto access = dyn_cast<LLVM::AccessGroupOpInterface>(op);
  ArrayAttr own = access ? access.getAccessGroupsOrNull() : ArrayAttr();
  return own && llvm::any_of(own, [&](Attribute group) {
           return llvm::is_contained(groups, group);
         });
}

/// True if `op` stands in the body of the loop and may run before the block, as
/// may the ops that it uses.
bool ZeroBlocks::isMovable(Operation *op) {
  if (!op || !loop->isProperAncestor(op))
    return true;
  auto [it, isNew] = movable.try_emplace(op, false);
  if (!isNew)
    return it->second;
  auto load = dyn_cast<LLVM::LoadOp>(op);
  bool may =
      op->getBlock() == loop.getBody() && op->getNumRegions() == 0 &&
      (load ? isParallel(op) || load.getInvariant() : isMemoryEffectFree(op)) &&
      llvm::all_of(op->getOperands(), [&](Value operand) {
        if (isa<BlockArgument>(operand))
          return operand == loop.getInductionVar() ||
                 loop.isDefinedOutsideOfLoop(operand);
        return isMovable(operand.getDefiningOp());
      });
  return movable[op] = may;
}

bool ZeroBlocks::isSource(LLVM::LoadOp load) {
  return load->hasAttr(kAdjointAccess) && isTestable(load.getType()) &&
         loop->isProperAncestor(load) && isMovable(load);
}

bool ZeroBlocks::isLeaf(Value value) {
  if (!isTestable(value.getType()))
    return false;
  if (loop.isDefinedOutsideOfLoop(value))
    return true;
  auto load = value.getDefiningOp<LLVM::LoadOp>();
  return load && isMovable(load);
}

/// True for `select (x == 0), 0, y` where x is zero.
bool ZeroBlocks::isGuardOfZero(arith::SelectOp select) const {
  Value tested = getTestedForZero(select);
  return tested && isZero(tested) && isZeroConstant(select.getTrueValue());
}

bool ZeroBlocks::staysZeroResult(Operation *op, unsigned number) {
  return llvm::TypeSwitch<Operation *, bool>(op)
      .Case([&](LLVM::LoadOp load) { return isSource(load); })
      .Case([&](arith::MulFOp product) {
        Value a = product.getLhs(), b = product.getRhs();
        return (isZero(a) && (isZero(b) || magnitudes.isFinite(b))) ||
               (isZero(b) && magnitudes.isFinite(a));
      })
      .Case([&](math::FmaOp fma) {
        Value a = fma.getA(), b = fma.getB();
        return isZero(fma.getC()) &&
               ((isZero(a) && (isZero(b) || magnitudes.isFinite(b))) ||
                (isZero(b) && magnitudes.isFinite(a)));
      })
      .Case([&](arith::DivFOp quotient) {
        // The inverse is finite only if the divisor is not zero.
        return isZero(quotient.getLhs()) && !isZero(quotient.getRhs()) &&
               magnitudes.isFinite(quotient.getResult());
      })
      .Case([&](arith::SelectOp select) {
        return isGuardOfZero(select) || (isZero(select.getTrueValue()) &&
                                         isZero(select.getFalseValue()));
      })
      .Case<arith::AddFOp, arith::SubFOp, arith::NegFOp, arith::ExtFOp,
            arith::TruncFOp, math::AbsFOp>([&](Operation *linear) {
        return llvm::all_of(linear->getOperands(),
                            [&](Value operand) { return isZero(operand); });
      })
      .Case([&](scf::IfOp branch) {
        bool hasVersions = branch->hasAttr(kGuardVersions);
        return llvm::all_of(branch->getRegions(), [&](Region &region) {
          if (hasVersions && &region == &branch.getThenRegion())
            return true;
          return !region.empty() &&
                 isZero(region.front().getTerminator()->getOperand(number));
        });
      })
      .Case([&](scf::ForOp inner) {
        return isZero(inner.getInits()[number]) &&
               isZero(inner.getBody()->getTerminator()->getOperand(number));
      })
      .Default([](Operation *) { return false; });
}

bool ZeroBlocks::staysZero(Value value) {
  if (auto result = dyn_cast<OpResult>(value))
    return staysZeroResult(result.getOwner(), result.getResultNumber());
  auto argument = cast<BlockArgument>(value);
  auto inner = dyn_cast<scf::ForOp>(argument.getOwner()->getParentOp());
  if (!inner || inner == loop || argument.getArgNumber() == 0)
    return false;
  unsigned number = argument.getArgNumber() - 1;
  return isZero(inner.getInits()[number]) &&
         isZero(inner.getBody()->getTerminator()->getOperand(number));
}

/// Returns the condition under which a number from memory counts as zero, for
/// `select condition, 0, load`, if it is the same in all iterations.
Value ZeroBlocks::getZeroCondition(Value value) {
  auto select = value.getDefiningOp<arith::SelectOp>();
  return select && isZeroConstant(select.getTrueValue()) &&
                 select.getFalseValue().getDefiningOp<LLVM::LoadOp>() &&
                 loop.isDefinedOutsideOfLoop(select.getCondition())
             ? select.getCondition()
             : Value();
}

/// True if `value` is the number at `address`, with zeros added to it. If it
/// counts as zero on a condition, `condition` is set to it.
bool ZeroBlocks::isUnchanged(Value value, Value address, Value &condition) {
  if (Value own = getZeroCondition(value)) {
    condition = own;
    value = value.getDefiningOp<arith::SelectOp>().getFalseValue();
  }
  if (auto load = value.getDefiningOp<LLVM::LoadOp>())
    return isSameAddress(load.getAddr(), address);
  if (auto sum = value.getDefiningOp<arith::AddFOp>()) {
    Value a = sum.getLhs(), b = sum.getRhs();
    return (isZero(b) && isUnchanged(a, address, condition)) ||
           (isZero(a) && isUnchanged(b, address, condition));
  }
  auto difference = value.getDefiningOp<arith::SubFOp>();
  return difference && isZero(difference.getRhs()) &&
         isUnchanged(difference.getLhs(), address, condition);
}

/// True if all uses of a number from `address` add to it and store it there.
static bool isOnlyAddedTo(Value value, Value address) {
  return llvm::all_of(value.getUsers(), [&](Operation *user) {
    if (auto store = dyn_cast<LLVM::StoreOp>(user))
      return isSameAddress(store.getAddr(), address);
    // `select known, 0, value`, of an adjoint that may count as zero.
    auto select = dyn_cast<arith::SelectOp>(user);
    bool startsAtZero = select && select.getFalseValue() == value &&
                        isZeroConstant(select.getTrueValue());
    return (startsAtZero || isa<arith::AddFOp, arith::SubFOp>(user)) &&
           isOnlyAddedTo(user->getResult(0), address);
  });
}

/// True if `op` changes no memory where all values in `zeros` are zero.
bool ZeroBlocks::isHarmless(Operation *op) {
  if (auto store = dyn_cast<LLVM::StoreOp>(op)) {
    Value condition;
    if (!store->hasAttr(kAdjointAccess) || !isParallel(op) ||
        !isUnchanged(store.getValue(), store.getAddr(), condition))
      return false;
    if (condition)
      zeroed.push_back({store, condition});
    return true;
  }
  if (auto load = dyn_cast<LLVM::LoadOp>(op))
    return !load.getVolatile_();
  if (op->getNumRegions() != 0)
    return isa<scf::IfOp, scf::ForOp>(op);
  return isMemoryEffectFree(op);
}

/// Finds the greatest set of values that are zero where the sources are.
void ZeroBlocks::findZeros() {
  SmallVector<Value> candidates;
  auto consider = [&](Value value) {
    if (isTestable(value.getType()) && zeros.insert(value).second)
      candidates.push_back(value);
  };
  loop.walk<WalkOrder::PreOrder>([&](Operation *op) {
    if (op == loop)
      return;
    llvm::for_each(op->getResults(), consider);
    for (Region &region : op->getRegions())
      for (Block &block : region)
        llvm::for_each(block.getArguments(), consider);
  });
  for (bool changed = true; changed;) {
    changed = false;
    for (Value value : candidates)
      if (zeros.contains(value) && !staysZero(value))
        changed |= zeros.erase(value);
  }
}

/// Collects the sources, and the leaves from which the factors of products with
/// zeros are computed.
void ZeroBlocks::collectTests() {
  loop.walk([&](Operation *op) {
    if (auto load = dyn_cast<LLVM::LoadOp>(op)) {
      if (isSource(load) && !load->use_empty())
        sources.push_back(load);
      return;
    }
    if (op->getNumResults() != 1 || !zeros.contains(op->getResult(0)) ||
        !isa<arith::MulFOp, math::FmaOp, arith::DivFOp>(op) ||
        isWithoutGuards(op, loop))
      return;
    for (Value operand : op->getOperands().take_front(2))
      if (!isZero(operand))
        magnitudes.addLeaves(operand, leaves);
  });
  // An accumulator is loaded to be added to, and its old value does not matter.
  llvm::erase_if(sources, [&](LLVM::LoadOp load) {
    return isOnlyAddedTo(load, load.getAddr());
  });
  for (LLVM::LoadOp load : sources)
    leaves.remove(load.getResult());
}

bool ZeroBlocks::matches(double minNanoseconds) {
  auto annotation =
      loop->getAttrOfType<LLVM::LoopAnnotationAttr>("llvm.loop_annotation");
  std::optional<int64_t> by = getConstantIntValue(loop.getStep());
  if (!annotation || annotation.getParallelAccesses().empty() ||
      !(loop.getInductionVar().getType().isIndex() ||
        loop.getInductionVar().getType().isInteger(64)) ||
      loop.getUnsignedCmp() || loop.getNumResults() || !by || *by <= 0)
    return false;
  groups = annotation.getParallelAccesses();
  step = *by;
  double cost = 0;
  bool usesAdjoints = false;
  size_t ops = 0;
  loop.walk([&](Operation *op) {
    ++ops;
    usesAdjoints |= op->hasAttr(kAdjointAccess);
    if (op == loop || op->getNumRegions() != 0 || op->getNumResults() != 1 ||
        !isa<FloatType>(op->getResult(0).getType()) || isa<LLVM::LoadOp>(op))
      return;
    double own = estimateNanoseconds(op);
    for (Operation *parent = op->getParentOp(); parent != loop;
         parent = parent->getParentOp())
      own *= estimateTrips(parent);
    cost += own;
  });
  if (!usesAdjoints || cost < minNanoseconds || ops > kMostOps)
    return false;
  findZeros();
  WalkResult result = loop.walk([&](Operation *op) {
    return op == loop || isWithoutGuards(op, loop) || isHarmless(op)
               ? WalkResult::advance()
               : WalkResult::interrupt();
  });
  if (result.wasInterrupted())
    return false;
  collectTests();
  return !sources.empty() && sources.size() + leaves.size() <= kMostTests;
}

/// Returns the bits of a float as an integer.
static Value getBits(OpBuilder &builder, Location loc, Value value) {
  Type bits = builder.getIntegerType(value.getType().getIntOrFloatBitWidth());
  return arith::BitcastOp::create(builder, loc, bits, value);
}

/// Emits a test whether a number is huge, infinite or NaN.
static Value emitIsHuge(OpBuilder &builder, Location loc, Value value) {
  auto constant = [&](const APInt &number) -> Value {
    return arith::ConstantOp::create(
        builder, loc,
        builder.getIntegerAttr(builder.getIntegerType(number.getBitWidth()),
                               number));
  };
  auto type = cast<FloatType>(value.getType());
  APFloat bound(Magnitudes::kLeafBound);
  bool inexact;
  bound.convert(type.getFloatSemantics(), APFloat::rmTowardZero, &inexact);
  Value magnitude = arith::AndIOp::create(
      builder, loc, getBits(builder, loc, value),
      constant(APInt::getSignedMaxValue(type.getWidth())));
  return arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::sgt,
                               magnitude, constant(bound.bitcastToAPInt()));
}

static Value emitOr(OpBuilder &builder, Location loc, Value a, Value b) {
  return a ? arith::OrIOp::create(builder, loc, a, b).getResult() : b;
}

/// True if each iteration makes the store, so that it can be made for a block
/// that is skipped.
bool ZeroBlocks::canZeroAlone(LLVM::StoreOp store) {
  return store->getBlock() == loop.getBody() &&
         (loop.isDefinedOutsideOfLoop(store.getAddr()) ||
          isMovable(store.getAddr().getDefiningOp()));
}

/// Emits a test of the leaves that are the same in all iterations, and of the
/// conditions under which no block may be skipped; null if there is none.
Value ZeroBlocks::emitOuterTest(OpBuilder &builder, Location loc) {
  Value any;
  for (Value leaf : leaves)
    if (loop.isDefinedOutsideOfLoop(leaf))
      any = emitOr(builder, loc, any, emitIsHuge(builder, loc, leaf));
  for (auto [store, condition] : zeroed)
    if (!canZeroAlone(store))
      any = emitOr(builder, loc, any, condition);
  return any;
}

/// Emits stores of zeros for the iterations of a block that is skipped, to
/// adjoints that count as zero and hold other numbers.
void ZeroBlocks::emitZeros(OpBuilder &builder, Location loc, Value begin,
                           Value end) {
  for (auto [store, condition] : zeroed) {
    if (!canZeroAlone(store))
      continue;
    auto branch = scf::IfOp::create(builder, loc, condition);
    OpBuilder inside = branch.getThenBodyBuilder();
    auto zeros = scf::ForOp::create(inside, loc, begin, end, loop.getStep());
    zeros->setAttrs(loop->getDiscardableAttrDictionary());
    inside.setInsertionPointToStart(zeros.getBody());
    IRMapping mapping =
        cloneFor(inside, {store.getAddr()}, zeros.getInductionVar());
    auto copy = cast<LLVM::StoreOp>(store->clone());
    copy.getAddrMutable().assign(mapping.lookupOrDefault(store.getAddr()));
    Type type = store.getValue().getType();
    Value zero = arith::ConstantOp::create(inside, loc, type,
                                           inside.getFloatAttr(type, 0.0));
    copy.getValueMutable().assign(zero);
    inside.insert(copy);
  }
}

/// Clones the ops of the body that compute the values, for iteration `iv`.
IRMapping ZeroBlocks::cloneFor(OpBuilder &builder, ArrayRef<Value> values,
                               Value iv) {
  DenseSet<Operation *> needed;
  SmallVector<Operation *> open;
  for (Value value : values)
    open.push_back(value.getDefiningOp());
  while (!open.empty()) {
    Operation *op = open.pop_back_val();
    if (!op || !loop->isProperAncestor(op) || !needed.insert(op).second)
      continue;
    for (Value operand : op->getOperands())
      open.push_back(operand.getDefiningOp());
  }
  IRMapping mapping;
  mapping.map(loop.getInductionVar(), iv);
  for (Operation &op : *loop.getBody())
    if (needed.contains(&op))
      builder.clone(op, mapping);
  return mapping;
}

/// Emits a test whether iteration `iv` must run.
Value ZeroBlocks::emitTest(OpBuilder &builder, Location loc, Value iv) {
  SmallVector<Value> tested(sources.begin(), sources.end());
  llvm::append_range(tested, leaves);
  IRMapping mapping = cloneFor(builder, tested, iv);
  Value any;
  DenseMap<Type, Value> bits;
  for (LLVM::LoadOp load : sources) {
    Value own = getBits(builder, loc, mapping.lookup(load.getResult()));
    Value &sum = bits[own.getType()];
    sum = emitOr(builder, loc, sum, own);
  }
  for (unsigned width : {32, 64})
    if (Value sum = bits.lookup(builder.getIntegerType(width))) {
      Value zero = arith::ConstantIntOp::create(builder, loc, 0, width);
      any = emitOr(builder, loc, any,
                   arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::ne,
                                         sum, zero));
    }
  for (Value leaf : leaves)
    if (!loop.isDefinedOutsideOfLoop(leaf))
      any = emitOr(builder, loc, any,
                   emitIsHuge(builder, loc, mapping.lookup(leaf)));
  return any;
}

/// Adds the number of iterations in a block to the slot `number` of the
/// counters.
static void advance(OpBuilder &builder, Location loc, Value counts,
                    int32_t number, Value begin, Value end) {
  Type i64 = builder.getI64Type();
  Value slot = LLVM::GEPOp::create(builder, loc, counts.getType(), i64, counts,
                                   ArrayRef<LLVM::GEPArg>{number});
  Value old = LLVM::LoadOp::create(builder, loc, i64, slot);
  Value size = arith::SubIOp::create(builder, loc, end, begin);
  if (size.getType() != i64)
    size = arith::IndexCastOp::create(builder, loc, i64, size);
  Value sum = arith::AddIOp::create(builder, loc, old, size);
  LLVM::StoreOp::create(builder, loc, sum, slot);
}

void ZeroBlocks::emit(Value counts) {
  OpBuilder builder(loop);
  Location loc = loop.getLoc();
  Value outer = emitOuterTest(builder, loc);
  Type type = loop.getInductionVar().getType();
  Value size = arith::ConstantOp::create(
      builder, loc, builder.getIntegerAttr(type, kBlock * step));
  Value lower = loop.getLowerBound(), upper = loop.getUpperBound();
  auto blocks = scf::ForOp::create(builder, loc, lower, upper, size);
  builder.setInsertionPointToStart(blocks.getBody());
  Value begin = blocks.getInductionVar();
  Value next = arith::AddIOp::create(builder, loc, begin, size);
  Value end = arith::MinSIOp::create(builder, loc, next, upper);
  Value first = emitTest(builder, loc, begin);
  if (outer)
    first = arith::OrIOp::create(builder, loc, outer, first);
  auto any = scf::IfOp::create(
      builder, loc, first,
      [](OpBuilder &b, Location at) {
        scf::YieldOp::create(
            b, at, arith::ConstantIntOp::create(b, at, 1, 1).getResult());
      },
      [&](OpBuilder &b, Location at) {
        Value none = arith::ConstantIntOp::create(b, at, 0, 32);
        auto tests = scf::ForOp::create(
            b, at, begin, end, loop.getStep(), none,
            [&](OpBuilder &in, Location inLoc, Value iv, ValueRange sum) {
              Value own = arith::ExtUIOp::create(in, inLoc, in.getI32Type(),
                                                 emitTest(in, inLoc, iv));
              scf::YieldOp::create(
                  in, inLoc,
                  arith::OrIOp::create(in, inLoc, sum[0], own).getResult());
            });
        scf::YieldOp::create(b, at,
                             arith::CmpIOp::create(b, at,
                                                   arith::CmpIPredicate::ne,
                                                   tests.getResult(0), none)
                                 .getResult());
      });
  auto choice = scf::IfOp::create(builder, loc, any.getResult(0),
                                  /*withElseRegion=*/true);
  builder.setInsertionPointToStart(choice.elseBlock());
  advance(builder, loc, counts, 1, begin, end);
  emitZeros(builder, loc, begin, end);
  builder.setInsertionPointToStart(choice.thenBlock());
  advance(builder, loc, counts, 0, begin, end);
  loop->moveBefore(choice.thenBlock()->getTerminator());
  loop.setLowerBound(begin);
  loop.setUpperBound(end);
}

/// True for a kernel and for a part of its loop: their first argument is the
/// frame of the launch.
static bool hasFrame(LLVM::LLVMFuncOp function) {
  ArrayRef<Type> types = function.getArgumentTypes();
  auto isPointer = [](Type type) { return isa<LLVM::LLVMPointerType>(type); };
  if (types.size() == 1)
    return isPointer(types[0]);
  return types.size() == 5 && isPointer(types[0]) && isPointer(types[1]) &&
         llvm::all_of(types.drop_front(2),
                      [](Type type) { return type.isInteger(64); });
}

/// Emits slots for the counters of a function, and calls that report them.
static Value emitCounts(LLVM::LLVMFuncOp function, RuntimeCalls &runtime) {
  OpBuilder builder = OpBuilder::atBlockBegin(&function.getBody().front());
  Location loc = function.getLoc();
  Value two = runtime.i64(builder, loc, 2);
  Value zero = runtime.i64(builder, loc, 0);
  Type i64 = builder.getI64Type();
  Value counts =
      LLVM::AllocaOp::create(builder, loc, runtime.getPointerType(), i64, two);
  auto slot = [&](int32_t number) -> Value {
    return LLVM::GEPOp::create(builder, loc, counts.getType(), i64, counts,
                               ArrayRef<LLVM::GEPArg>{number});
  };
  for (int32_t number : {0, 1})
    LLVM::StoreOp::create(builder, loc, zero, slot(number));
  function.walk([&](LLVM::ReturnOp end) {
    builder.setInsertionPoint(end);
    Value run = LLVM::LoadOp::create(builder, loc, i64, slot(0));
    Value skipped = LLVM::LoadOp::create(builder, loc, i64, slot(1));
    runtime.tai_rt_count_cells(builder, loc, function.getArgument(0), run,
                               skipped);
  });
  return counts;
}

namespace {
struct SkipZeroBlocks : tai::impl::SkipZeroBlocksBase<SkipZeroBlocks> {
  using Base::Base;

  void runOnOperation() override {
    RuntimeCalls runtime(getOperation());
    SmallVector<LLVM::LLVMFuncOp> functions;
    for (auto function : getOperation().getOps<LLVM::LLVMFuncOp>())
      if (!function.isExternal() && isTaiCode(function))
        functions.push_back(function);
    for (LLVM::LLVMFuncOp function : functions) {
      Value counts;
      SmallVector<scf::ForOp> loops;
      if (hasFrame(function))
        function.walk([&](scf::ForOp loop) { loops.push_back(loop); });
      for (scf::ForOp loop : loops) {
        ZeroBlocks blocks(loop);
        if (!blocks.matches(minNanoseconds))
          continue;
        if (!counts)
          counts = emitCounts(function, runtime);
        blocks.emit(counts);
      }
      function.walk([](Operation *op) { op->removeAttr(kAdjointAccess); });
    }
  }
};
} // namespace
