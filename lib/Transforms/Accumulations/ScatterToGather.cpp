//===- ScatterToGather.cpp - Turn scatters into gathers -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The adjoint of a stencil, which reads at shifted indices, is a scatter to
// shifted indices: iterations that run at the same time add to the same
// elements. If every index is a shift of one loop index (cut off at the end
// of the field or wrapped around it), the iteration that owns an element can
// make all additions to it: it recomputes the terms of the shifted
// iterations. The result is one non-atomic addition for each element, in a
// fixed order, which vectorises. For this, a loop over the interior of a
// field becomes one over the whole field, whose body tests whether it is in
// the interior.
//
// The adjoint of a step from one time to the next loads the adjoints of the
// results and sets them to zero. Another iteration that loads the same adjoint
// would find zero, so the stores of zero move to a loop of their own, which
// runs afterwards.
//
// In a loop over the active cells of a sparse field, an iteration contributes
// only if its cell is active. This is valid for adjoints, which do not change
// activity, if the loop visits all active cells; the reverse of a loop that
// visited fewer keeps its scatter.
//
//===----------------------------------------------------------------------===//

#include "LoopMemory.h"
#include "Recomputation.h"
#include "Scatters.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/IR/IRMapping.h"
#include "mlir/IR/Remarks.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/IndexBounds.h"
#include "tai/Analysis/Reductions/ReductionPlan.h"
#include "tai/Support/BoundsMode.h"
#include "tai/Support/Places.h"
#include "tai/Transforms/Passes.h"
#include "tai/Transforms/Utils/ArrayRanges.h"
#include "tai/Transforms/Utils/GatherAdditions.h"

namespace mlir::tai {
#define GEN_PASS_DEF_SCATTERTOGATHER
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// Adds to `tests` the comparisons needed for `index`, which is in [least,
/// end), to be in `range`.
static void addRangeTests(OpBuilder &builder, Location loc, Value index,
                          std::pair<int64_t, int64_t> range, int64_t least,
                          int64_t end, SmallVectorImpl<Value> &tests) {
  auto [lower, upper] = range;
  auto add = [&](arith::CmpIPredicate predicate, int64_t bound) {
    Value constant = arith::ConstantIndexOp::create(builder, loc, bound);
    tests.push_back(
        arith::CmpIOp::create(builder, loc, predicate, index, constant));
  };
  if (least < lower)
    add(arith::CmpIPredicate::sge, lower);
  if (end > upper)
    add(arith::CmpIPredicate::slt, upper);
}

/// Emits the index of the iteration that, along loop index `k`, adds to the
/// element of iteration `iv`: iv - offset, wrapped if the shift wraps. Adds to
/// `inside` the tests that this iteration exists.
static Value invertShift(OpBuilder &builder, Scatter &scatter, LoopBox &box,
                         unsigned k, SmallVectorImpl<Value> &inside) {
  Location loc = scatter.op.getLoc();
  Value iv = box.ivs()[k];
  IndexShift shift = scatter.source[k].shift;
  int64_t lower = scatter.source[k].lower, upper = scatter.source[k].upper;
  int64_t least = scatter.owned.lower[k], end = scatter.owned.upper[k];
  auto constant = [&](int64_t value) -> Value {
    return arith::ConstantIndexOp::create(builder, loc, value);
  };
  // If the shift wraps, the element `iv` must itself be in the range of the
  // loop.
  if (shift.wraps || shift.isIdentity())
    addRangeTests(builder, loc, iv, {lower, upper}, least, end, inside);
  if (shift.isIdentity())
    return iv;
  Value source =
      arith::AddIOp::create(builder, loc, iv, constant(-shift.offset));
  if (!shift.wraps) {
    addRangeTests(builder, loc, source, {lower, upper}, least - shift.offset,
                  end - shift.offset, inside);
    return source;
  }
  bool fallsBelow = shift.offset > 0;
  Value isOutside = arith::CmpIOp::create(
      builder, loc,
      fallsBelow ? arith::CmpIPredicate::slt : arith::CmpIPredicate::sge,
      source, constant(fallsBelow ? lower : upper));
  int64_t turn = fallsBelow ? upper - lower : lower - upper;
  Value wrapped =
      arith::AddIOp::create(builder, loc, iv, constant(turn - shift.offset));
  return arith::SelectOp::create(builder, loc, isOutside, wrapped, source);
}

/// Emits the test that a loop over active cells has the iteration with these
/// indices; null if the iteration always exists.
static Value emitIsVisited(OpBuilder &builder, LoopBox &box,
                           const IRMapping &mapping, Scatter &scatter) {
  FailureOr<FieldLayout> visited = getSparseLoopField(box.loop);
  if (failed(visited) ||
      llvm::all_of(scatter.source, [](const IndexSource &source) {
        return source.isIdentity();
      }))
    return {};
  SmallVector<Value> indices;
  for (BlockArgument iv : box.ivs())
    indices.push_back(mapping.lookup(iv));
  // An element is active if its cell of the innermost sparse level is active.
  int64_t up = 1;
  for (const PathLevel &level : llvm::reverse(visited->path.levels)) {
    if (level.type.isSparse())
      break;
    ++up;
  }
  return IsActiveOp::create(builder, scatter.op.getLoc(), builder.getI1Type(),
                            box.loop.getFieldAttr(), indices,
                            builder.getI64IntegerAttr(up));
}

/// Emits a value that is computed only if `condition` holds, and is zero
/// otherwise.
static Value createGuarded(OpBuilder &builder, Location loc, Type type,
                           Value condition,
                           function_ref<Value(OpBuilder &builder)> value) {
  return scf::IfOp::create(
             builder, loc, condition,
             [&](OpBuilder &nested, Location) {
               scf::YieldOp::create(nested, loc, value(nested));
             },
             [&](OpBuilder &nested, Location) {
               scf::YieldOp::create(nested, loc,
                                    createZeroValue(nested, loc, type));
             })
      .getResult(0);
}

/// Emits a term of `scatter` for the element that the present iteration owns.
/// `choice` has a stray for each index, or null for the shifted iteration. The
/// index of a stray is a constant, or, if `keepsDistance`, the present one plus
/// a constant.
static Value recompute(OpBuilder &builder, LoopBox &box, Scatter &scatter,
                       ArrayRef<const IndexSource::Stray *> choice,
                       bool keepsDistance) {
  Location loc = scatter.op.getLoc();
  IRMapping mapping;
  SmallVector<Value> inside;
  for (auto [k, iv] : llvm::enumerate(box.ivs())) {
    if (!choice[k]) {
      mapping.map(iv, invertShift(builder, scatter, box, k, inside));
      continue;
    }
    auto constant = [&](int64_t value) -> Value {
      return arith::ConstantIndexOp::create(builder, loc, value);
    };
    Value source = constant(choice[k]->iteration);
    if (keepsDistance)
      source = arith::AddIOp::create(
          builder, loc, iv,
          constant(choice[k]->iteration - choice[k]->element));
    mapping.map(iv, source);
    inside.push_back(arith::CmpIOp::create(builder, loc,
                                           arith::CmpIPredicate::eq, iv,
                                           constant(choice[k]->element)));
  }
  Type type = scatter.op.getValue().getType();
  auto value = [&](OpBuilder &nested) {
    auto below = [&](OpBuilder &nested) {
      Recomputation at(nested, box.loop, mapping);
      return recomputeUnder(at, scatter.op, scatter.op.getValue(),
                            scatter.conditions);
    };
    Value visited = emitIsVisited(nested, box, mapping, scatter);
    return visited ? createGuarded(nested, loc, type, visited, below)
                   : below(nested);
  };
  if (inside.empty())
    return value(builder);
  Value condition = inside.front();
  for (Value other : llvm::drop_begin(inside))
    condition = arith::AndIOp::create(builder, loc, condition, other);
  return createGuarded(builder, loc, type, condition, value);
}

/// Emits all terms that `scatter` adds to the element that the present
/// iteration owns.
static void recomputeTerms(OpBuilder &builder, LoopBox &box, Scatter &scatter,
                           bool keepsDistance, SmallVectorImpl<Value> &terms) {
  for (unsigned number = 0; number != scatter.getNumTerms(); ++number) {
    SmallVector<const IndexSource::Stray *> choice;
    unsigned rest = number;
    for (const IndexSource &source : scatter.source) {
      unsigned digit = rest % (1 + source.strays.size());
      rest /= 1 + source.strays.size();
      choice.push_back(digit == 0 ? nullptr : &source.strays[digit - 1]);
    }
    terms.push_back(recompute(builder, box, scatter, choice, keepsDistance));
  }
}

namespace {
/// The single addition that replaces a group of scatters.
struct Gathered {
  AtomicOp pattern;
  Value sum;
  SmallVector<Value> indices, components;
};
} // namespace

/// Emits the sum of the values, from first to last.
static Value emitSum(OpBuilder &builder, Location loc, ValueRange values) {
  Value sum = values.front();
  for (Value value : values.drop_front())
    sum = arith::AddFOp::create(builder, loc, sum, value);
  return sum;
}

/// Emits a sum in twice the precision of its type, rounded once. In f64 the
/// rounding errors are summed separately (two-sum). A target may fuse a term
/// that is a product into both additions that use it, or into neither, so that
/// the error belongs to the term that was added.
static Value emitCompensatedSum(OpBuilder &builder, Location loc,
                                ValueRange values) {
  Type type = values.front().getType();
  if (values.size() == 1)
    return values.front();
  auto add = [&](Value a, Value b) -> Value {
    return arith::AddFOp::create(builder, loc, a, b);
  };
  if (!getElementTypeOrSelf(type).isF64()) {
    Type larger = builder.getF64Type();
    if (auto vector = dyn_cast<VectorType>(type))
      larger = vector.clone(larger);
    SmallVector<Value> extended;
    for (Value value : values)
      extended.push_back(arith::ExtFOp::create(builder, loc, larger, value));
    return arith::TruncFOp::create(builder, loc, type,
                                   emitSum(builder, loc, extended));
  }
  auto subtract = [&](Value a, Value b) -> Value {
    return arith::SubFOp::create(builder, loc, a, b);
  };
  Value sum = values.front(), rest;
  for (Value value : values.drop_front()) {
    Value before = sum;
    sum = add(before, value);
    Value taken = subtract(sum, before);
    Value lost =
        add(subtract(before, subtract(sum, taken)), subtract(value, taken));
    rest = rest ? add(rest, lost) : lost;
  }
  // The rounding errors of an infinite sum are NaN, and count as zero.
  Value isNumber = arith::CmpFOp::create(builder, loc,
                                         arith::CmpFPredicate::ORD, rest, rest);
  return arith::SelectOp::create(builder, loc, isNumber, add(sum, rest), sum);
}

/// Computes at the end of the body the terms of `group` for the element that
/// the iteration owns.
static Gathered gather(LoopBox &box, Group &group, TermSum sum,
                       bool keepsDistance) {
  OpBuilder builder(box.body().getTerminator());
  Scatter &first = group.front();
  Gathered gathered{first.op, {}, {}, {}};
  SmallVector<Value> values;
  for (Scatter &scatter : group)
    recomputeTerms(builder, box, scatter, keepsDistance, values);
  Location loc = first.op.getLoc();
  gathered.sum = sum == TermSum::WithErrors
                     ? emitCompensatedSum(builder, loc, values)
                     : emitSum(builder, loc, values);
  IRMapping identity;
  for (BlockArgument iv : box.ivs())
    identity.map(iv, iv);
  Recomputation here(builder, box.loop, std::move(identity));
  for (auto [dimension, index] : llvm::enumerate(first.op.getIndices())) {
    const auto *k = llvm::find(first.dimension, dimension);
    gathered.indices.push_back(
        k == first.dimension.end()
            ? here.get(index)
            : Value(box.ivs()[k - first.dimension.begin()]));
  }
  for (Value component : first.op.getComponents())
    gathered.components.push_back(here.get(component));
  return gathered;
}

/// Moves the non-atomic additions of the body after all reads: LLVM then reuses
/// the load of a neighbour in the next iteration without carrying it across a
/// store, which would stop the vectoriser.
static void sinkAdditions(LoopBox &box) {
  Operation *end = box.body().getTerminator();
  // The list of additions is copied, because the additions move while it is
  // visited.
  SmallVector<AtomicOp> additions(box.body().getOps<AtomicOp>());
  for (AtomicOp op : additions) {
    const void *storage = getStorageKey(op);
    bool isFree = op.getExclusive() && op.getOld().use_empty();
    for (Operation *later = op->getNextNode(); isFree && later != end;
         later = later->getNextNode())
      later->walk([&](Operation *inner) {
        isFree &= !isa<LoadOp, StoreOp, AtomicOp>(inner) ||
                  getStorageKey(inner) != storage;
      });
    if (isFree)
      op->moveBefore(end);
  }
}

/// Extends the loop to all elements that it has to own. The loop body runs in
/// the original iterations alone.
static void widen(LoopBox &box, const Owned &owned) {
  OpBuilder builder(box.loop);
  Location loc = box.loop.getLoc();
  auto constants = [&](ArrayRef<int64_t> values) {
    return llvm::map_to_vector(values, [&](int64_t value) -> Value {
      return arith::ConstantIndexOp::create(builder, loc, value);
    });
  };
  box.loop.getLowerBoundsMutable().assign(constants(owned.lower));
  box.loop.getUpperBoundsMutable().assign(constants(owned.upper));

  builder.setInsertionPointToStart(&box.body());
  SmallVector<Value> tests;
  for (auto [k, iv] : llvm::enumerate(box.ivs()))
    addRangeTests(builder, loc, iv, {box.lower[k], box.upper[k]},
                  owned.lower[k], owned.upper[k], tests);
  Value inside = tests.front();
  for (Value test : llvm::drop_begin(tests))
    inside = arith::AndIOp::create(builder, loc, inside, test);
  auto branch = scf::IfOp::create(builder, loc, inside, /*withElse=*/false);
  Block *block = branch.thenBlock();
  block->getOperations().splice(block->begin(), box.body().getOperations(),
                                std::next(branch->getIterator()),
                                std::prev(box.body().end()));
}

/// Creates a loop after `box.loop` that repeats the stores, in the same
/// iterations and under the same conditions.
static ParallelForOp
createLaterStores(LoopBox &box,
                  const llvm::SmallPtrSetImpl<Operation *> &stores) {
  OpBuilder builder(box.loop.getContext());
  builder.setInsertionPointAfter(box.loop);
  auto later = cast<ParallelForOp>(builder.cloneWithoutRegions(*box.loop));
  Block &body = later.getBody().emplaceBlock();
  IRMapping ivs;
  for (BlockArgument iv : box.body().getArguments())
    ivs.map(iv, body.addArgument(iv.getType(), iv.getLoc()));
  builder.setInsertionPointToEnd(&body);
  builder.clone(*box.body().getTerminator());

  // Consecutive stores in one block share copies of the branches around them.
  Block *from = nullptr;
  std::optional<Recomputation> at;
  box.loop.getBody().walk([&](StoreOp store) {
    if (!stores.contains(store))
      return;
    if (store->getBlock() != from) {
      from = store->getBlock();
      builder.setInsertionPoint(body.getTerminator());
      at.emplace(builder, box.loop, ivs);
      SmallVector<scf::IfOp> conditions = *getConditions(store, box);
      for (scf::IfOp original : conditions) {
        bool inThen =
            original.getThenRegion().isAncestor(store->getParentRegion());
        auto branch = scf::IfOp::create(builder, store.getLoc(),
                                        at->get(original.getCondition()),
                                        /*withElseRegion=*/!inThen);
        Block *arm = inThen ? branch.thenBlock() : branch.elseBlock();
        builder.setInsertionPoint(arm->getTerminator());
      }
    }
    for (Value operand : store->getOperands())
      at->get(operand);
    builder.clone(*store, at->mapping);
  });
  return later;
}

/// Replaces the additions of each group by one addition at the end of the loop
/// body.
static void rewrite(LoopBox &box, MutableArrayRef<Group> groups, TermSum kind,
                    bool keepsDistance) {
  SmallVector<Gathered> all;
  for (Group &group : groups)
    all.push_back(gather(box, group, kind, keepsDistance));
  sinkAdditions(box);
  OpBuilder builder(box.body().getTerminator());
  for (Gathered &gathered : all) {
    auto sum = AtomicOp::create(
        builder, gathered.pattern.getLoc(), AtomicKind::Add, gathered.sum,
        gathered.pattern.getFieldAttr(), gathered.indices, gathered.components,
        /*exclusive=*/true);
    // If the elements of the scatters are in range, so is the element of the
    // iteration itself.
    if (gathered.pattern->hasAttr(kInRangeAttrName))
      sum->setAttr(kInRangeAttrName, builder.getUnitAttr());
  }
  for (Group &group : groups)
    for (Scatter &scatter : group)
      scatter.op.erase();
}

/// True if the kernel around the loop activates no cells.
static bool keepsActivity(ParallelForOp loop) {
  auto kernel = loop->getParentOfType<KernelOp>();
  return kernel && kernel.getKeepsActivity();
}

/// The largest distance, in cells, between an element and the iterations that
/// add to it; -1 if it is not bounded.
static int64_t getReach(const FieldLayout &visited, ArrayRef<Group> groups) {
  int64_t reach = 0;
  for (const Group &group : groups)
    for (const Scatter &scatter : group)
      for (auto [d, source] : llvm::enumerate(scatter.source)) {
        if (source.shift.wraps)
          return -1;
        int64_t offset = std::abs(source.shift.offset);
        for (const IndexSource::Stray &stray : source.strays)
          offset = std::max(offset, std::abs(stray.element - stray.iteration));
        // Returns the number of elements that a sparse cell spans along
        // dimension `d` of the loop.
        int64_t extent = 1;
        for (const PathLevel &level : llvm::reverse(visited.path.levels)) {
          if (level.type.isSparse())
            break;
          for (auto [axis, count] :
               llvm::zip(level.type.getAxes(), level.type.getShape()))
            if (axis == visited.axisOfIndex[d])
              extent *= count;
        }
        reach = std::max(reach, (offset + extent - 1) / extent);
      }
  return reach;
}

/// Emits a remark that the additions at `op` are gathered, or why they are not.
static void report(AtomicOp op, const GatherRefusal *why) {
  auto loop = op->getParentOfType<ParallelForOp>();
  if (!op.getContext()->getRemarkEngine() || (why && why->isSum) ||
      loop->hasAttr(kFallbackAttrName))
    return;
  auto function = op->getParentOfType<FunctionOpInterface>();
  auto options = remark::RemarkOpts::name(why ? "scattered" : "gathered")
                     .category("tai-gathers")
                     .function(function ? function.getName() : "");
  auto remark = why ? remark::missed(op.getLoc(), options)
                    : remark::passed(op.getLoc(), options);
  remark << remark::metric("Field", op.getField().str());
  if (!why)
    return;
  remark << remark::metric("Reason", why->reason);
  if (FileLineColLoc place =
          why->at ? findFileLocation(why->at->getLoc()) : FileLineColLoc())
    remark << remark::metric("Line", std::to_string(place.getLine()));
}

/// Turns all scatters of the loop that can be gathered into gathers; true if
/// there were any. If `movesStores`, stores of the loop may move to a loop of
/// their own, which `later` is then set to.
static bool gatherLoop(LoopBox &box, const GatherOptions &options,
                       bool movesStores, ParallelForOp *later = nullptr) {
  auto tell = [&](AtomicOp op, const GatherRefusal *why) {
    if (options.use != GatherOptions::Use::TrialForRanks)
      report(op, why);
  };
  FailureOr<FieldLayout> visited = getSparseLoopField(box.loop);
  int64_t reach = 0;
  std::optional<Owned> owned;
  if (movesStores) {
    SmallVector<AtomicOp> additions;
    box.loop.walk([&](AtomicOp op) { additions.push_back(op); });
    llvm::for_each(additions, forwardAddition);
  }
  // The additions of the loop by field, in the order of the first addition to
  // each field.
  llvm::MapVector<const void *, SmallVector<AtomicOp>> byStorage;
  box.loop.walk(
      [&](AtomicOp op) { byStorage[getStorageKey(op)].push_back(op); });
  // The loop for the stores is created first, because the loop of the additions
  // gets more iterations afterwards.
  llvm::SmallPtrSet<Operation *, 4> stores;
  ParallelForOp laterStores;
  if (movesStores && llvm::any_of(byStorage, [](auto &entry) {
        return !llvm::all_of(entry.second,
                             [](AtomicOp op) { return op.getExclusive(); });
      }))
    stores = LoopMemory(box.loop).findMovableStores(box);
  if (!stores.empty())
    laterStores = createLaterStores(box, stores);
  bool changed = false, needsLater = false;
  for (auto &[storage, atomics] : byStorage) {
    // Exclusive additions are not atomic, so gathering them gains nothing.
    if (llvm::all_of(atomics, [](AtomicOp op) { return op.getExclusive(); }))
      continue;
    FieldOp field =
        lookupField(atomics.front(), atomics.front().getFieldAttr());
    Type number = getElementTypeOrSelf(atomics.front().getValue().getType());
    TermSum kind = planGatheredSum(box.loop, number, options.pairSums);
    GatherRefusal why;
    if (kind == TermSum::Unavailable) {
      why.set(atomics.front(), "a GPU adds f64 and their rounding errors "
                               "atomically");
      tell(atomics.front(), &why);
      continue;
    }
    LoopMemory memory(box.loop);
    const void *added = storage;
    bool needsLaterHere = false;
    SmallVector<Group> groups = getGroups(
        field, box, atomics, owned, options.maxOps,
        [&](LoadOp load) {
          return memory.isStable(load, added, stores, needsLaterHere);
        },
        why);
    if (groups.empty() || !isOnlyAccess(field, box, groups, why)) {
      tell(atomics.front(), &why);
      continue;
    }
    tell(atomics.front(), nullptr);
    needsLater |= needsLaterHere;
    if (succeeded(visited) && reach >= 0) {
      int64_t here = getReach(*visited, groups);
      reach = here < 0 ? here : std::max(reach, here);
    }
    const Owned &wanted = groups.front().front().owned;
    if (!owned && (wanted.lower != box.lower || wanted.upper != box.upper))
      widen(box, wanted);
    owned = wanted;
    rewrite(box, groups, kind,
            /*keepsDistance=*/options.use != GatherOptions::Use::OneProcess);
    changed = true;
  }
  if (changed && succeeded(visited))
    box.loop.setReach(reach);
  if (laterStores && !needsLater) {
    laterStores.erase();
    return changed;
  }
  for (Operation *store : stores)
    store->erase();
  if (later)
    *later = laterStores;
  return changed;
}

/// Reports all additions of a loop that stays as it is.
static void reportAll(ParallelForOp loop, StringRef reason) {
  GatherRefusal why;
  why.set(loop, reason);
  llvm::SmallPtrSet<const void *, 4> reported;
  loop.walk([&](AtomicOp op) {
    if (!op.getExclusive() && reported.insert(getStorageKey(op)).second)
      report(op, &why);
  });
}

/// Gathers scatters in a loop over active cells. A branch keeps the scatter for
/// launches in which the loop does not visit all active cells.
static void gatherSparseLoop(ParallelForOp loop, LoopBox &box,
                             const GatherOptions &options) {
  ParallelForOp scattered = loop.clone();
  if (!gatherLoop(box, options, /*movesStores=*/false)) {
    scattered.erase();
    return;
  }
  OpBuilder builder(loop);
  Value all = VisitsAllOp::create(builder, loop.getLoc(), builder.getI1Type(),
                                  loop.getFieldAttr());
  auto branch = scf::IfOp::create(builder, loop.getLoc(), all,
                                  /*withElseRegion=*/true);
  loop->moveBefore(branch.thenBlock(), branch.thenBlock()->begin());
  branch.elseBlock()->getOperations().push_front(scattered);
}

/// On a GPU, stores stay in the loop: threads add quickly in any order, and a
/// loop for the stores is a second launch.
static bool mayMoveStores(ParallelForOp loop, const GatherOptions &options) {
  return !options.onDevice || hasFixedBits(loop);
}

SmallVector<ParallelForOp> tai::gatherAdditions(ParallelForOp loop,
                                                const GatherOptions &options) {
  std::optional<LoopBox> box = getConstantBox(loop);
  ParallelForOp later;
  if (!box || loop.getInductionVars().empty() || checksIndices(loop) ||
      loop.getInOrder() ||
      !gatherLoop(*box, options, mayMoveStores(loop, options), &later))
    return {};
  SmallVector<ParallelForOp> loops{loop};
  if (later)
    loops.push_back(later);
  return loops;
}

namespace {
struct ScatterToGather : tai::impl::ScatterToGatherBase<ScatterToGather> {
  using Base::Base;

  void runOnOperation() override {
    SmallVector<ParallelForOp> loops;
    getOperation()->walk([&](ParallelForOp loop) { loops.push_back(loop); });
    for (ParallelForOp loop : loops) {
      std::optional<LoopBox> box = getIndexBox(loop);
      if (loop.getInductionVars().empty() || checksIndices(loop))
        continue;
      if (!box || loop.getInOrder()) {
        reportAll(loop, box ? "iterations may meet in memory, and one thread "
                              "runs them in order"
                            : "the bounds of the loop are known at run time");
        continue;
      }
      GatherOptions options;
      options.maxOps = maxOps;
      options.pairSums = pairSums;
      options.onDevice = onDevice;
      if (failed(getSparseLoopField(loop))) {
        gatherLoop(*box, options, mayMoveStores(loop, options));
      } else if (keepsActivity(loop) &&
                 !loop->getParentOfType<ParallelForOp>()) {
        gatherSparseLoop(loop, *box, options);
      } else {
        reportAll(loop, "the loop may miss active cells of the field");
      }
    }
  }
};
} // namespace
