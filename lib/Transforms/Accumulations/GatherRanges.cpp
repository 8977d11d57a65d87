//===- GatherRanges.cpp - Gathers over ranges of the launch ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The adjoint of a stencil over arrays, or to a bound that the launch chooses,
// adds to elements at constant distances from the iteration. The iteration that
// owns an element makes all additions to it, as in `tai-scatter-to-gather`, but
// the ranges are values of the launch:
//
//   the interior, where all terms exist, is a loop without tests;
//   the elements near the ends of each dimension are a loop with a test for
//   each term;
//   everything else that the loop does follows in a copy without the additions.
//
// Arrays of the caller may overlap, and ranges may be shorter than the stencil:
// for such launches the loop stays as it was.
//
//===----------------------------------------------------------------------===//

#include "LoopMemory.h"
#include "Recomputation.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/IR/Matchers.h"
#include "mlir/IR/Remarks.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Analysis/AccessOrder.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/Index/IndexBuilder.h"
#include "tai/Analysis/IndexBounds.h"
#include "tai/Analysis/IterationOrder.h"
#include "tai/Analysis/Reductions/ReductionPlan.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Support/BoundsMode.h"
#include "tai/Transforms/Passes.h"
#include "tai/Transforms/Utils/ArrayRanges.h"
#include "llvm/ADT/MapVector.h"

namespace mlir::tai {
#define GEN_PASS_DEF_GATHERRANGES
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

using Access = DifferentiableAccessInterface;

/// The largest distance between an iteration and an element that it adds to.
constexpr int64_t kMaxOffset = 64;

namespace {
/// An addition to the element at a constant offset from the iteration.
struct Term {
  Access op;
  /// The `scf.if` ops around `op`, outermost first.
  SmallVector<scf::IfOp> conditions;
  /// For each index of the loop, the position of the index of the element that
  /// follows it, and the distance.
  SmallVector<unsigned> position;
  SmallVector<int64_t> offset;
};

/// Additions to one slice of one storage.
using TermGroup = SmallVector<Term, 0>;

/// The gathered form of a loop.
struct GatherPlan {
  SmallVector<TermGroup, 0> groups;
  /// The least and the largest offset along each index of the loop.
  SmallVector<int64_t> least, largest;
  LoopArrays arrays;

  int64_t getWidth(unsigned k) const { return largest[k] - least[k]; }
};

/// Finds the additions of a loop that can be gathered.
class GatherPlanner {
public:
  GatherPlanner(ParallelForOp loop, unsigned maxOps)
      : loop(loop), box{loop, {}, {}}, maxOps(maxOps) {}

  std::optional<GatherPlan> run();

private:
  std::optional<Term> getTerm(Access op);
  bool isApart(Access first, Access second);
  bool isStable(Access load);
  void gatherStorage(ArrayRef<Access> accesses, GatherPlan &plan);
  bool limit(GatherPlan &plan);

  ParallelForOp loop;
  LoopBox box;
  unsigned maxOps;
  llvm::MapVector<const void *, SmallVector<Access>> accesses;
};
} // namespace

static ElementPlace getPlace(Access access) {
  return {access.getAccessIndices(), access.getAccessComponents()};
}

/// Describes an addition, if its owner can make it.
std::optional<Term> GatherPlanner::getTerm(Access op) {
  Type type = op.getAccessedValue().getType();
  if (op.getAccessKind() != AccessKind::Accumulate || op.isNegated() ||
      !isFloatOrVector(type) || !op->use_empty())
    return std::nullopt;
  std::optional<SmallVector<scf::IfOp>> conditions = getConditions(op, box);
  if (!conditions)
    return std::nullopt;
  Term term{op, std::move(*conditions), {}, {}};
  unsigned numIvs = loop.getInductionVars().size();
  SmallVector<std::optional<unsigned>> position(numIvs);
  term.offset.resize(numIvs);
  for (auto [p, index] : llvm::enumerate(op.getAccessIndices())) {
    IndexExpr shift = getIndexExpr(index);
    const auto *found = llvm::find_if(loop.getInductionVars(), [&](Value iv) {
      return shift.getCoefficient(iv) == 1;
    });
    if (found == loop.getInductionVars().end()) {
      if (shift.allOf(
              [&](Value value) { return loop.isDefinedOutsideOfLoop(value); }))
        continue;
      return std::nullopt;
    }
    unsigned k = found - loop.getInductionVars().begin();
    shift.add(IndexExpr(Value(*found)), -1);
    if (!shift.isConstant() || !shift.isExact() || position[k] ||
        std::abs(shift.constant) > kMaxOffset)
      return std::nullopt;
    position[k] = p;
    term.offset[k] = shift.constant;
  }
  for (Value component : op.getAccessComponents())
    if (!matchPattern(component, m_Constant()))
      return std::nullopt;
  if (!llvm::all_of(position, [](auto p) { return p.has_value(); }))
    return std::nullopt;
  for (std::optional<unsigned> p : position)
    term.position.push_back(*p);
  return term;
}

/// True if the accesses, to one storage, never reach the same element.
bool GatherPlanner::isApart(Access first, Access second) {
  ElementPlace a = getPlace(first), b = getPlace(second);
  return (areProvablyDistinct(a.indices, b.indices) ||
          (!a.components.empty() &&
           areProvablyDistinct(a.components, b.components))) &&
         !mayMeet(loop, a, b);
}

/// True if the loops of the additions, which run before everything else that
/// the loop does, read by `load` what the loop itself would have read.
bool GatherPlanner::isStable(Access load) {
  return llvm::all_of(accesses[getStorageKey(load)], [&](Access write) {
    if (write.getAccessKind() == AccessKind::Read || isApart(load, write))
      return true;
    // The iteration itself writes after it has read.
    Operation *first = load, *second = write;
    return getConditions(load, box) && findCommonBlock(first, second) &&
           first != second && first->isBeforeInBlock(second) &&
           !mayMeet(loop, getPlace(load), getPlace(write));
  });
}

static bool isSameSlice(const Term &lhs, const Term &rhs) {
  Access a = lhs.op, b = rhs.op;
  if (!areProvablyEqual(a.getAccessComponents(), b.getAccessComponents()))
    return false;
  for (auto [p, pair] : llvm::enumerate(
           llvm::zip_equal(a.getAccessIndices(), b.getAccessIndices())))
    if (!llvm::is_contained(lhs.position, p) &&
        !areProvablyEqual(std::get<0>(pair), std::get<1>(pair)))
      return false;
  return true;
}

/// Adds the additions to one storage to the plan, if nothing else in the loop
/// depends on them.
void GatherPlanner::gatherStorage(ArrayRef<Access> all, GatherPlan &plan) {
  SmallVector<Term, 0> terms;
  bool isShifted = false;
  for (Access op : all) {
    if (op.getAccessKind() != AccessKind::Accumulate)
      continue;
    std::optional<Term> term = getTerm(op);
    if (!term || (!terms.empty() && terms[0].position != term->position))
      return;
    isShifted |= llvm::any_of(term->offset, [](int64_t o) { return o != 0; });
    terms.push_back(std::move(*term));
  }
  // Without shifts, the iteration owns what it adds to.
  if (!isShifted)
    return;
  for (Access other : all)
    if (other.getAccessKind() != AccessKind::Accumulate)
      for (const Term &term : terms)
        if (!isApart(other, term.op))
          return;
  auto repeats = [&](Value value) {
    llvm::SmallDenseSet<Operation *> seen;
    return canRecompute(
        value, box,
        [&](Operation *load) { return isStable(cast<Access>(load)); }, seen);
  };
  for (const Term &term : terms) {
    Access op = term.op;
    if (!repeats(op.getAccessedValue()) ||
        !llvm::all_of(term.conditions, [&](scf::IfOp condition) {
          return repeats(condition.getCondition());
        }))
      return;
  }
  size_t first = plan.groups.size();
  for (Term &term : terms) {
    auto here = llvm::drop_begin(plan.groups, first);
    auto home = llvm::find_if(here, [&](TermGroup &group) {
      return isSameSlice(group.front(), term);
    });
    if (home == here.end())
      plan.groups.push_back({std::move(term)});
    else
      home->push_back(std::move(term));
  }
}

/// Computes the offsets; false if the loops would be too large.
bool GatherPlanner::limit(GatherPlan &plan) {
  unsigned numIvs = loop.getInductionVars().size();
  plan.least.assign(numIvs, std::numeric_limits<int64_t>::max());
  plan.largest.assign(numIvs, std::numeric_limits<int64_t>::min());
  unsigned ops = 0;
  for (TermGroup &group : plan.groups)
    for (Term &term : group) {
      for (unsigned k = 0; k != numIvs; ++k) {
        plan.least[k] = std::min(plan.least[k], term.offset[k]);
        plan.largest[k] = std::max(plan.largest[k], term.offset[k]);
      }
      llvm::SmallDenseSet<Operation *> seen;
      auto always = [](Operation *) { return true; };
      (void)canRecompute(term.op.getAccessedValue(), box, always, seen);
      for (scf::IfOp condition : term.conditions)
        (void)canRecompute(condition.getCondition(), box, always, seen);
      ops += seen.size();
    }
  return ops <= maxOps;
}

std::optional<GatherPlan> GatherPlanner::run() {
  GatherPlan plan;
  std::optional<LoopArrays> arrays = LoopArrays::collect(loop);
  if (!arrays)
    return std::nullopt;
  plan.arrays = std::move(*arrays);
  loop.getBody().walk([&](Access access) {
    accesses[getStorageKey(access)].push_back(access);
  });
  bool hasConstantBox = getConstantBox(loop).has_value();
  for (auto &[storage, all] : accesses) {
    FlatSymbolRefAttr name = all.front().getAccessedStorage().field;
    if (name) {
      // tai-scatter-to-gather knows these better.
      if (hasConstantBox)
        continue;
      FailureOr<FieldLayout> layout = getFieldLayout(lookupField(loop, name));
      if (failed(layout) || layout->path.getFirstSparse())
        continue;
    }
    gatherStorage(all, plan);
  }
  if (plan.groups.empty() || !limit(plan))
    return std::nullopt;
  return plan;
}

//===----------------------------------------------------------------------===//
// The loops
//===----------------------------------------------------------------------===//

namespace {
class GatherBuilder {
public:
  GatherBuilder(ParallelForOp loop, GatherPlan &plan)
      : loop(loop), plan(plan), b(loop.getLoc(), loop) {}

  void run();

private:
  Value getConstant(int64_t value) {
    return arith::ConstantIndexOp::create(b, value);
  }
  Value addTo(Value value, int64_t constant) {
    return constant == 0
               ? value
               : arith::AddIOp::create(b, value, getConstant(constant));
  }
  Value compare(arith::CmpIPredicate predicate, Value lhs, Value rhs) {
    return arith::CmpIOp::create(b, predicate, lhs, rhs);
  }
  Value createTest();
  ParallelForOp createLoop(ValueRange lower, ValueRange upper,
                           llvm::function_ref<void(ValueRange ivs)> body);
  Value recompute(Term &term, ValueRange element);
  void add(Term &term, Value value, ValueRange element);
  void createInterior();
  void createBorder(unsigned k);
  void createRest();

  Value getLower(unsigned k) { return loop.getLowerBounds()[k]; }
  Value getUpper(unsigned k) { return loop.getUpperBounds()[k]; }

  ParallelForOp loop;
  GatherPlan &plan;
  ImplicitLocOpBuilder b;
};
} // namespace

/// Whether no array overlaps with one that is written, and the loop is long
/// enough to have an interior.
Value GatherBuilder::createTest() {
  Value test = plan.arrays.createTest(b, loop);
  for (unsigned k = 0; k != plan.least.size(); ++k) {
    Value length = arith::SubIOp::create(b, getUpper(k), getLower(k));
    test = createBoth(
        b, test,
        compare(arith::CmpIPredicate::sge, length,
                getConstant(std::max<int64_t>(plan.getWidth(k), 1))));
  }
  return test;
}

ParallelForOp
GatherBuilder::createLoop(ValueRange lower, ValueRange upper,
                          llvm::function_ref<void(ValueRange)> body) {
  auto made = ParallelForOp::create(b, lower, upper);
  made.copyNotesFrom(loop);
  made->setAttr(kApartAttrName, b.getUnitAttr());
  OpBuilder::InsertionGuard guard(b);
  b.setInsertionPoint(made.getBody().front().getTerminator());
  body(made.getInductionVars());
  return made;
}

/// The value that a term adds to `element`.
Value GatherBuilder::recompute(Term &term, ValueRange element) {
  IRMapping mapping;
  for (auto [iv, at, offset] :
       llvm::zip_equal(loop.getInductionVars(), element, term.offset))
    mapping.map(iv, addTo(at, -offset));
  Recomputation at(b, loop, std::move(mapping));
  return recomputeUnder(at, term.op, term.op.getAccessedValue(),
                        term.conditions);
}

/// Adds `value` to the element that the iteration owns.
void GatherBuilder::add(Term &term, Value value, ValueRange element) {
  Recomputation here(b, loop, {});
  SmallVector<Value> indices, components;
  for (auto [p, index] : llvm::enumerate(term.op.getAccessIndices())) {
    const auto *k = llvm::find(term.position, p);
    indices.push_back(k == term.position.end()
                          ? here.get(index)
                          : element[k - term.position.begin()]);
  }
  for (Value component : term.op.getAccessComponents())
    components.push_back(here.get(component));
  if (Value array = term.op.getAccessedStorage().memref) {
    Value before = memref::LoadOp::create(b, array, indices);
    memref::StoreOp::create(b, arith::AddFOp::create(b, before, value), array,
                            indices);
    return;
  }
  auto sum = AtomicOp::create(b, AtomicKind::Add, value,
                              term.op.getAccessedStorage().field, indices,
                              components, /*exclusive=*/true);
  if (term.op->hasAttr(kInRangeAttrName))
    sum->setAttr(kInRangeAttrName, b.getUnitAttr());
}

/// The elements for which all terms exist.
void GatherBuilder::createInterior() {
  SmallVector<Value> lower, upper;
  for (unsigned k = 0; k != plan.least.size(); ++k) {
    lower.push_back(addTo(getLower(k), plan.largest[k]));
    upper.push_back(addTo(getUpper(k), plan.least[k]));
  }
  createLoop(lower, upper, [&](ValueRange element) {
    // All reads come first, so that LLVM need not keep them in order with the
    // additions.
    SmallVector<Value> sums;
    for (TermGroup &group : plan.groups) {
      Value sum;
      for (Term &term : group) {
        Value value = recompute(term, element);
        sum = sum ? arith::AddFOp::create(b, sum, value).getResult() : value;
      }
      sums.push_back(sum);
    }
    for (auto [group, sum] : llvm::zip_equal(plan.groups, sums))
      add(group.front(), sum, element);
  });
}

/// The elements near both ends of index `k`, of those that are in the interior
/// along the indices before it.
void GatherBuilder::createBorder(unsigned k) {
  int64_t width = plan.getWidth(k);
  if (width == 0)
    return;
  SmallVector<Value> lower, upper;
  for (unsigned d = 0; d != plan.least.size(); ++d) {
    bool isInner = d < k;
    lower.push_back(
        d == k ? getConstant(0)
               : addTo(getLower(d), isInner ? plan.largest[d] : plan.least[d]));
    upper.push_back(
        d == k ? getConstant(2 * width)
               : addTo(getUpper(d), isInner ? plan.least[d] : plan.largest[d]));
  }
  RangeEnds ends{addTo(getLower(k), plan.least[k]),
                 addTo(getUpper(k), plan.least[k]), width};
  ParallelForOp border = createLoop(lower, upper, [&](ValueRange ivs) {
    SmallVector<Value> element(ivs);
    element[k] = ends.getIndex(b, ivs[k]);
    for (TermGroup &group : plan.groups)
      for (Term &term : group) {
        Value exists;
        for (unsigned d = k; d != plan.least.size(); ++d) {
          if (plan.getWidth(d) == 0)
            continue;
          Value source = addTo(element[d], -term.offset[d]);
          Value inside = arith::AndIOp::create(
              b, compare(arith::CmpIPredicate::sge, source, getLower(d)),
              compare(arith::CmpIPredicate::slt, source, getUpper(d)));
          exists = createBoth(b, exists, inside);
        }
        auto branch = scf::IfOp::create(b, exists, /*withElseRegion=*/false);
        OpBuilder::InsertionGuard guard(b);
        b.setInsertionPointToStart(branch.thenBlock());
        add(term, recompute(term, element), element);
      }
  });
  border->setAttr(kFallbackAttrName, b.getUnitAttr());
}

/// A copy of the loop without the additions, if that has any effect.
void GatherBuilder::createRest() {
  IRMapping mapping;
  auto rest = cast<ParallelForOp>(b.clone(*loop, mapping));
  rest->setAttr(kApartAttrName, b.getUnitAttr());
  for (TermGroup &group : plan.groups)
    for (Term &term : group)
      mapping.lookup(term.op.getOperation())->erase();
  WalkResult result = rest.getBody().walk([](Operation *op) {
    auto access = dyn_cast<Access>(op);
    bool isRead = access && access.getAccessKind() == AccessKind::Read;
    return isRead || op->hasTrait<OpTrait::HasRecursiveMemoryEffects>() ||
                   isMemoryEffectFree(op)
               ? WalkResult::advance()
               : WalkResult::interrupt();
  });
  if (!result.wasInterrupted())
    rest.erase();
}

/// Says in remarks that additions are gathered.
static void report(const GatherPlan &plan) {
  llvm::SmallPtrSet<const void *, 4> reported;
  for (const TermGroup &group : plan.groups) {
    Access op = group.front().op;
    if (!op.getContext()->getRemarkEngine() ||
        !reported.insert(getStorageKey(op)).second)
      continue;
    FlatSymbolRefAttr field = op.getAccessedStorage().field;
    auto function = op->getParentOfType<FunctionOpInterface>();
    remark::passed(op.getLoc(), remark::RemarkOpts::name("gathered")
                                    .category("tai-gathers")
                                    .function(function.getName()))
        << remark::metric("Field", field ? field.getValue().str() : "an array");
  }
}

void GatherBuilder::run() {
  report(plan);
  auto branch = scf::IfOp::create(b, createTest(), /*withElseRegion=*/true);
  b.setInsertionPointToStart(branch.thenBlock());
  createInterior();
  for (unsigned k = 0; k != plan.least.size(); ++k)
    createBorder(k);
  createRest();
  loop->setAttr(kFallbackAttrName, b.getUnitAttr());
  loop->moveBefore(branch.elseBlock(), branch.elseBlock()->begin());
}

namespace {
struct GatherRanges : tai::impl::GatherRangesBase<GatherRanges> {
  using Base::Base;

  void runOnOperation() override {
    SmallVector<ParallelForOp> loops;
    getOperation()->walk<WalkOrder::PreOrder>([&](ParallelForOp loop) {
      loops.push_back(loop);
      return WalkResult::skip();
    });
    for (ParallelForOp loop : loops) {
      // Another target would add in another order, and compensated sums need
      // more than a sum of terms.
      if (loop.getSerialize() || loop.getInOrder() || loop.isStructFor() ||
          checksIndices(loop) || hasCommonOrder(loop) ||
          planGatheredSum(loop, Float32Type::get(&getContext()),
                          /*pairs=*/true) != TermSum::Plain)
        continue;
      if (std::optional<GatherPlan> plan = GatherPlanner(loop, maxOps).run())
        GatherBuilder(loop, *plan).run();
    }
  }
};
} // namespace
