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
// In a loop over the active cells of a sparse field, an iteration contributes
// only if its cell is active. This is valid for adjoints, which do not change
// activity, if the loop visits all active cells; the reverse of a loop that
// visited fewer keeps its scatter.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/IRMapping.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Transforms/RegionUtils.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/Index/IndexShift.h"
#include "tai/Analysis/IndexBounds.h"
#include "tai/Analysis/LoopBox.h"
#include "tai/Analysis/Reductions/ReductionPlan.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Support/BoundsMode.h"
#include "tai/Transforms/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_SCATTERTOGATHER
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

namespace {
/// The elements that the iterations of a loop own, along each of its indices:
/// those of the loop itself, or more.
struct Owned {
  SmallVector<int64_t> lower, upper;

  bool operator!=(const Owned &other) const {
    return lower != other.lower || upper != other.upper;
  }
};

/// One addition that can be gathered.
struct Scatter {
  AtomicOp op;
  /// The `scf.if` ops around it, outermost first.
  SmallVector<scf::IfOp> conditions;
  /// For each induction variable, the dimension of the field that it indexes
  /// and how it does.
  SmallVector<unsigned> dimension;
  SmallVector<IndexShift> shift;
  /// All elements that may be added to.
  Owned owned;
};

/// Additions to one slice of a field.
using Group = SmallVector<Scatter, 0>;
} // namespace

//===----------------------------------------------------------------------===//
// Accesses that can be gathered
//===----------------------------------------------------------------------===//

/// The constant component that an access reaches: -1 for the whole element,
/// nothing if it is not constant.
static std::optional<int64_t> getComponent(ValueRange components, Type type) {
  if (components.empty())
    return -1;
  int64_t flat = 0;
  for (auto [component, size] :
       llvm::zip(components, cast<VectorType>(type).getShape())) {
    llvm::APInt value;
    if (!matchPattern(component, m_ConstantInt(&value)))
      return std::nullopt;
    flat = flat * size + value.getSExtValue();
  }
  return flat;
}

/// Describes `op` as a gatherable addition, if it is one.
static std::optional<Scatter> getScatter(AtomicOp op, LoopBox &box,
                                         const FieldLayout &layout) {
  if (op.getKind() != AtomicKind::Add || !op.getOld().use_empty() ||
      !isa<FloatType>(getElementTypeOrSelf(op.getValue().getType())))
    return std::nullopt;
  Scatter scatter{op, {}, {}, {}, {}};
  for (Operation *parent = op->getParentOp(); parent != box.loop;
       parent = parent->getParentOp()) {
    auto condition = dyn_cast<scf::IfOp>(parent);
    if (!condition)
      return std::nullopt;
    scatter.conditions.insert(scatter.conditions.begin(), condition);
  }

  Region &scope = box.loop.getBody();
  SmallVector<int> dimensionOf(box.ivs().size(), -1);
  for (auto [dimension, index] : llvm::enumerate(op.getIndices())) {
    SmallVector<Value> variables;
    if (!collectIndexVariables(index, scope, variables))
      return std::nullopt;
    if (variables.empty())
      continue;
    std::optional<unsigned> k = box.find(variables.front());
    // Two dimensions of one variable are a diagonal, which has no owner.
    if (variables.size() > 1 || !k || dimensionOf[*k] >= 0)
      return std::nullopt;
    dimensionOf[*k] = dimension;
  }
  for (auto [k, iv] : llvm::enumerate(box.ivs())) {
    int dimension = dimensionOf[k];
    // Without a dimension the additions of all its values would meet.
    if (dimension < 0)
      return std::nullopt;
    scatter.owned.lower.push_back(layout.offset[dimension]);
    scatter.owned.upper.push_back(layout.offset[dimension] +
                                  layout.shape[dimension]);
    std::optional<IndexShift> shift = getIndexShift(
        op.getIndices()[dimension], iv, box.lower[k], box.upper[k]);
    if (!shift)
      return std::nullopt;
    scatter.dimension.push_back(dimension);
    scatter.shift.push_back(*shift);
  }
  return scatter;
}

/// The indices that do not depend on the loop.
static SmallVector<Value> getSliceIndices(const Scatter &scatter) {
  SmallVector<Value> indices;
  for (auto [dimension, index] :
       llvm::enumerate(const_cast<Scatter &>(scatter).op.getIndices()))
    if (!llvm::is_contained(scatter.dimension, dimension))
      indices.push_back(index);
  return indices;
}

/// The indices of `all` at the positions that are slice indices of `scatter`.
static SmallVector<Value> selectSliceIndices(const Scatter &scatter,
                                             ValueRange all) {
  SmallVector<Value> indices;
  for (auto [dimension, index] : llvm::enumerate(all))
    if (!llvm::is_contained(scatter.dimension, dimension))
      indices.push_back(index);
  return indices;
}

/// True if `access` certainly touches another slice than the group, or another
/// component.
static bool isApart(Scatter &scatter, ValueRange indices,
                    std::optional<int64_t> component) {
  std::optional<int64_t> own = getComponent(
      scatter.op.getComponents(),
      lookupField(scatter.op, scatter.op.getFieldAttr()).getType());
  if (component && own && *component >= 0 && *own >= 0 && *component != *own)
    return true;
  return areProvablyDistinct(getSliceIndices(scatter),
                             selectSliceIndices(scatter, indices));
}

/// True if `value` can be computed again in another iteration: it is made of
/// operations without effects, and of reads from storage that the loop does
/// not write (`written`).
static bool canRecompute(Value value, LoopBox &box,
                         const llvm::SmallDenseSet<const void *> &written,
                         llvm::SmallDenseSet<Operation *> &seen) {
  Operation *op = value.getDefiningOp();
  if (!op || !box.loop->isProperAncestor(op) || !seen.insert(op).second)
    return true;
  bool isAllowed = true;
  op->walk([&](Operation *inner) {
    bool reads =
        (isa<LoadOp>(inner) && !written.contains(getStorageKey(inner))) ||
        inner->hasTrait<OpTrait::HasRecursiveMemoryEffects>();
    isAllowed &= reads || isMemoryEffectFree(inner);
  });
  if (!isAllowed)
    return false;
  bool operands = llvm::all_of(op->getOperands(), [&](Value operand) {
    return canRecompute(operand, box, written, seen);
  });
  llvm::SetVector<Value> captured;
  getUsedValuesDefinedAbove(op->getRegions(), captured);
  return operands && llvm::all_of(captured, [&](Value operand) {
           return canRecompute(operand, box, written, seen);
         });
}

/// The field that a loop over active cells visits, if it is one.
static FailureOr<FieldLayout> getSparseLoopField(ParallelForOp loop) {
  if (!loop.isStructFor())
    return failure();
  FailureOr<FieldLayout> layout =
      getFieldLayout(lookupField(loop, loop.getFieldAttr()));
  if (failed(layout) || !layout->path.getFirstSparse())
    return failure();
  return layout;
}

/// True if the loop visits all elements of a field that can be added to.
static bool ownsAllActive(LoopBox &box, const FieldLayout &field) {
  FailureOr<FieldLayout> visited = getSparseLoopField(box.loop);
  if (failed(visited))
    return !field.path.getFirstSparse();
  return haveSameActivity(*visited, field);
}

/// True if the loop is over the elements that it has to own, or can be made so
/// for little: nearly all of them are in it already.
static bool canOwn(LoopBox &box, const Owned &wanted) {
  if (box.lower == wanted.lower && box.upper == wanted.upper)
    return true;
  if (box.loop.isStructFor())
    return false;
  // Random numbers belong to positions in the box.
  if (box.loop.walk([](RandomOp) { return WalkResult::interrupt(); })
          .wasInterrupted())
    return false;
  double inLoop = 1, inField = 1;
  for (unsigned k = 0; k != box.lower.size(); ++k) {
    if (box.lower[k] < wanted.lower[k] || box.upper[k] > wanted.upper[k])
      return false;
    inLoop *= static_cast<double>(box.upper[k] - box.lower[k]);
    inField *= static_cast<double>(wanted.upper[k] - wanted.lower[k]);
  }
  return inField <= 2 * inLoop;
}

/// Groups the additions to one field by slice and component. Empty if one of
/// them cannot be gathered, or another access might meet them. If the loop has
/// been made to own other elements than its own, those are `owned`.
static SmallVector<Group> getGroups(FieldOp field, LoopBox &box,
                                    ArrayRef<AtomicOp> atomics,
                                    const std::optional<Owned> &owned,
                                    unsigned maxOps) {
  FailureOr<FieldLayout> layout = getFieldLayout(field);
  if (failed(layout) || !ownsAllActive(box, *layout))
    return {};
  // Reads of the field itself are checked by isOnlyAccess, unless the loop
  // stores to it: a read would then depend on the iteration.
  llvm::SmallDenseSet<const void *> written;
  const void *own = getStorageKey(atomics.front());
  box.loop.walk([&](Operation *op) {
    if (isa<StoreOp>(op) || (isa<AtomicOp>(op) && getStorageKey(op) != own))
      written.insert(getStorageKey(op));
  });

  SmallVector<Group> groups;
  unsigned ops = 0;
  for (AtomicOp op : atomics) {
    std::optional<int64_t> component =
        getComponent(op.getComponents(), field.getType());
    std::optional<Scatter> scatter = getScatter(op, box, *layout);
    llvm::SmallDenseSet<Operation *> recomputed;
    if (!scatter || !component ||
        !canRecompute(op.getValue(), box, written, recomputed))
      return {};
    if (owned ? *owned != scatter->owned : !canOwn(box, scatter->owned))
      return {};
    if (!groups.empty() && groups.front().front().owned != scatter->owned)
      return {};
    for (scf::IfOp condition : scatter->conditions)
      if (!canRecompute(condition.getCondition(), box, written, recomputed))
        return {};
    ops += recomputed.size();
    // Joins the group of its slice, and must be apart from all others.
    Group *home = nullptr;
    for (Group &group : groups) {
      Scatter &first = group.front();
      if (first.dimension == scatter->dimension &&
          first.op.getComponents().size() == op.getComponents().size() &&
          getComponent(first.op.getComponents(), field.getType()) ==
              component &&
          areProvablyEqual(getSliceIndices(first), getSliceIndices(*scatter))) {
        home = &group;
        continue;
      }
      if (!isApart(first, op.getIndices(), component))
        return {};
    }
    if (!home)
      home = &groups.emplace_back();
    home->push_back(std::move(*scatter));
  }
  if (ops > maxOps)
    return {};
  return groups;
}

/// True if nothing else in the loop may touch the elements of the groups.
static bool isOnlyAccess(FieldOp field, LoopBox &box,
                         MutableArrayRef<Group> groups) {
  const void *storage = getStorageKey(groups.front().front().op);
  WalkResult result = box.loop.getBody().walk([&](Operation *op) {
    ValueRange indices, components;
    if (auto load = dyn_cast<LoadOp>(op)) {
      indices = load.getIndices();
      components = load.getComponents();
    } else if (auto store = dyn_cast<StoreOp>(op)) {
      indices = store.getIndices();
      components = store.getComponents();
    } else {
      return isa<ActivateOp, DeactivateOp, AppendOp>(op)
                 ? WalkResult::interrupt()
                 : WalkResult::advance();
    }
    if (getStorageKey(op) != storage)
      return WalkResult::advance();
    std::optional<int64_t> component =
        getComponent(components, field.getType());
    for (Group &group : groups)
      if (!isApart(group.front(), indices, component))
        return WalkResult::interrupt();
    return WalkResult::advance();
  });
  return !result.wasInterrupted();
}

//===----------------------------------------------------------------------===//
// Rewriting
//===----------------------------------------------------------------------===//

namespace {
/// Recomputes values of the loop body in the iteration that `mapping` gives.
class Recomputation {
public:
  Recomputation(OpBuilder &builder, LoopBox &box, IRMapping mapping)
      : builder(builder), box(box), mapping(std::move(mapping)) {}

  Value get(Value value) {
    if (Value known = mapping.lookupOrNull(value))
      return known;
    Operation *op = value.getDefiningOp();
    if (!op || !box.loop->isProperAncestor(op))
      return value;
    for (Value operand : op->getOperands())
      get(operand);
    llvm::SetVector<Value> captured;
    getUsedValuesDefinedAbove(op->getRegions(), captured);
    for (Value operand : captured)
      get(operand);
    Operation *clone = builder.clone(*op, mapping);
    return clone->getResult(cast<OpResult>(value).getResultNumber());
  }

  OpBuilder &builder;
  LoopBox &box;
  IRMapping mapping;
};
} // namespace

static Value createZero(OpBuilder &builder, Location loc, Type type) {
  return arith::ConstantOp::create(builder, loc, builder.getZeroAttr(type));
}

/// The value that `scatter` adds, below its conditions from `depth` on; zero
/// where one of them does not hold.
static Value recomputeBelow(Recomputation &at, Scatter &scatter,
                            unsigned depth) {
  Location loc = scatter.op.getLoc();
  if (depth == scatter.conditions.size())
    return at.get(scatter.op.getValue());
  scf::IfOp original = scatter.conditions[depth];
  Type type = scatter.op.getValue().getType();
  bool inThen =
      original.getThenRegion().isAncestor(scatter.op->getParentRegion());
  Value condition = at.get(original.getCondition());
  auto branch = [&](bool taken) {
    return [&, taken](OpBuilder &builder, Location) {
      Value result;
      if (taken) {
        Recomputation inner(builder, at.box, at.mapping);
        result = recomputeBelow(inner, scatter, depth + 1);
      } else {
        result = createZero(builder, loc, type);
      }
      scf::YieldOp::create(builder, loc, result);
    };
  };
  return scf::IfOp::create(at.builder, loc, condition, branch(inThen),
                           branch(!inThen))
      .getResult(0);
}

/// Adds to `tests` whether `index` is in [lower, upper), where it may be in
/// [least, end).
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

/// The iteration whose addition lands where `iv` is, along index `k`: iv -
/// offset, wrapped if the shift wraps. Adds to `inside` the tests that there is
/// one.
static Value invertShift(OpBuilder &builder, Scatter &scatter, LoopBox &box,
                         unsigned k, SmallVectorImpl<Value> &inside) {
  Location loc = scatter.op.getLoc();
  Value iv = box.ivs()[k];
  IndexShift shift = scatter.shift[k];
  int64_t lower = box.lower[k], upper = box.upper[k];
  int64_t least = scatter.owned.lower[k], end = scatter.owned.upper[k];
  auto constant = [&](int64_t value) -> Value {
    return arith::ConstantIndexOp::create(builder, loc, value);
  };
  // An index that wraps stays in the range of the loop.
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

/// Whether a loop over active cells has the iteration with these indices; null
/// if all loops have.
static Value emitIsVisited(OpBuilder &builder, LoopBox &box,
                           const IRMapping &mapping, Scatter &scatter) {
  FailureOr<FieldLayout> visited = getSparseLoopField(box.loop);
  if (failed(visited) || llvm::all_of(scatter.shift, [](IndexShift shift) {
        return shift.isIdentity();
      }))
    return {};
  SmallVector<Value> indices;
  for (BlockArgument iv : box.ivs())
    indices.push_back(mapping.lookup(iv));
  // A cell is active if its cell of the innermost sparse level is.
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

/// The value if `condition` holds, zero if not.
static Value createGuarded(OpBuilder &builder, Location loc, Type type,
                           Value condition,
                           function_ref<Value(OpBuilder &builder)> value) {
  return scf::IfOp::create(
             builder, loc, condition,
             [&](OpBuilder &nested, Location) {
               scf::YieldOp::create(nested, loc, value(nested));
             },
             [&](OpBuilder &nested, Location) {
               scf::YieldOp::create(nested, loc, createZero(nested, loc, type));
             })
      .getResult(0);
}

/// The term of `scatter` for the element that the present iteration owns.
static Value recompute(OpBuilder &builder, LoopBox &box, Scatter &scatter) {
  Location loc = scatter.op.getLoc();
  IRMapping mapping;
  SmallVector<Value> inside;
  for (auto [k, iv] : llvm::enumerate(box.ivs()))
    mapping.map(iv, invertShift(builder, scatter, box, k, inside));
  Type type = scatter.op.getValue().getType();
  auto value = [&](OpBuilder &nested) {
    auto below = [&](OpBuilder &nested) {
      Recomputation at(nested, box, mapping);
      return recomputeBelow(at, scatter, 0);
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

namespace {
/// The one addition that takes the place of a group.
struct Gathered {
  AtomicOp pattern;
  Value sum;
  SmallVector<Value> indices, components;
};
} // namespace

/// The sum of the values.
static Value emitSum(OpBuilder &builder, Location loc, ValueRange values) {
  Value sum = values.front();
  for (Value value : values.drop_front())
    sum = arith::AddFOp::create(builder, loc, sum, value);
  return sum;
}

/// The sum with twice the digits of its type, rounded once. In f64 the rounding
/// errors are summed beside it (two-sum). A term that is a product may become
/// part of fused operations: of both that use it or of none, so the error is
/// that of the same term.
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
  // The errors of an infinite sum are not numbers.
  Value isNumber = arith::CmpFOp::create(builder, loc,
                                         arith::CmpFPredicate::ORD, rest, rest);
  return arith::SelectOp::create(builder, loc, isNumber, add(sum, rest), sum);
}

/// Computes at the end of the body the terms of `group` for the element that
/// the iteration owns.
static Gathered gather(LoopBox &box, Group &group, TermSum sum) {
  OpBuilder builder(box.body().getTerminator());
  Scatter &first = group.front();
  Gathered gathered{first.op, {}, {}, {}};
  SmallVector<Value> values;
  for (Scatter &scatter : group)
    values.push_back(recompute(builder, box, scatter));
  Location loc = first.op.getLoc();
  gathered.sum = sum == TermSum::WithErrors
                     ? emitCompensatedSum(builder, loc, values)
                     : emitSum(builder, loc, values);
  IRMapping identity;
  for (BlockArgument iv : box.ivs())
    identity.map(iv, iv);
  Recomputation here(builder, box, std::move(identity));
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

/// Moves the plain additions of the body behind everything that is read, so
/// that LLVM's reuse of a neighbour's load from one iteration to the next does
/// not have to be carried across a store, which would stop the vectoriser.
static void sinkAdditions(LoopBox &box) {
  Operation *end = box.body().getTerminator();
  // A copy of the list: moved additions must not be met again.
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

/// Makes the loop one over all elements that it has to own; its body runs in
/// the former iterations.
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

/// Replaces the additions of each group by one at the end of the body.
static void rewrite(LoopBox &box, MutableArrayRef<Group> groups, TermSum kind) {
  SmallVector<Gathered> all;
  for (Group &group : groups)
    all.push_back(gather(box, group, kind));
  sinkAdditions(box);
  OpBuilder builder(box.body().getTerminator());
  for (Gathered &gathered : all) {
    auto sum = AtomicOp::create(
        builder, gathered.pattern.getLoc(), AtomicKind::Add, gathered.sum,
        gathered.pattern.getFieldAttr(), gathered.indices, gathered.components,
        /*exclusive=*/true);
    // At the element of the iteration itself.
    if (gathered.pattern->hasAttr(kInRangeAttrName))
      sum->setAttr(kInRangeAttrName, builder.getUnitAttr());
  }
  for (Group &group : groups)
    for (Scatter &scatter : group)
      scatter.op.erase();
}

/// Whether the kernel around the loop makes nothing active.
static bool keepsActivity(ParallelForOp loop) {
  auto kernel = loop->getParentOfType<KernelOp>();
  return kernel && kernel.getKeepsActivity();
}

/// The largest distance in cells of the iterations that add to an element; -1
/// if they may be anywhere.
static int64_t getReach(const FieldLayout &visited, ArrayRef<Group> groups) {
  int64_t reach = 0;
  for (const Group &group : groups)
    for (const Scatter &scatter : group)
      for (auto [d, shift] : llvm::enumerate(scatter.shift)) {
        if (shift.wraps)
          return -1;
        // Elements of a cell along this dimension.
        int64_t extent = 1;
        for (const PathLevel &level : llvm::reverse(visited.path.levels)) {
          if (level.type.isSparse())
            break;
          for (auto [axis, count] :
               llvm::zip(level.type.getAxes(), level.type.getShape()))
            if (axis == visited.axisOfIndex[d])
              extent *= count;
        }
        reach = std::max(reach, (std::abs(shift.offset) + extent - 1) / extent);
      }
  return reach;
}

namespace {
struct GatherOptions {
  unsigned maxOps;
  /// Whether a sum of f64 can keep its rounding errors beside it.
  bool pairSums;
};
} // namespace

/// Gathers all scatters that can be gathered; true if there were any.
static bool gatherLoop(LoopBox &box, const GatherOptions &options) {
  FailureOr<FieldLayout> visited = getSparseLoopField(box.loop);
  int64_t reach = 0;
  std::optional<Owned> owned;
  // Fields in the order of their first addition.
  llvm::MapVector<const void *, SmallVector<AtomicOp>> byStorage;
  box.loop.walk(
      [&](AtomicOp op) { byStorage[getStorageKey(op)].push_back(op); });
  bool changed = false;
  for (auto &[storage, atomics] : byStorage) {
    // Additions that cannot meet others are plain already.
    if (llvm::all_of(atomics, [](AtomicOp op) { return op.getExclusive(); }))
      continue;
    FieldOp field =
        lookupField(atomics.front(), atomics.front().getFieldAttr());
    Type number = getElementTypeOrSelf(atomics.front().getValue().getType());
    TermSum kind = planGatheredSum(box.loop, number, options.pairSums);
    if (kind == TermSum::Unavailable)
      continue;
    SmallVector<Group> groups =
        getGroups(field, box, atomics, owned, options.maxOps);
    if (groups.empty() || !isOnlyAccess(field, box, groups))
      continue;
    if (succeeded(visited) && reach >= 0) {
      int64_t here = getReach(*visited, groups);
      reach = here < 0 ? here : std::max(reach, here);
    }
    const Owned &wanted = groups.front().front().owned;
    if (!owned && (wanted.lower != box.lower || wanted.upper != box.upper))
      widen(box, wanted);
    owned = wanted;
    rewrite(box, groups, kind);
    changed = true;
  }
  if (changed && succeeded(visited))
    box.loop.setReach(reach);
  return changed;
}

/// The same for a loop over active cells, where it goes over all of them.
static void gatherSparseLoop(ParallelForOp loop, LoopBox &box,
                             const GatherOptions &options) {
  ParallelForOp scattered = loop.clone();
  if (!gatherLoop(box, options)) {
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

namespace {
struct ScatterToGather : tai::impl::ScatterToGatherBase<ScatterToGather> {
  using Base::Base;

  void runOnOperation() override {
    SmallVector<ParallelForOp> loops;
    getOperation()->walk([&](ParallelForOp loop) { loops.push_back(loop); });
    for (ParallelForOp loop : loops) {
      std::optional<LoopBox> box = getIndexBox(loop);
      if (!box || loop.getInductionVars().empty() || loop.getInOrder() ||
          checksIndices(loop))
        continue;
      GatherOptions options{maxOps, pairSums};
      if (failed(getSparseLoopField(loop)))
        gatherLoop(*box, options);
      else if (keepsActivity(loop) && !loop->getParentOfType<ParallelForOp>())
        gatherSparseLoop(loop, *box, options);
    }
  }
};
} // namespace
