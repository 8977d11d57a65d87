//===- Scatters.cpp - Additions that can be gathered ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Scatters.h"
#include "LoopMemory.h"
#include "mlir/IR/Matchers.h"
#include "tai/Analysis/Accesses.h"

using namespace mlir;
using namespace mlir::tai;

/// The maximal number of iterations at the borders whose index does not follow
/// the common shift.
constexpr int64_t kMaxStrays = 4;

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

static std::optional<IndexSource> getIndexSource(Value index, Value iv,
                                                 int64_t lower, int64_t upper) {
  if (auto shift = getIndexShift(index, iv, lower, upper))
    return IndexSource{*shift, lower, upper, {}};
  auto pieces = getIndexPieces(index, iv, lower, upper);
  if (!pieces)
    return std::nullopt;
  auto getLength = [](const IndexPiece &piece) {
    return piece.slope == 1 ? piece.upper - piece.lower : 0;
  };
  const IndexPiece *inner = llvm::max_element(
      *pieces, [&](const IndexPiece &lhs, const IndexPiece &rhs) {
        return getLength(lhs) < getLength(rhs);
      });
  if (getLength(*inner) == 0 ||
      (upper - lower) - getLength(*inner) > kMaxStrays)
    return std::nullopt;
  IndexSource source{
      {inner->offset, /*wraps=*/false}, inner->lower, inner->upper, {}};
  for (const IndexPiece &piece : *pieces)
    if (&piece != inner)
      for (int64_t i = piece.lower; i != piece.upper; ++i)
        source.strays.push_back({i, piece.at(i)});
  return source;
}

/// Returns `op` as a scatter whose terms can be gathered, if it is one.
static std::optional<Scatter> getScatter(AtomicOp op, LoopBox &box,
                                         const FieldLayout &layout,
                                         GatherRefusal &why) {
  auto refuse = [&](const Twine &reason) {
    why.set(op, reason);
    return std::nullopt;
  };
  if (op.getKind() != AtomicKind::Add || !op.getOld().use_empty() ||
      !isa<FloatType>(getElementTypeOrSelf(op.getValue().getType())))
    return refuse("an update is not a plain sum of floats");
  Region &scope = box.loop.getBody();
  SmallVector<int> dimensionOf(box.ivs().size(), -1);
  for (auto [dimension, index] : llvm::enumerate(op.getIndices())) {
    SmallVector<Value> variables;
    if (!collectIndexVariables(index, scope, variables))
      return refuse("an index comes from data");
    if (variables.empty())
      continue;
    std::optional<unsigned> k = box.find(variables.front());
    // A loop index that selects two dimensions reaches a diagonal of the field,
    // whose elements alone would have an owner.
    if (variables.size() > 1 || !k || dimensionOf[*k] >= 0)
      return refuse("an index has more than one loop index, or two indices "
                    "have the same one");
    dimensionOf[*k] = dimension;
  }
  why.isSum = llvm::all_of(dimensionOf, [](int d) { return d < 0; });
  std::optional<SmallVector<scf::IfOp>> conditions = getConditions(op, box);
  if (!conditions)
    return refuse("an addition is in a serial loop that was not unrolled");
  Scatter scatter{op, std::move(*conditions), {}, {}, {}};
  for (auto [k, iv] : llvm::enumerate(box.ivs())) {
    int dimension = dimensionOf[k];
    // If no index depends on `iv`, all iterations along this loop index add to
    // one element.
    if (dimension < 0)
      return refuse("iterations along an index of the loop add to one element");
    scatter.owned.lower.push_back(layout.offset[dimension]);
    scatter.owned.upper.push_back(layout.offset[dimension] +
                                  layout.shape[dimension]);
    std::optional<IndexSource> source = getIndexSource(
        op.getIndices()[dimension], iv, box.lower[k], box.upper[k]);
    if (!source)
      return refuse("an index is no shift of a loop index");
    scatter.dimension.push_back(dimension);
    scatter.source.push_back(std::move(*source));
  }
  return scatter;
}

/// Returns the indices of the scatter that do not depend on the loop, which
/// select a slice of the field.
static SmallVector<Value> getSliceIndices(const Scatter &scatter) {
  SmallVector<Value> indices;
  for (auto [dimension, index] :
       llvm::enumerate(const_cast<Scatter &>(scatter).op.getIndices()))
    if (!llvm::is_contained(scatter.dimension, dimension))
      indices.push_back(index);
  return indices;
}

/// Returns those values of `all` that are at the positions of slice indices of
/// `scatter`.
static SmallVector<Value> selectSliceIndices(const Scatter &scatter,
                                             ValueRange all) {
  SmallVector<Value> indices;
  for (auto [dimension, index] : llvm::enumerate(all))
    if (!llvm::is_contained(scatter.dimension, dimension))
      indices.push_back(index);
  return indices;
}

/// True if an access certainly reaches another slice of the field than the
/// group of scatters, or another component.
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

FailureOr<FieldLayout> tai::getSparseLoopField(ParallelForOp loop) {
  if (!loop.isStructFor())
    return failure();
  FailureOr<FieldLayout> layout =
      getFieldLayout(lookupField(loop, loop.getFieldAttr()));
  if (failed(layout) || !layout->path.getFirstSparse())
    return failure();
  return layout;
}

/// True if the loop visits all elements of a field to which iterations can add.
static bool ownsAllActive(LoopBox &box, const FieldLayout &field) {
  FailureOr<FieldLayout> visited = getSparseLoopField(box.loop);
  if (failed(visited))
    return !field.path.getFirstSparse();
  return haveSameActivity(*visited, field);
}

/// True if the loop runs over the elements that it has to own, or can be
/// extended to them at little cost, because at least half of them are in the
/// loop.
static bool canOwn(LoopBox &box, const Owned &wanted) {
  if (box.lower == wanted.lower && box.upper == wanted.upper)
    return true;
  if (box.loop.isStructFor())
    return false;
  // Additional iterations would change the random numbers of the program, which
  // belong to positions in the box.
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

SmallVector<Group>
tai::getGroups(FieldOp field, LoopBox &box, ArrayRef<AtomicOp> atomics,
               const std::optional<Owned> &owned, unsigned maxOps,
               llvm::function_ref<bool(LoadOp)> isStable, GatherRefusal &why) {
  auto refuse = [&](Operation *op, const Twine &reason) {
    why.set(op, reason);
    return SmallVector<Group>();
  };
  // Checks whether `value` can be computed again, and names the read that
  // prevents it.
  auto canRepeat = [&](Value value, llvm::SmallDenseSet<Operation *> &seen) {
    return canRecompute(
        value, box,
        [&](Operation *op) {
          auto load = dyn_cast<LoadOp>(op);
          if (!load || isStable(load))
            return load != nullptr;
          why.set(load, Twine("'") + load.getField() +
                            "' is both read and written by the loop");
          return false;
        },
        seen);
  };
  auto refuseToRepeat = [&](AtomicOp op) {
    if (!why.at)
      why.set(op, "a value cannot be computed twice");
    return SmallVector<Group>();
  };
  why = {};
  FailureOr<FieldLayout> layout = getFieldLayout(field);
  if (failed(layout) || !ownsAllActive(box, *layout))
    return refuse(box.loop, "the loop may miss active cells of the field");

  SmallVector<Group> groups;
  unsigned ops = 0;
  for (AtomicOp op : atomics) {
    std::optional<int64_t> component =
        getComponent(op.getComponents(), field.getType());
    std::optional<Scatter> scatter = getScatter(op, box, *layout, why);
    llvm::SmallDenseSet<Operation *> recomputed;
    if (!scatter)
      return {};
    if (!component)
      return refuse(op, "a component is chosen at run time");
    if (!canRepeat(op.getValue(), recomputed))
      return refuseToRepeat(op);
    if (owned ? *owned != scatter->owned : !canOwn(box, scatter->owned))
      return refuse(op, "the loop covers less than half of the field, or "
                        "fields of several sizes");
    if (!groups.empty() && groups.front().front().owned != scatter->owned)
      return refuse(op, "parts of the field of several sizes are added to");
    for (scf::IfOp condition : scatter->conditions)
      if (!canRepeat(condition.getCondition(), recomputed))
        return refuseToRepeat(op);
    ops += recomputed.size() * scatter->getNumTerms();
    // The addition joins the group of its slice of the field, and must not
    // conflict with any other group.
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
        return refuse(op, "two slices that are added to may be the same");
    }
    if (!home)
      home = &groups.emplace_back();
    home->push_back(std::move(*scatter));
  }
  if (ops > maxOps)
    return refuse(atomics.front(), Twine(ops) +
                                       " operations would be done again, more "
                                       "than " +
                                       Twine(maxOps));
  return groups;
}

bool tai::isOnlyAccess(FieldOp field, LoopBox &box,
                       MutableArrayRef<Group> groups, GatherRefusal &why) {
  const void *storage = getStorageKey(groups.front().front().op);
  WalkResult result = box.loop.getBody().walk([&](Operation *op) {
    ValueRange indices, components;
    if (auto load = dyn_cast<LoadOp>(op)) {
      indices = load.getIndices();
      components = load.getComponents();
    } else if (auto store = dyn_cast<StoreOp>(op)) {
      indices = store.getIndices();
      components = store.getComponents();
    } else if (isa<ActivateOp, DeactivateOp, AppendOp>(op)) {
      why.set(op, "the loop changes which cells are active");
      return WalkResult::interrupt();
    } else {
      return WalkResult::advance();
    }
    if (getStorageKey(op) != storage)
      return WalkResult::advance();
    std::optional<int64_t> component =
        getComponent(components, field.getType());
    for (Group &group : groups)
      if (!isApart(group.front(), indices, component)) {
        why.set(op, "the loop has other accesses to the elements");
        return WalkResult::interrupt();
      }
    return WalkResult::advance();
  });
  return !result.wasInterrupted();
}
