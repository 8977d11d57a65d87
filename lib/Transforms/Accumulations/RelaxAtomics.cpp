//===- RelaxAtomics.cpp - Strategies for accumulations --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An atomic float addition is a loop around a compare-and-exchange on CPUs, and
// nothing vectorises around it. Nearly all accumulations of simulators and of
// their adjoints do not need it: each iteration has its own element, or all
// share one, or the updated part of the field is small.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/Transforms/LoopInvariantCodeMotionUtils.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/Cost.h"
#include "tai/Dialect/Tai/IR/Modes.h"
#include "tai/Transforms/Passes.h"
#include "tai/Transforms/Utils/Accumulation.h"
#include "tai/Transforms/Utils/OrderedAdditions.h"
#include "tai/Transforms/Utils/SumOrder.h"
#include "llvm/ADT/TypeSwitch.h"

namespace mlir::tai {
#define GEN_PASS_DEF_RELAXATOMICS
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// More sums than this in one field are held in a buffer rather than in
/// registers: they are neighbours as a rule (the weights of a sum written out),
/// which LLVM updates as vectors, while it would spill so many registers.
constexpr size_t kMaxRegisters = 8;

/// Iterations of a loop on a GPU whose sums do not meet in a block: its
/// threads.
constexpr int64_t kMaxWarpSums = 1024;

/// Private buffers larger than this are left alone: they would fill the memory
/// of a machine with many cores.
constexpr int64_t kMaxPrivateElements = int64_t(1) << 24;

/// In deterministic mode on a GPU: an iteration of a loop that one warp runs,
/// measured; three passes over the iterations instead, and a byte of their
/// accumulators; and how many bytes a launch may take.
constexpr double kWarpNanoseconds = 80, kPassesNanoseconds = 10000;
constexpr double kNanosecondsPerByte = 1e-3;
constexpr double kMaxAccumulatorBytes = int64_t(1) << 29;

/// Local arrays up to this size are summed in registers: a matrix.
constexpr int64_t kMaxLocalSums = 16;

namespace {
/// The accesses of a loop to one field.
struct FieldAccesses {
  SmallVector<AtomicOp> atomics; // those that are not exclusive yet
  SmallVector<Operation *> others;
};

class LoopRelaxation {
public:
  LoopRelaxation(ParallelForOp loop, FieldTable &fields, bool deterministic,
                 const Modes &modes, bool onDevice)
      : loop(loop), fields(fields),
        deterministic(modes.isDeterministic(deterministic)),
        compensated(modes.isCompensated()),
        oneOrder(modes.hasOneOrder(deterministic)), onDevice(onDevice) {}

  LogicalResult run();

private:
  void serialize();
  bool isIndependentOfTiming(AtomicOp atomic);
  bool mayReach(ValueRange a, ValueRange b);
  void relaxField(FieldAccesses &accesses);
  bool isWorthPrivate(const AccumulationGroup &group);
  bool isWarpSum(AtomicOp atomic);
  bool isWorthWide(const AccumulationGroup &group);
  bool hasWideSums();
  bool canRunInWarp();
  bool useFixedPoint();
  LogicalResult checkCompensated();

  ParallelForOp loop;
  FieldTable &fields;
  bool deterministic, compensated;
  /// All targets must choose alike.
  bool oneOrder;
  bool onDevice;
  int64_t numBuffers = 0;
};
} // namespace

/// True if the update is a sum in a small array that the kernel makes for it,
/// and nothing else in the loop touches the array: adjoints of values that the
/// body of a loop captures.
static bool isLocalSum(memref::AtomicRMWOp atomic, ParallelForOp loop) {
  auto array = atomic.getMemref().getDefiningOp<memref::AllocaOp>();
  if (!array || loop->isAncestor(array) ||
      array.getType().getNumElements() > kMaxLocalSums)
    return false;
  return llvm::all_of(array->getUsers(), [&](Operation *user) {
    if (!loop->isAncestor(user))
      return true;
    auto other = dyn_cast<memref::AtomicRMWOp>(user);
    return other && other.getKind() == arith::AtomicRMWKind::addf &&
           other.getResult().use_empty() &&
           llvm::all_of(other.getIndices(), [](Value index) {
             return getConstantIntValue(index).has_value();
           });
  });
}

/// Runs the loop on one thread, where every update is plain.
void LoopRelaxation::serialize() {
  loop.setSerialize(true);
  // tai-split-index-sets would run the borders after the interior.
  if (oneOrder)
    loop.walk([](scf::IfOp branch) { branch->removeAttr("tai.interior"); });
  loop.walk([](AtomicOp atomic) {
    atomic.removeStrategyAttr();
    atomic.removeBufferAttr();
    atomic.setExclusive(true);
  });
  loop.walk([](memref::AtomicRMWOp atomic) {
    atomic->removeAttr(kAccumulateAttrName);
  });
}

/// Integer updates give the same result in any order, unless the former value
/// is used.
bool LoopRelaxation::isIndependentOfTiming(AtomicOp atomic) {
  if (!atomic.getOld().use_empty())
    return false;
  Type type = getElementTypeOrSelf(atomic.getValue().getType());
  return !isa<FloatType>(type) || atomic.getKind() == AtomicKind::Min ||
         atomic.getKind() == AtomicKind::Max;
}

static bool is16Bits(Type type) {
  return isa<FloatType>(type) && type.getIntOrFloatBitWidth() == 16;
}

/// The slice of the field that a group updates.
static std::optional<FieldSlice> getSlice(const AccumulationGroup &group) {
  SmallVector<bool> fixed =
      llvm::map_to_vector(group.fixed, [](Value index) { return bool(index); });
  return FieldTable::getSlice(*group.field, fixed);
}

/// True if buffers for the updated part of the field cost less than the atomic
/// updates.
bool LoopRelaxation::isWorthPrivate(const AccumulationGroup &group) {
  const FieldInfo &field = *group.field;
  bool isFloat = isa<FloatType>(field.scalarType);
  if (!isFloat && !field.scalarType.isInteger(32) &&
      !field.scalarType.isInteger(64))
    return false;
  double updates = 0;
  for (AtomicOp atomic : group.atomics) {
    if (atomic.getKind() != AtomicKind::Add &&
        atomic.getKind() != AtomicKind::Sub)
      return false;
    updates += estimateRuns(atomic, loop);
  }
  std::optional<FieldSlice> slice = getSlice(group);
  if (!slice)
    return false;
  int64_t elements = slice->numCells * field.numComponents;
  if (elements > kMaxPrivateElements)
    return false;
  // Sums of 16 bits would stop growing after some hundred additions.
  if (isFloat && (compensated || is16Bits(field.scalarType)))
    return true;
  // If the number of iterations is known at run time only, so is the gain: too
  // few of them run in one partition, which needs no buffers.
  std::optional<int64_t> iterations = getNumIterations(loop);
  return !iterations || elements <= *iterations * updates * kElementsPerUpdate;
}

/// True if a buffer for the group has the layout of the field, so that all its
/// addresses are known to LLVM.
static bool isContiguous(const AccumulationGroup &group) {
  std::optional<FieldSlice> slice = getSlice(group);
  return slice && slice->cellStride ==
                      group.field->numComponents * group.field->scalarSize;
}

static ValueRange getIndices(Operation *access) {
  return cast<FieldAccessOpInterface>(access).getIndices();
}

/// False if accesses at `a` and `b` reach different elements in any two
/// iterations: an index that is the same in all of them tells them apart, such
/// as the time slot.
bool LoopRelaxation::mayReach(ValueRange a, ValueRange b) {
  for (auto [x, y] : llvm::zip_equal(a, b))
    if (loop.isDefinedOutsideOfLoop(x) && loop.isDefinedOutsideOfLoop(y) &&
        areProvablyDistinct(x, y))
      return false;
  return true;
}

/// True for sums that a GPU takes with one atomic addition of each warp: of so
/// few warps, that is quicker than to bring them together in their block.
bool LoopRelaxation::isWarpSum(AtomicOp atomic) {
  std::optional<int64_t> iterations = getNumIterations(loop);
  if (deterministic || compensated || !iterations ||
      *iterations > kMaxWarpSums || atomic.getKind() != AtomicKind::Add ||
      !atomic.getValue().getType().isF32())
    return false;
  // In an inner loop there would be one for each of its iterations.
  Operation *around = atomic->getParentOp();
  while (isa<scf::IfOp>(around))
    around = around->getParentOp();
  return around == loop;
}

/// True if the additions of a loop on a GPU are rounded once, from sums in f64
/// beside the field: compensated ones, those of 16-bit floats, which stop
/// growing at some thousand terms, and those of f32 that are many for each
/// element.
bool LoopRelaxation::isWorthWide(const AccumulationGroup &group) {
  Type scalar = group.field->scalarType;
  if (!onDevice || deterministic || !isa<FloatType>(scalar))
    return false;
  double elements = double(getNumAccumulators(group)), updates = 0;
  for (AtomicOp atomic : group.atomics)
    updates += estimateRuns(atomic, loop);
  std::optional<int64_t> iterations = getNumIterations(loop);
  bool hasMany = scalar.isF32() && iterations &&
                 double(*iterations) * updates > double(kFewTerms) * elements;
  if (!compensated && !is16Bits(scalar) && !hasMany)
    return false;
  // Host code that repeats the loop would have as many sums.
  for (Operation *at = loop->getParentOp(); !isa<FunctionOpInterface>(at);
       at = at->getParentOp())
    if (!isa<scf::IfOp>(at))
      return false;
  return elements * 16 <= kMaxAccumulatorBytes &&
         llvm::all_of(group.atomics, [](AtomicOp atomic) {
           return atomic.getKind() == AtomicKind::Add ||
                  atomic.getKind() == AtomicKind::Sub;
         });
}

/// Chooses for the updates of one field.
void LoopRelaxation::relaxField(FieldAccesses &accesses) {
  SmallVector<AtomicOp> &atomics = accesses.atomics;
  auto sameElement = [&](AtomicOp atomic) {
    return llvm::equal(atomic.getIndices(), atomics.front().getIndices());
  };
  // A store of another iteration would be lost to a plain addition of zero,
  // which a branch that was turned into a select makes.
  bool meetsStore = llvm::any_of(accesses.others, [&](Operation *other) {
    ValueRange indices = atomics.front().getIndices();
    return isa<StoreOp>(other) && !llvm::equal(getIndices(other), indices) &&
           mayReach(getIndices(other), indices);
  });
  if (llvm::all_of(atomics, sameElement) && !meetsStore &&
      isInjective(loop, atomics.front().getIndices())) {
    for (AtomicOp atomic : atomics)
      atomic.setExclusive(true);
    return;
  }
  // The reads of iterations in between would miss the updates.
  auto usesOld = [](AtomicOp atomic) { return !atomic.getOld().use_empty(); };
  if (llvm::any_of(atomics, usesOld) ||
      llvm::any_of(atomics, [&](AtomicOp atomic) {
        return llvm::any_of(accesses.others, [&](Operation *other) {
          return mayReach(atomic.getIndices(), getIndices(other));
        });
      }))
    return;
  FailureOr<SmallVector<AccumulationGroup>> groups =
      groupAccumulations(loop, atomics, fields);
  if (failed(groups))
    return;
  // An update may have to make its cell active first.
  if (llvm::any_of(*groups, [](const AccumulationGroup &group) {
        return !group.field->sparse.empty();
      }))
    return;
  // Groups of one field may overlap: all must leave the field alone until the
  // end, or none.
  SmallVector<AccumulationGroup> sums, buffers;
  for (AccumulationGroup &group : *groups) {
    auto isFixed = [&](AtomicOp atomic) {
      return llvm::all_of(atomic.getComponents(), [&](Value component) {
        return getConstantIntValue(component) ||
               loop.isDefinedOutsideOfLoop(component);
      });
    };
    bool isTotal = group.isFixed() && llvm::all_of(group.atomics, isFixed);
    // A GPU's blocks add up totals in f64, too.
    bool isWideTotal = isTotal && !group.field->scalarType.isF64();
    if (!isWideTotal && isWorthWide(group))
      buffers.push_back(std::move(group));
    else if (isTotal)
      sums.push_back(std::move(group));
    else if (!onDevice && !oneOrder && isWorthPrivate(group))
      buffers.push_back(std::move(group));
    else
      return;
  }
  if ((onDevice || oneOrder) && sums.size() > kMaxRegisters)
    return;
  if (onDevice &&
      llvm::all_of(atomics, [&](AtomicOp atomic) { return isWarpSum(atomic); }))
    return;
  if (sums.size() > kMaxRegisters) {
    AccumulationGroup merged = sums.front();
    for (const AccumulationGroup &group : ArrayRef(sums).drop_front())
      mergeGroups(merged, group);
    // Compensated sums have a buffer of their own in any case.
    if (isWorthPrivate(merged) && (compensated || isContiguous(merged))) {
      buffers.push_back(std::move(merged));
      sums.clear();
    }
  }
  for (AccumulationGroup &group : sums)
    for (AtomicOp atomic : group.atomics)
      atomic.setStrategy(AccumulationStrategy::Register);
  for (AccumulationGroup &group : buffers) {
    int64_t number = numBuffers++;
    for (AtomicOp atomic : group.atomics) {
      atomic.setStrategy(AccumulationStrategy::Private);
      atomic.setBuffer(number);
    }
  }
}

static bool isFloatSum(AtomicOp atomic) {
  return isa<FloatType>(getElementTypeOrSelf(atomic.getValue().getType())) &&
         (atomic.getKind() == AtomicKind::Add ||
          atomic.getKind() == AtomicKind::Sub);
}

/// True if the loop has float sums, not those of one iteration, that are kept
/// with more digits than their field has.
bool LoopRelaxation::hasWideSums() {
  return loop
      .walk([&](AtomicOp atomic) {
        bool isWide =
            compensated ||
            (atomic.getStrategy() &&
             is16Bits(getElementTypeOrSelf(atomic.getValue().getType())));
        return isWide && isFloatSum(atomic) && !atomic.getExclusive()
                   ? WalkResult::interrupt()
                   : WalkResult::advance();
      })
      .wasInterrupted();
}

/// Fails at a float sum that would be rounded to its type at each addition.
LogicalResult LoopRelaxation::checkCompensated() {
  constexpr StringLiteral what =
      "sums=\"compensated\" cannot be had for this sum: ";
  if (!compensated)
    return success();
  WalkResult result = loop.walk([&](Operation *op) {
    if (auto atomic = dyn_cast<AtomicOp>(op)) {
      // On a device, blocks add up in f64, which is twice the digits of f32.
      bool isWideTotal =
          isFloatTotal(op) && !atomic.getValue().getType().isF64();
      bool isWide =
          isWideTotal || atomic.getStrategy() == AccumulationStrategy::Private;
      if (!isFloatSum(atomic) || atomic.getExclusive() ||
          (atomic.getStrategy() && (!onDevice || isWide)))
        return WalkResult::advance();
      StringRef why = "its field is sparse or large, or takes other updates "
                      "or reads in the same loop";
      if (!atomic.getOld().use_empty())
        why = "the value before the addition is used";
      else if (onDevice && deterministic)
        why = "on a GPU its bits would depend on the order of threads";
      op->emitError(what) << why << "; give the kernel sums=\"default\"";
      return WalkResult::interrupt();
    }
    auto atomic = dyn_cast<memref::AtomicRMWOp>(op);
    if (!atomic || atomic.getKind() != arith::AtomicRMWKind::addf ||
        !loop.isDefinedOutsideOfLoop(atomic.getMemref()) ||
        op->hasAttr(kAccumulateAttrName) ||
        isInjective(loop, atomic.getIndices()))
      return WalkResult::advance();
    op->emitError(what) << "it is in an array of the caller; give the kernel "
                           "sums=\"default\", or add up in a field";
    return WalkResult::interrupt();
  });
  return failure(result.wasInterrupted());
}

/// True if a warp of a GPU can run the loop.
bool LoopRelaxation::canRunInWarp() {
  if (!oneOrder)
    return canOrderAdditions(loop, fields);
  // Another target has one thread for all of it: sums of all iterations take
  // their turns too.
  bool hasLocalSums = false;
  loop.walk([&](Operation *op) {
    if (!isFloatTotal(op))
      return;
    if (auto atomic = dyn_cast<AtomicOp>(op))
      atomic.removeStrategyAttr();
    else
      hasLocalSums = true;
  });
  return !hasLocalSums && canQueueAdditions(loop, fields);
}

/// Lets the additions of a loop be done in fixed point by all threads of a GPU:
/// three passes over the iterations, and accumulators that are zeroed first.
bool LoopRelaxation::useFixedPoint() {
  // Host code that repeats the loop would zero as many accumulators.
  for (Operation *at = loop->getParentOp(); !isa<FunctionOpInterface>(at);
       at = at->getParentOp())
    if (!isa<scf::IfOp>(at))
      return false;
  SmallVector<AtomicOp> additions;
  if (oneOrder || compensated || !canAddInAnyOrder(loop, fields, additions))
    return false;
  FailureOr<SmallVector<AccumulationGroup>> found =
      groupAccumulations(loop, additions, fields);
  if (failed(found))
    return false;
  // One group for each place: two could not add to one element at a time.
  SmallVector<AccumulationGroup> groups;
  for (AccumulationGroup &group : *found) {
    auto *known = llvm::find_if(groups, [&](const AccumulationGroup &other) {
      return other.field->scope == group.field->scope;
    });
    if (known == groups.end())
      groups.push_back(std::move(group));
    else if (known->field == group.field)
      mergeGroups(*known, group);
    else
      return false;
  }
  double bytes = 0;
  bool hasHalves = false;
  for (const AccumulationGroup &group : groups) {
    if (!group.field->sparse.empty())
      return false;
    hasHalves |= is16Bits(group.field->scalarType);
    bytes += double(getNumAccumulators(group)) *
             getAccumulatorBytes(group.field->scalarType);
  }
  std::optional<int64_t> iterations = getNumIterations(loop);
  double inWarp = iterations ? double(*iterations) * kWarpNanoseconds
                             : std::numeric_limits<double>::infinity();
  // Each addition of 16-bit floats would be rounded otherwise.
  if (bytes > kMaxAccumulatorBytes ||
      (!hasHalves && inWarp < kPassesNanoseconds + bytes * kNanosecondsPerByte))
    return false;
  for (auto [number, group] : llvm::enumerate(groups))
    for (AtomicOp atomic : group.atomics) {
      atomic.setStrategy(AccumulationStrategy::Private);
      atomic.setBuffer(number);
    }
  return true;
}

LogicalResult LoopRelaxation::run() {
  if (loop.getSerialize()) {
    serialize();
    return success();
  }
  // Indices that are the same in all iterations are computed before the loop:
  // they tell which part of a field is updated.
  moveLoopInvariantCode(cast<LoopLikeOpInterface>(loop.getOperation()));

  llvm::MapVector<Attribute, FieldAccesses> places;
  WalkResult result = loop.walk([&](Operation *op) {
    auto access = dyn_cast<FieldAccessOpInterface>(op);
    if (!access || !access.isElementAccess())
      return WalkResult::advance();
    FailureOr<const FieldInfo *> field =
        fields.lookup(op, access.getFieldAttr());
    if (failed(field))
      return WalkResult::interrupt();
    FieldAccesses &accesses = places[(*field)->scope];
    auto atomic = dyn_cast<AtomicOp>(op);
    if (!atomic || atomic.getExclusive())
      accesses.others.push_back(op);
    else
      accesses.atomics.push_back(atomic);
    return WalkResult::advance();
  });
  if (result.wasInterrupted())
    return failure();
  for (auto &[place, accesses] : places)
    if (!accesses.atomics.empty())
      relaxField(accesses);

  // Sums in registers are no memory.
  bool inMemory = false, dependsOnTiming = false;
  loop.walk([&](AtomicOp atomic) {
    if (atomic.getExclusive())
      return;
    std::optional<AccumulationStrategy> strategy = atomic.getStrategy();
    inMemory |= strategy != AccumulationStrategy::Register;
    dependsOnTiming |= !strategy && !isIndependentOfTiming(atomic);
  });
  // Arrays of the caller stay as they are; those of an iteration are its own.
  loop.walk([&](memref::AtomicRMWOp atomic) {
    if (!loop.isDefinedOutsideOfLoop(atomic.getMemref()))
      return;
    if (isLocalSum(atomic, loop)) {
      atomic->setAttr(kAccumulateAttrName,
                      StringAttr::get(atomic.getContext(), kRegister));
      return;
    }
    inMemory = true;
    bool isExtreme = atomic.getKind() == arith::AtomicRMWKind::minimumf ||
                     atomic.getKind() == arith::AtomicRMWKind::maximumf;
    dependsOnTiming |=
        (isa<FloatType>(atomic.getValue().getType()) && !isExtreme) ||
        !atomic.getResult().use_empty();
  });

  if (failed(checkCompensated()))
    return failure();
  std::optional<int64_t> iterations = getNumIterations(loop);
  bool isSmall =
      !onDevice && iterations && !hasWideSums() &&
      !(oneOrder && hasFloatTotals(loop)) &&
      *iterations * estimateIteration(loop, !inMemory) < kForkNanoseconds;
  if (deterministic && dependsOnTiming && onDevice && useFixedPoint()) {
    // All threads run it.
  } else if (deterministic && dependsOnTiming && onDevice && canRunInWarp()) {
    loop.setInWarp(true);
  } else if (isSmall || (deterministic && dependsOnTiming)) {
    loop.walk([&](AtomicOp atomic) { inMemory |= !atomic.getExclusive(); });
    serialize();
  }
  if (!inMemory && !loop.getInOrder())
    loop->setAttr(kIndependentAttrName, UnitAttr::get(loop.getContext()));
  return success();
}

namespace {
struct RelaxAtomics : tai::impl::RelaxAtomicsBase<RelaxAtomics> {
  using Base::Base;

  void runOnOperation() override {
    Operation *table = SymbolTable::getNearestSymbolTable(getOperation());
    if (!table)
      return;
    FieldTable fields(table);
    SmallVector<ParallelForOp> loops;
    getOperation()->walk([&](Operation *op) {
      if (auto loop = dyn_cast<ParallelForOp>(op))
        loops.push_back(loop);
      // Serial code of a kernel runs on one thread.
      auto atomic = dyn_cast<AtomicOp>(op);
      if (atomic && !op->getParentOfType<ParallelForOp>())
        atomic.setExclusive(true);
    });
    for (ParallelForOp loop : loops)
      if (failed(LoopRelaxation(loop, fields, deterministic, Modes::of(loop),
                                onDevice)
                     .run()))
        return signalPassFailure();
  }
};
} // namespace
