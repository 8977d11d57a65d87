//===- ReductionPlan.cpp - How a parallel loop does its updates -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// On CPUs, an atomic float addition is a compare-and-exchange loop, which
// prevents vectorisation. Nearly all accumulations of simulators and of their
// adjoints do not need atomics: each iteration has its own element, or all
// iterations share one, or the updated part of the field is small.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Reductions/ReductionPlan.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/Cost.h"
#include "tai/Analysis/Reductions/Accumulation.h"
#include "tai/Analysis/Reductions/OrderedAdditions.h"
#include "tai/Dialect/Tai/IR/Modes.h"

using namespace mlir;
using namespace mlir::tai;

/// The number of iterations in a block, which has a sum of its own: few enough
/// that the rounding error of a sum in the type itself is small, and enough to
/// amortise the horizontal addition of vector lanes.
constexpr int64_t kBlock = 2048;
/// The number of iterations in a block if the pass WidenSums keeps its sums in
/// f64: that is possible if all updates are directly in the innermost loop.
constexpr int64_t kWidenedBlock = 8192;
/// The number of iterations in a block of a sum of pairs (sum and rounding
/// error). The terms of a block are stored, and must fit the L1 cache.
constexpr int64_t kBlockOfTerms = 1024;
/// With fewer iterations than kFewIterations, or with more updates in an
/// iteration than kMostUpdates, a loop adds the terms of a compensated f64 sum
/// one after another.
constexpr int64_t kFewIterations = 64;
constexpr size_t kMostUpdates = 4;

/// If an element gets at least this many updates, a loop sums f32 in buffers of
/// f64, since each addition rounds once.
constexpr double kWideUpdates = 256;

/// A sum of more 16-bit terms than this is wide on a GPU: a 16-bit float does
/// not change when less than a two-thousandth of it is added.
constexpr int64_t kFewTermsOf16Bits = 32;

/// If one field has more sums than this, they are held in a buffer rather than
/// in registers: usually they are adjacent (the weights of an unrolled sum), so
/// that LLVM updates them as vectors, whereas it would spill so many registers.
constexpr size_t kMaxRegisters = 8;

/// A loop on a GPU with at most this many iterations, and as many threads, does
/// not reduce its sums over blocks.
constexpr int64_t kMaxWarpSums = 1024;

/// The most elements in a private buffer: larger buffers would fill the memory
/// of a machine with many cores.
constexpr int64_t kMaxPrivateElements = int64_t(1) << 24;

/// Measured costs on a GPU in deterministic mode: of an iteration, if one warp
/// runs the loop; of the three passes over the iterations that sums in fixed
/// point take instead; and of each byte of their accumulators. Also the maximum
/// size of all accumulators of a field.
constexpr double kWarpNanoseconds = 80, kPassesNanoseconds = 10000;
constexpr double kNanosecondsPerByte = 1e-3;
constexpr double kMaxAccumulatorBytes = int64_t(1) << 29;

/// The most elements of a local array whose sums are kept in registers: the
/// size of a matrix.
constexpr int64_t kMaxLocalSums = 16;

namespace {
/// The accesses of a loop to one field, sorted by kind.
struct FieldAccesses {
  SmallVector<AtomicOp> atomics; // those that are not exclusive yet
  SmallVector<Operation *> others;
};

class Planner {
public:
  Planner(ParallelForOp loop, FieldTable &fields, const Modes &modes,
          bool onDevice)
      : loop(loop), fields(fields), compensated(modes.isCompensated()),
        onDevice(onDevice) {
    if (modes.hasOneOrder())
      plan.order = LoopOrder::Common;
    else if (modes.isDeterministic())
      plan.order = LoopOrder::Fixed;
  }

  FailureOr<ReductionPlan> run();

private:
  bool isDeterministic() const { return plan.order.has_value(); }
  /// True if the terms of sums must be added in an order that is the same on
  /// all targets.
  bool hasOneOrder() const { return plan.order == LoopOrder::Common; }
  ReductionForm getForm(Operation *op) const {
    return plan.updates.lookup(op).reduction.getForm();
  }
  /// Sets the form of an update's reduction. The digits and the order are added
  /// later, by chooseDigits.
  void setForm(Operation *op, ReductionForm form,
               std::optional<int64_t> buffer = std::nullopt) {
    plan.updates[op].reduction =
        ReductionAttr::get(op->getContext(), form, SumDigits::Own,
                           ReductionOrder::Any, /*block=*/0, buffer);
  }
  bool isFloatTotal(Operation *op) const;
  bool hasFloatTotals() const;
  void serialize();
  bool isIndependentOfTiming(AtomicOp atomic);
  bool mayReach(ValueRange a, ValueRange b);
  StringRef planField(FieldAccesses &accesses);
  bool isWorthPrivate(const AccumulationGroup &group);
  bool isWarpSum(AtomicOp atomic);
  bool isWorthWide(const AccumulationGroup &group);
  bool hasWideSums();
  bool canRunInWarp();
  bool useFixedPoint();
  LogicalResult checkCompensated();
  SumDigits getTotalDigits(Operation *update);
  void chooseDigits();

  ParallelForOp loop;
  FieldTable &fields;
  bool compensated, onDevice;
  /// For each buffer, by its number: the group of updates that it accumulates.
  SmallVector<AccumulationGroup> buffers;
  ReductionPlan plan;
};
} // namespace

/// True if the update adds to a small array of the kernel that nothing but such
/// updates accesses in the loop: adjoints of values that the body of a loop
/// captures.
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

/// Makes the loop run on one thread, where no update is atomic.
void Planner::serialize() {
  plan.isSerial = true;
  for (auto &[op, update] : plan.updates)
    update = {isa<AtomicOp>(op), ReductionAttr(), ""};
}

/// True for updates whose result does not depend on their order, such as
/// integer sums, if the previous value is not used.
bool Planner::isIndependentOfTiming(AtomicOp atomic) {
  if (!atomic.getOld().use_empty())
    return false;
  Type type = getElementTypeOrSelf(atomic.getValue().getType());
  return !isa<FloatType>(type) || atomic.getKind() == AtomicKind::Min ||
         atomic.getKind() == AtomicKind::Max;
}

static bool is16Bits(Type type) {
  return isa<FloatType>(type) && type.getIntOrFloatBitWidth() == 16;
}

static bool isSum(AtomicKind kind) {
  return kind == AtomicKind::Add || kind == AtomicKind::Sub;
}

static bool isFloatSum(AtomicOp atomic) {
  return isa<FloatType>(getElementTypeOrSelf(atomic.getValue().getType())) &&
         isSum(atomic.getKind());
}

/// True for a float sum or product of all iterations that the loop keeps out of
/// memory.
bool Planner::isFloatTotal(Operation *op) const {
  if (!plan.isDoneByLoop(op) || getForm(op) != ReductionForm::Register)
    return false;
  AtomicKind kind = getCombiningKind(op);
  return isa<FloatType>(getElementTypeOrSelf(getTermType(op))) &&
         (kind == AtomicKind::Add || kind == AtomicKind::Mul);
}

bool Planner::hasFloatTotals() const {
  return llvm::any_of(plan.updates,
                      [&](auto &entry) { return isFloatTotal(entry.first); });
}

/// Returns the slice of the field that a group of updates reaches.
static std::optional<FieldSlice> getSlice(const AccumulationGroup &group) {
  SmallVector<bool> fixed =
      llvm::map_to_vector(group.fixed, [](Value index) { return bool(index); });
  return FieldTable::getSlice(*group.field, fixed);
}

/// True if buffers for the updated part of the field cost less than the atomic
/// updates.
bool Planner::isWorthPrivate(const AccumulationGroup &group) {
  const FieldInfo &field = *group.field;
  bool isFloat = isa<FloatType>(field.scalarType);
  if (!isFloat && !field.scalarType.isInteger(32) &&
      !field.scalarType.isInteger(64))
    return false;
  double updates = 0;
  for (AtomicOp atomic : group.atomics) {
    if (!isSum(atomic.getKind()))
      return false;
    updates += estimateRuns(atomic, loop);
  }
  std::optional<FieldSlice> slice = getSlice(group);
  if (!slice)
    return false;
  int64_t elements = slice->numCells * field.numComponents;
  if (elements > kMaxPrivateElements)
    return false;
  // A sum of 16 bits would stop growing after some hundred additions, so it
  // always has a wider buffer.
  if (isFloat && (compensated || is16Bits(field.scalarType)))
    return true;
  // If the number of iterations is unknown, the decision is made at run time: a
  // loop with few iterations runs as one partition, which needs no buffers.
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

/// False if `a` and `b` differ at a position where both have an index that is
/// the same in all iterations, such as the time slot: accesses at `a` and `b`
/// then reach different elements in any two iterations.
bool Planner::mayReach(ValueRange a, ValueRange b) {
  for (auto [x, y] : llvm::zip_equal(a, b))
    if (loop.isDefinedOutsideOfLoop(x) && loop.isDefinedOutsideOfLoop(y) &&
        areProvablyDistinct(x, y))
      return false;
  return true;
}

/// True if a GPU adds up the terms in each warp, and then makes one atomic
/// addition for each warp: a loop with so few warps is then faster than with a
/// reduction over blocks.
bool Planner::isWarpSum(AtomicOp atomic) {
  std::optional<int64_t> iterations = getNumIterations(loop);
  if (isDeterministic() || compensated || !iterations ||
      *iterations > kMaxWarpSums || atomic.getKind() != AtomicKind::Add ||
      !atomic.getValue().getType().isF32())
    return false;
  // The update must not be in an inner loop, where each iteration would make an
  // atomic addition.
  Operation *around = atomic->getParentOp();
  while (isa<scf::IfOp>(around))
    around = around->getParentOp();
  return around == loop;
}

/// True if host code within the kernel may run the loop several times in one
/// launch.
static bool isRepeated(ParallelForOp loop) {
  for (Operation *at = loop->getParentOp(); !isa<FunctionOpInterface>(at);
       at = at->getParentOp())
    if (!isa<scf::IfOp>(at))
      return true;
  return false;
}

/// True if sums of a loop on a GPU are kept in f64 beside the field, and
/// rounded once: compensated sums, sums of 16-bit floats, which stop growing at
/// some thousand terms, and sums of f32 with many terms for each element.
bool Planner::isWorthWide(const AccumulationGroup &group) {
  Type scalar = group.field->scalarType;
  if (!onDevice || isDeterministic() || !isa<FloatType>(scalar))
    return false;
  double elements = double(getNumAccumulators(group)), updates = 0;
  for (AtomicOp atomic : group.atomics)
    updates += estimateRuns(atomic, loop);
  std::optional<int64_t> iterations = getNumIterations(loop);
  bool hasMany = scalar.isF32() && iterations &&
                 double(*iterations) * updates > double(kFewTerms) * elements;
  if (!compensated && !is16Bits(scalar) && !hasMany)
    return false;
  // A loop that host code repeats does not get sums of this kind, because each
  // of its runs would need sums of its own.
  return !isRepeated(loop) && elements * 16 <= kMaxAccumulatorBytes &&
         llvm::all_of(group.atomics,
                      [](AtomicOp atomic) { return isSum(atomic.getKind()); });
}

/// Chooses forms for the updates of one field. Returns the reason if the
/// updates stay atomic.
StringRef Planner::planField(FieldAccesses &accesses) {
  SmallVector<AtomicOp> &atomics = accesses.atomics;
  // Where a branch was turned into a select, a plain update adds zero in
  // iterations that do not take the branch, and could overwrite a store of
  // another iteration.
  auto meetsStore = [&](AtomicOp atomic) {
    ValueRange indices = atomic.getIndices();
    return llvm::any_of(accesses.others, [&](Operation *other) {
      return isa<StoreOp>(other) && !llvm::equal(getIndices(other), indices) &&
             mayReach(getIndices(other), indices);
    });
  };
  if (haveOwnElements(loop, atomics) && llvm::none_of(atomics, meetsStore)) {
    for (AtomicOp atomic : atomics)
      plan.updates[atomic].isExclusive = true;
    return "";
  }
  // An iteration that reads an old value would miss updates that are still in
  // registers or buffers.
  if (llvm::any_of(atomics, [](AtomicOp atomic) {
        return !atomic.getOld().use_empty();
      }))
    return "the value before an update is used";
  if (llvm::any_of(atomics, [&](AtomicOp atomic) {
        return llvm::any_of(accesses.others, [&](Operation *other) {
          return mayReach(atomic.getIndices(), getIndices(other));
        });
      }))
    return "the loop has other accesses to the field";
  FailureOr<SmallVector<AccumulationGroup>> groups =
      groupAccumulations(loop, atomics, fields);
  if (failed(groups))
    return "the field cannot be lowered";
  if (llvm::any_of(*groups, [](const AccumulationGroup &group) {
        return !group.field->sparse.empty();
      }))
    return "an update may have to make its cell active";
  // Groups of one field may overlap: either all of them or none may delay their
  // updates to the end of the loop.
  SmallVector<AccumulationGroup> sums, inBuffers;
  for (AccumulationGroup &group : *groups) {
    auto isFixed = [&](AtomicOp atomic) {
      return llvm::all_of(atomic.getComponents(), [&](Value component) {
        return getConstantIntValue(component) ||
               loop.isDefinedOutsideOfLoop(component);
      });
    };
    bool isTotal = group.isFixed() && llvm::all_of(group.atomics, isFixed);
    // The blocks of a GPU also add up sums of all iterations in f64.
    bool isWideTotal = isTotal && !group.field->scalarType.isF64();
    if (!isWideTotal && isWorthWide(group))
      inBuffers.push_back(std::move(group));
    else if (isTotal)
      sums.push_back(std::move(group));
    else if (!onDevice && !hasOneOrder() && isWorthPrivate(group))
      inBuffers.push_back(std::move(group));
    else
      return onDevice        ? "a GPU adds quickly to elements that vary"
             : hasOneOrder() ? "buffers would add in another order than a GPU"
                             : "buffers would cost more than the updates";
  }
  if ((onDevice || hasOneOrder()) && sums.size() > kMaxRegisters)
    return "there are more sums than registers for them";
  if (onDevice &&
      llvm::all_of(atomics, [&](AtomicOp atomic) { return isWarpSum(atomic); }))
    return "few warps have an addition each";
  if (sums.size() > kMaxRegisters) {
    AccumulationGroup merged = sums.front();
    for (const AccumulationGroup &group : ArrayRef(sums).drop_front())
      mergeGroups(merged, group);
    // A compensated sum always has its own buffer, so its part of the field
    // need not be contiguous.
    if (isWorthPrivate(merged) && (compensated || isContiguous(merged))) {
      inBuffers.push_back(std::move(merged));
      sums.clear();
    }
  }
  for (AccumulationGroup &group : sums)
    for (AtomicOp atomic : group.atomics)
      setForm(atomic, ReductionForm::Register);
  for (AccumulationGroup &group : inBuffers) {
    for (AtomicOp atomic : group.atomics)
      setForm(atomic, ReductionForm::Buffer, buffers.size());
    buffers.push_back(std::move(group));
  }
  return "";
}

/// True if the loop has float sums over several iterations that are kept with
/// more digits than their field has.
bool Planner::hasWideSums() {
  return llvm::any_of(plan.updates, [&](auto &entry) {
    auto atomic = dyn_cast<AtomicOp>(entry.first);
    return atomic && isFloatSum(atomic) && !entry.second.isExclusive &&
           (compensated ||
            (entry.second.reduction &&
             is16Bits(getElementTypeOrSelf(atomic.getValue().getType()))));
  });
}

/// In mode sums="compensated", emits an error and fails if a float sum would be
/// rounded to its own type at each addition.
LogicalResult Planner::checkCompensated() {
  constexpr StringLiteral what =
      "sums=\"compensated\" cannot be had for this sum: ";
  if (!compensated)
    return success();
  for (auto &[op, update] : plan.updates) {
    if (auto atomic = dyn_cast<AtomicOp>(op)) {
      // On a GPU, blocks add up narrower sums in f64, which has twice the
      // digits of f32.
      bool isWideTotal =
          isFloatTotal(op) && !atomic.getValue().getType().isF64();
      bool isWide = isWideTotal ||
                    (update.reduction && getForm(op) == ReductionForm::Buffer);
      if (!isFloatSum(atomic) || update.isExclusive ||
          (update.reduction && (!onDevice || isWide)))
        continue;
      StringRef why = "its field is sparse or large, or takes other updates "
                      "or reads in the same loop";
      if (!atomic.getOld().use_empty())
        why = "the value before the addition is used";
      else if (onDevice && isDeterministic())
        why = "on a GPU its bits would depend on the order of threads";
      return op->emitError(what) << why << "; give the kernel sums=\"default\"";
    }
    auto atomic = cast<memref::AtomicRMWOp>(op);
    if (atomic.getKind() != arith::AtomicRMWKind::addf || update.reduction ||
        isInjective(loop, atomic.getIndices()))
      continue;
    return op->emitError(what)
           << "it is in an array of the caller; give the kernel "
              "sums=\"default\", or add up in a field";
  }
  return success();
}

/// True if a warp of a GPU can run the loop in the required order.
bool Planner::canRunInWarp() {
  if (!hasOneOrder())
    return canOrderAdditions(loop, fields, plan);
  // On other targets, one thread runs the loop if all targets must use the same
  // order. To match, the warp must add the terms of sums over all iterations
  // one after another, too.
  bool hasLocalSums = false;
  for (auto &[op, update] : plan.updates) {
    if (!isFloatTotal(op))
      continue;
    if (isa<AtomicOp>(op))
      update.reduction = {};
    else
      hasLocalSums = true;
  }
  return !hasLocalSums && canQueueAdditions(loop, fields, plan);
}

/// Lets all threads of a GPU do the additions of a loop in fixed point: in
/// three passes over the iterations, with accumulators that start at zero.
bool Planner::useFixedPoint() {
  // A loop that host code repeats is refused, because each of its runs would
  // set the accumulators to zero.
  SmallVector<AtomicOp> additions;
  if (hasOneOrder() || compensated || isRepeated(loop) ||
      !canAddInAnyOrder(loop, fields, plan, additions))
    return false;
  FailureOr<SmallVector<AccumulationGroup>> found =
      groupAccumulations(loop, additions, fields);
  if (failed(found))
    return false;
  // All groups of one storage are merged, because two groups could add to the
  // same element at the same time.
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
  // 16-bit floats always take fixed point: otherwise each addition would be
  // rounded.
  if (bytes > kMaxAccumulatorBytes ||
      (!hasHalves && inWarp < kPassesNanoseconds + bytes * kNanosecondsPerByte))
    return false;
  for (auto [number, group] : llvm::enumerate(groups))
    for (AtomicOp atomic : group.atomics)
      setForm(atomic, ReductionForm::Fixed, number);
  return true;
}

/// Returns the number of iterations of `loop`, as far as its extents are
/// constant; unknown extents count as 1.
static double countIterations(ParallelForOp loop) {
  double count = 1;
  for (auto [from, to] :
       llvm::zip(loop.getLowerBounds(), loop.getUpperBounds())) {
    std::optional<int64_t> low = getConstantIntValue(from);
    std::optional<int64_t> high = getConstantIntValue(to);
    if (low && high)
      count *= std::max<double>(0, double(*high) - double(*low));
  }
  return count;
}

/// True if each update is directly in the body of the innermost loop to which
/// `loop` will be lowered, so that it runs at most once in an iteration.
static bool areMadeOnce(ArrayRef<Operation *> updates, ParallelForOp loop) {
  for (Operation *update : updates)
    for (Operation *parent = update->getParentOp(); parent != loop;
         parent = parent->getParentOp())
      // The branch is an interior that the pass tai-split-index-sets will move
      // out of the loop.
      if (!isa<scf::IfOp>(parent) || parent->hasAttr("tai.interior"))
        return false;
  return true;
}

/// True if the terms of `updates` can be stored in a buffer, and this is worth
/// the memory of the buffer.
static bool canStoreTerms(ArrayRef<Operation *> updates, ParallelForOp loop) {
  if (updates.size() > kMostUpdates || loop.isStructFor() ||
      !areMadeOnce(updates, loop))
    return false;
  std::optional<int64_t> lower =
      getConstantIntValue(loop.getLowerBounds().back());
  std::optional<int64_t> upper =
      getConstantIntValue(loop.getUpperBounds().back());
  return !lower || !upper || *upper - *lower >= kFewIterations;
}

/// Returns the digits (the precision) of a precise sum or product of terms of
/// `type`, by the table in Forms.def.
static SumDigits getPreciseDigits(AtomicKind kind, Type type) {
  constexpr bool F64 = true, Narrow = false;
#define TAI_PRECISE_TOTAL(rowKind, terms, digits, form)                        \
  if (kind == AtomicKind::rowKind && type.isF64() == terms)                    \
    return SumDigits::digits;
#include "tai/Analysis/Reductions/Forms.def"
  return SumDigits::Own;
}

/// Returns the digits (the precision) in which a sum over all iterations is
/// kept.
SumDigits Planner::getTotalDigits(Operation *update) {
  Type type = getTermType(update);
  AtomicKind kind = getCombiningKind(update);
  if (!isa<FloatType>(type))
    return SumDigits::Own;
  if (!onDevice)
    return compensated ? getPreciseDigits(kind, type) : SumDigits::Own;
  if (kind != AtomicKind::Add)
    return SumDigits::Own;
  // On a GPU, each thread accumulates in f64 anyway; the digits decide how
  // blocks combine their sums.
  if (isDeterministic() || type.isF64())
    return SumDigits::Own;
  std::optional<int64_t> count = getNumIterations(loop);
  int64_t few = type.isF32() ? kFewTerms : kFewTermsOf16Bits;
  return !count || *count > few || compensated ? SumDigits::Wide
                                               : SumDigits::Own;
}

/// Chooses digits and order of the sums that the loop itself keeps (in
/// registers or buffers).
void Planner::chooseDigits() {
  // If the loop's cost is fixed and it has inner loops, sums keep the order of
  // iterations: LLVM would choose another order after passes have left out
  // work. In other loops, LLVM sees the same code in any case.
  bool keepsOrder = loop.getFixedCostAttr() &&
                    (loop.getOuterDims() ||
                     loop.walk([&](LoopLikeOpInterface inner) {
                           return inner == loop ? WalkResult::advance()
                                                : WalkResult::interrupt();
                         })
                         .wasInterrupted());
  std::optional<int64_t> iterations = getNumIterations(loop);
  bool isShort = iterations && *iterations <= kBlock;
  SmallVector<Operation *> inRegisters;
  for (auto &[op, update] : plan.updates)
    if (update.reduction && getForm(op) == ReductionForm::Register)
      inRegisters.push_back(op);
  SmallVector<Total> totals = groupTotals(inRegisters);
  auto isInBlocks = [&](const Total &total) {
    Operation *update = total.front();
    return !onDevice && !isShort && isa<FloatType>(getTermType(update)) &&
           getCombiningKind(update) == AtomicKind::Add &&
           getTotalDigits(update) == SumDigits::Own && !hasOneOrder();
  };
  bool areWidened =
      !keepsOrder && llvm::all_of(totals, [&](const Total &total) {
        return !isInBlocks(total) || (!getTermType(total.front()).isF64() &&
                                      areMadeOnce(total, loop));
      });
  MLIRContext *context = loop.getContext();
  for (const Total &total : totals) {
    SumDigits digits = getTotalDigits(total.front());
    int64_t block = 0;
    if (isInBlocks(total))
      block = areWidened ? kWidenedBlock : kBlock;
    else if (digits == SumDigits::Pair && canStoreTerms(total, loop))
      block = kBlockOfTerms;
    ReductionOrder order =
        keepsOrder ? ReductionOrder::Iterations : ReductionOrder::Any;
    if (isDeterministic() && isFloatTotal(total.front()) &&
        (onDevice || hasOneOrder()))
      order = hasOneOrder() ? ReductionOrder::Common : ReductionOrder::Lanes;
    auto reduction = ReductionAttr::get(context, ReductionForm::Register,
                                        digits, order, block, std::nullopt);
    for (Operation *op : total)
      plan.updates[op].reduction = reduction;
  }
  for (auto [number, group] : llvm::enumerate(buffers)) {
    Type scalar = group.field->scalarType;
    bool isWide = onDevice || is16Bits(scalar) || compensated;
    if (!isWide && scalar.isF32()) {
      double updates = 0;
      for (AtomicOp atomic : group.atomics)
        updates += estimateRuns(atomic, loop);
      std::optional<FieldSlice> slice = getSlice(group);
      int64_t elements = slice->numCells * group.field->numComponents;
      isWide =
          updates * countIterations(loop) >= kWideUpdates * double(elements);
    }
    SumDigits digits = !isWide || !isa<FloatType>(scalar) ? SumDigits::Own
                       : scalar.isF64()                   ? SumDigits::Pair
                                                          : SumDigits::Wide;
    for (AtomicOp atomic : group.atomics)
      plan.updates[atomic].reduction =
          ReductionAttr::get(context, ReductionForm::Buffer, digits,
                             ReductionOrder::Any, /*block=*/0, number);
  }
}

FailureOr<ReductionPlan> Planner::run() {
  llvm::MapVector<Attribute, FieldAccesses> places;
  WalkResult result = loop.walk([&](Operation *op) {
    if (auto sum = dyn_cast<memref::AtomicRMWOp>(op);
        sum && loop.isDefinedOutsideOfLoop(sum.getMemref()))
      plan.updates[op].reason = "it is in an array";
    auto access = dyn_cast<FieldAccessOpInterface>(op);
    if (!access || !access.isElementAccess())
      return WalkResult::advance();
    FailureOr<const FieldInfo *> field =
        fields.lookup(op, access.getFieldAttr());
    if (failed(field))
      return WalkResult::interrupt();
    FieldAccesses &accesses = places[(*field)->scope];
    auto atomic = dyn_cast<AtomicOp>(op);
    if (atomic)
      plan.updates[op].isExclusive = atomic.getExclusive();
    if (!atomic || atomic.getExclusive())
      accesses.others.push_back(op);
    else
      accesses.atomics.push_back(atomic);
    return WalkResult::advance();
  });
  if (result.wasInterrupted())
    return failure();
  if (loop.getSerialize()) {
    serialize();
    return std::move(plan);
  }
  for (auto &[place, accesses] : places)
    if (!accesses.atomics.empty()) {
      StringRef reason = planField(accesses);
      for (AtomicOp atomic : accesses.atomics)
        plan.updates[atomic].reason = reason;
    }

  // A sum that is kept in a register does not access memory in the loop.
  bool inMemory = false, dependsOnTiming = false;
  for (auto &[op, update] : plan.updates) {
    if (auto atomic = dyn_cast<AtomicOp>(op)) {
      if (update.isExclusive)
        continue;
      inMemory |= !update.reduction || getForm(op) != ReductionForm::Register;
      dependsOnTiming |= !update.reduction && !isIndependentOfTiming(atomic);
      continue;
    }
    auto atomic = cast<memref::AtomicRMWOp>(op);
    if (isLocalSum(atomic, loop)) {
      setForm(op, ReductionForm::Register);
      update.reason = "";
      continue;
    }
    inMemory = true;
    bool isExtreme = atomic.getKind() == arith::AtomicRMWKind::minimumf ||
                     atomic.getKind() == arith::AtomicRMWKind::maximumf;
    dependsOnTiming |=
        (isa<FloatType>(atomic.getValue().getType()) && !isExtreme) ||
        !atomic.getResult().use_empty();
  }

  if (failed(checkCompensated()))
    return failure();
  std::optional<int64_t> iterations = getNumIterations(loop);
  bool isSmall =
      !onDevice && iterations && !hasWideSums() &&
      !(hasOneOrder() && hasFloatTotals()) &&
      *iterations * estimateIteration(loop, !inMemory) < kForkNanoseconds;
  bool needsOrder = isDeterministic() && dependsOnTiming;
  if (needsOrder && onDevice && useFixedPoint()) {
    // With sums in fixed point, all threads run the loop, not a single warp.
  } else if (needsOrder && onDevice && canRunInWarp()) {
    plan.inWarp = true;
  } else if (isSmall || needsOrder) {
    for (auto &[op, update] : plan.updates)
      inMemory |= isa<AtomicOp>(op) && !update.isExclusive;
    serialize();
  }
  plan.isIndependent = !inMemory && !loop.getInOrder();
  if (!plan.isSerial)
    chooseDigits();
  return std::move(plan);
}

void ReductionPlan::apply(ParallelForOp loop) const {
  MLIRContext *context = loop.getContext();
  for (auto &[op, update] : updates) {
    if (auto atomic = dyn_cast<AtomicOp>(op)) {
      atomic.setExclusive(update.isExclusive);
      if (update.reduction)
        atomic.setReductionAttr(update.reduction);
      else
        atomic.removeReductionAttr();
    } else if (update.reduction) {
      op->setAttr(kAccumulateAttrName, update.reduction);
    } else {
      op->removeAttr(kAccumulateAttrName);
    }
  }
  if (order)
    loop.setOrder(*order);
  if (inWarp)
    loop.setInWarp(true);
  if (isIndependent)
    loop->setAttr(kIndependentAttrName, UnitAttr::get(context));
  if (!isSerial)
    return;
  loop.setSerialize(true);
  // Without its marks, tai-split-index-sets does not split the loop. It would
  // run the borders after the interior, in another order.
  if (order == LoopOrder::Common)
    loop.walk([](scf::IfOp branch) { branch->removeAttr("tai.interior"); });
}

bool tai::hasFixedBits(Operation *op) {
  return Modes::of(op).isDeterministic();
}

bool tai::hasCommonOrder(Operation *op) { return Modes::of(op).hasOneOrder(); }

TermSum tai::planGatheredSum(ParallelForOp loop, Type scalar, bool pairs) {
  if (!Modes::of(loop).isCompensated())
    return TermSum::Plain;
  return scalar.isF64() && !pairs ? TermSum::Unavailable : TermSum::WithErrors;
}

FailureOr<ReductionPlan>
tai::planReductions(ParallelForOp loop, FieldTable &fields, bool onDevice) {
  return Planner(loop, fields, Modes::of(loop), onDevice).run();
}
