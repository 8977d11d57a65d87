//===- ChooseWriters.cpp - Which iteration's store remains ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Where iterations may store to the same element, a copy of the loop runs
// first, reduced to the ops that decide which iteration stores to which
// element. The copy finds the last iteration that stores to each element, its
// owner. The loop itself then stores to an element only in the owner's
// iteration:
//
//   owner[e] = -1                                  over all elements
//   owner[e] = max(owner[e], number)               the loop, without the rest
//   if owner[e] == number: y[e] = v                the loop
//
// An adjoint repeats the first two, because they depend on nothing that the
// loop changes, and takes the adjoint of the element under the condition. One
// iteration is serial code, whose stores follow one another.
//
//===----------------------------------------------------------------------===//

#include "../SelectedFunctionsPass.h"
#include "LoopsWithoutOrder.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/IR/Matchers.h"
#include "mlir/IR/PatternMatch.h"
#include "mlir/Transforms/RegionUtils.h"
#include "tai/ABI/Abi.h"
#include "tai/AD/Passes.h"
#include "tai/AD/Prepare/Selection.h"
#include "tai/AD/Prepare/Writers.h"
#include "tai/Analysis/AccessOrder.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/Activity.h"
#include "tai/Analysis/Index/IndexBuilder.h"
#include "tai/Analysis/Index/IndexQueries.h"
#include "tai/Analysis/IterationOrder.h"
#include "tai/Analysis/Owners.h"
#include "tai/Analysis/Races.h"
#include "tai/Analysis/SharedElements.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {
#define GEN_PASS_DEF_CHOOSEWRITERS
#include "tai/AD/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// The greatest number of elements for which a buffer of owners is allocated.
static constexpr int64_t kMaxElements = int64_t(1) << 28;

namespace {
/// Describes an accessed element by its indices, and by the indices of its
/// component.
struct Place {
  SmallVector<Value> indices, components;

  operator ElementPlace() const { return {indices, components}; }
};
} // namespace

/// The element that `access` reaches. In a branch on a condition such as `i ==
/// 0`, the loop index i replaces an equal index, as in `if i == 0: y[0] = ...`.
static Place getPlace(DifferentiableAccessInterface access,
                      ParallelForOp loop) {
  Place place{llvm::to_vector(access.getAccessIndices()),
              llvm::to_vector(access.getAccessComponents())};
  auto isOfLoop = [&](const IndexExpr &form) {
    return llvm::any_of(loop.getInductionVars(),
                        [&](Value iv) { return form.mentions(iv); });
  };
  auto use = [&](arith::CmpIOp equal) {
    Value sides[] = {equal.getLhs(), equal.getRhs()};
    IndexExpr forms[] = {getIndexExpr(sides[0]), getIndexExpr(sides[1])};
    for (Value &index : place.indices)
      for (unsigned side : {0, 1})
        if (isOfLoop(forms[side]) && !isOfLoop(forms[1 - side]) &&
            getIndexExpr(index) == forms[1 - side]) {
          index = sides[side];
          break;
        }
  };
  Operation *inner = access;
  for (Operation *op = access->getParentOp(); op != loop;
       inner = op, op = op->getParentOp()) {
    auto branch = dyn_cast<scf::IfOp>(op);
    if (!branch)
      continue;
    bool holds = branch.getThenRegion().isAncestor(inner->getParentRegion());
    SmallVector<Value> conditions = {branch.getCondition()};
    while (!conditions.empty()) {
      Value condition = conditions.pop_back_val();
      if (auto both = condition.getDefiningOp<arith::AndIOp>(); both && holds)
        llvm::append_range(conditions, both->getOperands());
      auto compare = condition.getDefiningOp<arith::CmpIOp>();
      if (compare &&
          compare.getPredicate() ==
              (holds ? arith::CmpIPredicate::eq : arith::CmpIPredicate::ne))
        use(compare);
    }
  }
  return place;
}

/// True if different iterations may reach one element by the two accesses.
static bool mayMeet(ParallelForOp loop, DifferentiableAccessInterface first,
                    DifferentiableAccessInterface second) {
  if (first == second && getSharing(first, loop) == Sharing::Own)
    return false;
  return mayMeet(loop, getPlace(first, loop), getPlace(second, loop));
}

//===----------------------------------------------------------------------===//
// Stores that different iterations make to one element
//===----------------------------------------------------------------------===//

namespace {
/// The accesses of a parallel loop to one storage in which several iterations
/// may write the same element.
struct OpenStorage {
  SmallVector<DifferentiableAccessInterface> stores;
  /// `others`: accesses that may reach elements that other iterations write.
  /// `sums`: accumulations to an element that belongs to the iteration.
  SmallVector<DifferentiableAccessInterface> others, sums;
  /// True if stores of two different iterations may reach the same element.
  bool collides = false;
  /// Whether a store and an accumulation in `sums` may reach the same element
  /// in different iterations. The element would then have several owners.
  bool isMixed = false;
  /// True if a derivative passes through one of the stores.
  bool isActive = false;

  /// The accesses (stores and sums) by which an iteration becomes the owner of
  /// the element that it writes.
  SmallVector<DifferentiableAccessInterface> getClaims() const {
    SmallVector<DifferentiableAccessInterface> claims(stores);
    llvm::append_range(claims, sums);
    return claims;
  }
};
} // namespace

static bool isConstant(DifferentiableAccessInterface store) {
  return matchPattern(store.getAccessedValue(), m_Constant());
}

/// True if two of `stores` may reach the same element in different iterations.
/// Two stores of constants do not count: neither leaves a derivative.
static bool anyMeet(ParallelForOp loop,
                    ArrayRef<DifferentiableAccessInterface> stores) {
  for (size_t i = 0; i != stores.size(); ++i)
    for (size_t j = i; j != stores.size(); ++j)
      if (!(isConstant(stores[i]) && isConstant(stores[j])) &&
          mayMeet(loop, stores[i], stores[j]))
        return true;
  return false;
}

/// True if, in a loop that is long enough, one of the accesses certainly reads
/// an element that another iteration writes. Merely possible races, as of time
/// slots that are arguments, do not count: to check each element at run time
/// would cost more than the loop.
static bool readsWrites(ArrayRef<DifferentiableAccessInterface> accesses) {
  return llvm::any_of(accesses, [&](auto read) {
    return read.getAccessKind() == AccessKind::Read &&
           llvm::any_of(accesses, [&](auto write) {
             return write.getAccessKind() != AccessKind::Read &&
                    findRace(write, read, /*ofLongLoops=*/true);
           });
  });
}

/// The storages of `loop` whose stores need a choice. A tangent is computed
/// with its value, in any order of iterations. An adjoint is not: with
/// `isReversed`, reads must not reach elements that other iterations write.
static SmallVector<OpenStorage> findOpen(ParallelForOp loop,
                                         StoreFilter matters, bool isReversed) {
  llvm::MapVector<const void *, SmallVector<DifferentiableAccessInterface>>
      storages;
  bool isActive = false, isDecided = false;
  loop.getBody().walk([&](DifferentiableAccessInterface access) {
    isDecided |= isa<memref::LoadOp>(access.getOperation()) &&
                 holdsOwners(access.getAccessedStorage().memref);
    Value memref = access.getAccessedStorage().memref;
    if (memref && (loop->isAncestor(memref.getParentBlock()->getParentOp()) ||
                   !isa<BlockArgument>(memref)))
      return;
    isActive |= matters(access);
    storages[getStorageKey(access)].push_back(access);
  });
  SmallVector<OpenStorage> open;
  if (isDecided)
    return open;
  for (auto &[key, accesses] : storages) {
    OpenStorage storage;
    SmallVector<DifferentiableAccessInterface> rest;
    for (DifferentiableAccessInterface access : accesses) {
      bool isStore = access.getAccessKind() == AccessKind::Write;
      (isStore ? storage.stores : rest).push_back(access);
    }
    storage.collides = anyMeet(loop, storage.stores);
    storage.isActive = llvm::any_of(storage.stores,
                                    [&](auto store) { return matters(store); });
    bool isOpen = storage.collides && storage.isActive;
    for (DifferentiableAccessInterface other : rest) {
      // An accumulation to an element that belongs to the iteration conflicts
      // with accesses of other iterations like a store.
      bool isSum = other.getAccessKind() != AccessKind::Read &&
                   !mayMeet(loop, other, other);
      bool meets = llvm::any_of(accesses, [&](auto write) {
        bool isRead = write.getAccessKind() == AccessKind::Read;
        bool areSums = other.getAccessKind() != AccessKind::Read &&
                       write.getAccessKind() != AccessKind::Write;
        // Two accumulations do not conflict. They are most pairs of a scatter,
        // and a comparison of their indices is expensive.
        if (isRead || areSums)
          return false;
        bool isOwn = write.getAccessKind() == AccessKind::Write ||
                     !mayMeet(loop, write, write);
        return isOwn && mayMeet(loop, write, other);
      });
      if (isSum) {
        storage.sums.push_back(other);
        storage.isMixed |= llvm::any_of(storage.stores, [&](auto store) {
          return mayMeet(loop, store, other);
        });
      }
      if (meets)
        storage.others.push_back(other);
    }
    isOpen |= isReversed && isActive && !storage.others.empty() &&
              readsWrites(accesses);
    if (isOpen)
      open.push_back(std::move(storage));
  }
  return open;
}

static SmallVector<ParallelForOp> getParallelLoops(FunctionOpInterface f) {
  SmallVector<ParallelForOp> loops;
  f.getFunctionBody().walk([&](ParallelForOp loop) {
    if (!loop.getSerialize())
      loops.push_back(loop);
  });
  return loops;
}

bool mlir::tai::hasOpenStores(FunctionOpInterface function, StoreFilter matters,
                              bool isReversed) {
  return llvm::any_of(getParallelLoops(function), [&](ParallelForOp loop) {
    return !findOpen(loop, matters, isReversed).empty();
  });
}

//===----------------------------------------------------------------------===//
// One loop
//===----------------------------------------------------------------------===//

namespace {
class LoopWriters {
public:
  LoopWriters(ParallelForOp loop, SmallVector<OpenStorage> open)
      : loop(loop), open(std::move(open)), b(loop.getLoc(), loop) {}

  /// Emits the code that computes the owners of elements before the loop, and
  /// restricts the stores of the loop to owners. False if the owners cannot be
  /// computed before the loop.
  bool decide();
  /// The alternative to decide(): makes the loop run on one thread, in order.
  LogicalResult serialize(bool isReversed);

private:
  /// Describes one dimension of the buffer that holds the owners of elements.
  struct Dimension {
    unsigned position;
    int64_t first = 0;
    Value extent;
  };
  /// The elements of one storage that have owners, and the buffer of the
  /// owners.
  struct Owned {
    SmallVector<Dimension> dimensions;
    Value owners;
  };

  bool findDimensions(const OpenStorage &storage, Owned &owned);
  bool buildDecision();
  void countIterations();
  Value createNumber(OpBuilder &builder, ValueRange ivs);
  std::pair<SmallVector<Value>, Value>
  createPosition(DifferentiableAccessInterface access, const Owned &owned);
  void claim(const OpenStorage &storage, const Owned &owned,
             const IRMapping &copies, Value number);
  void restrict(const OpenStorage &storage, const Owned &owned, Value number);
  bool isKnownBefore(Value value) {
    return !loop->isAncestor(value.getParentBlock()->getParentOp());
  }
  Value index(int64_t value) {
    return arith::ConstantIndexOp::create(b, value);
  }

  ParallelForOp loop;
  SmallVector<OpenStorage> open;
  ImplicitLocOpBuilder b;
  /// For each dimension of the loop, its lower bound and its number of
  /// iterations.
  SmallVector<Value> lower, extents;
  IntegerType type;
  /// The copy of the loop that computes the owners of elements before the loop.
  ParallelForOp decision;
  IRMapping copies;
  /// Set if the owners cannot be computed before the loop because they depend
  /// on the result of an op with a side effect.
  bool needsUpdate = false;
};
} // namespace

static SmallVector<Value> getPosition(DifferentiableAccessInterface access) {
  SmallVector<Value> position(access.getAccessIndices());
  llvm::append_range(position, access.getAccessComponents());
  return position;
}

/// Finds the dimensions of the buffer of owners. Returns false if some accesses
/// reach whole elements and others reach single components.
bool LoopWriters::findDimensions(const OpenStorage &storage, Owned &owned) {
  SmallVector<DifferentiableAccessInterface> accesses = storage.getClaims();
  llvm::append_range(accesses, storage.others);
  DifferentiableAccessInterface first = accesses.front();
  size_t rank = getPosition(first).size();
  if (!llvm::all_of(accesses, [&](auto other) {
        return getPosition(other).size() == rank;
      }))
    return false;
  int64_t elements = 1;
  Storage where = first.getAccessedStorage();
  SmallVector<int64_t> firsts(rank, 0), sizes;
  if (where.field) {
    FieldLayout layout = *getFieldLayout(lookupField(first, where.field));
    llvm::copy(layout.offset, firsts.begin());
    llvm::append_range(sizes, layout.shape);
    if (auto vector = dyn_cast<VectorType>(layout.path.getElementType()))
      llvm::append_range(sizes, vector.getShape());
  } else {
    llvm::append_range(sizes,
                       cast<MemRefType>(where.memref.getType()).getShape());
  }
  for (size_t i = 0; i != rank; ++i) {
    // An index that is the same in all iterations, such as a time slot, needs
    // no dimension in the buffer of owners.
    Value same = getPosition(first)[i];
    auto isSame = [&](DifferentiableAccessInterface access) {
      Value value = getPosition(access)[i];
      return isKnownBefore(value) && areProvablyEqual(value, same);
    };
    if (llvm::all_of(accesses, isSame))
      continue;
    Dimension dimension{static_cast<unsigned>(i), firsts[i], {}};
    if (ShapedType::isDynamic(sizes[i])) {
      dimension.extent = memref::DimOp::create(b, where.memref, i);
    } else {
      dimension.extent = index(sizes[i]);
      elements *= sizes[i];
    }
    if (elements > kMaxElements)
      return false;
    owned.dimensions.push_back(dimension);
  }
  return true;
}

void LoopWriters::countIterations() {
  int64_t known = 1;
  auto add = [&](Value from, Value extent) {
    lower.push_back(from);
    extents.push_back(extent);
    APInt count;
    bool isKnown = matchPattern(extent, m_ConstantInt(&count)) &&
                   known <= std::numeric_limits<int32_t>::max();
    known = isKnown && !llvm::MulOverflow(known, count.getSExtValue(), known)
                ? known
                : std::numeric_limits<int64_t>::max();
  };
  if (loop.isStructFor()) {
    FieldLayout layout =
        *getFieldLayout(lookupField(loop, loop.getFieldAttr()));
    for (auto [extent, first] : llvm::zip(layout.shape, layout.offset))
      add(index(first), index(extent));
  } else {
    for (auto [from, to] :
         llvm::zip(loop.getLowerBounds(), loop.getUpperBounds()))
      add(from, b.createOrFold<arith::SubIOp>(to, from));
  }
  type =
      b.getIntegerType(known <= std::numeric_limits<int32_t>::max() ? 32 : 64);
}

/// Emits the row-major number of the iteration whose loop indices are `ivs`.
Value LoopWriters::createNumber(OpBuilder &builder, ValueRange ivs) {
  ImplicitLocOpBuilder at(loop.getLoc(), builder);
  Value number = arith::ConstantIndexOp::create(at, 0);
  for (auto [iv, from, extent] : llvm::zip(ivs, lower, extents))
    number = at.createOrFold<arith::AddIOp>(
        at.createOrFold<arith::MulIOp>(number, extent),
        at.createOrFold<arith::SubIOp>(iv, from));
  return arith::IndexCastOp::create(at, type, number);
}

/// Emits, at the insertion point, the position of the element of `access` in
/// the buffer of owners, clamped to the buffer, and whether it had to be
/// clamped.
std::pair<SmallVector<Value>, Value>
LoopWriters::createPosition(DifferentiableAccessInterface access,
                            const Owned &owned) {
  SmallVector<Value> all = getPosition(access), position;
  Value isOutside;
  for (const Dimension &dimension : owned.dimensions) {
    Value at = all[dimension.position];
    if (dimension.first != 0)
      at = arith::SubIOp::create(b, at, index(dimension.first));
    Value last = arith::SubIOp::create(b, dimension.extent, index(1));
    Value inside = arith::MaxSIOp::create(
        b, arith::MinSIOp::create(b, at, last), index(0));
    Value differs =
        arith::CmpIOp::create(b, arith::CmpIPredicate::ne, at, inside);
    isOutside =
        isOutside ? arith::OrIOp::create(b, isOutside, differs) : differs;
    position.push_back(inside);
  }
  return {position, isOutside};
}

/// True for ops whose effects are not visible outside of an iteration.
static bool isPrivate(Operation *op, Operation *loop) {
  auto isInside = [&](Value memory) {
    return loop->isAncestor(memory.getParentBlock()->getParentOp());
  };
  if (isa<AllocaOp, StackCreateOp, StackPushOp, StackPopOp, StackDestroyOp,
          LocalLoadOp, LocalStoreOp, memref::AllocaOp, memref::AllocOp,
          memref::DeallocOp>(op))
    return llvm::all_of(op->getOperands(), [&](Value operand) {
      return !isa<LocalType, StackType, BaseMemRefType>(operand.getType()) ||
             isInside(operand);
    });
  if (auto access = dyn_cast<DifferentiableAccessInterface>(op))
    if (Value memref = access.getAccessedStorage().memref)
      return isInside(memref);
  return isa<RandomOp>(op);
}

/// Erases the ops of a copy of a loop that `kept` does not depend on. False if
/// `kept` depends on the result of an op with a side effect.
static bool reduceTo(ParallelForOp copy, const DenseSet<Operation *> &kept) {
  SmallVector<Operation *> effects;
  copy.getBody().walk([&](Operation *op) {
    if (op->getNumRegions() == 0 && !op->hasTrait<OpTrait::IsTerminator>() &&
        !isMemoryEffectFree(op) && !hasSingleEffect<MemoryEffects::Read>(op) &&
        !isPrivate(op, copy) && !kept.contains(op))
      effects.push_back(op);
  });
  IRRewriter rewriter(copy->getContext());
  size_t before;
  do {
    before = effects.size();
    llvm::erase_if(effects, [&](Operation *op) {
      bool isUnused = op->use_empty();
      if (isUnused)
        rewriter.eraseOp(op);
      return isUnused;
    });
    (void)runRegionDCE(rewriter, copy->getRegions());
  } while (effects.size() != before);
  return effects.empty();
}

/// Emits, in the copy of the loop that decides the owners, code that makes this
/// iteration the owner of the elements that it writes, if its number is greater
/// than that of the present owner.
void LoopWriters::claim(const OpenStorage &storage, const Owned &owned,
                        const IRMapping &copies, Value number) {
  for (DifferentiableAccessInterface write : storage.getClaims()) {
    Operation *copy = copies.lookup(write.getOperation());
    b.setInsertionPoint(copy);
    b.setLoc(write->getLoc());
    SmallVector<Value> position =
        createPosition(cast<DifferentiableAccessInterface>(copy), owned).first;
    memref::AtomicRMWOp::create(b, arith::AtomicRMWKind::maxs, number,
                                owned.owners, position);
  }
}

/// Restricts stores in the loop: only the owner of an element stores to it. The
/// accesses in `others` get an assertion that no other iteration owns their
/// element.
void LoopWriters::restrict(const OpenStorage &storage, const Owned &owned,
                           Value number) {
  auto createOwner = [&](DifferentiableAccessInterface access) {
    b.setInsertionPoint(access);
    b.setLoc(access->getLoc());
    auto [position, isOutside] = createPosition(access, owned);
    Value owner = memref::LoadOp::create(b, owned.owners, position);
    return std::pair(owner, isOutside);
  };
  auto createOwnership = [&](Value owner, Value isOutside) {
    Value isMine =
        arith::CmpIOp::create(b, arith::CmpIPredicate::eq, owner, number);
    // An access out of range is not restricted: it is reported, or undefined,
    // as without owners.
    return isOutside ? arith::OrIOp::create(b, isMine, isOutside) : isMine;
  };
  std::string name = "an array";
  DifferentiableAccessInterface first = storage.getClaims().front();
  if (FlatSymbolRefAttr field = first.getAccessedStorage().field)
    name = ("field '" + field.getValue() + "'").str();
  auto failure = b.getI32IntegerAttr(TAI_FAIL_CHECK);
  for (DifferentiableAccessInterface other : storage.others) {
    auto [owner, isOutside] = createOwner(other);
    Value none = arith::ConstantIntOp::create(b, -1, type.getWidth());
    Value isAlone = arith::OrIOp::create(
        b, createOwnership(owner, isOutside),
        arith::CmpIOp::create(b, arith::CmpIPredicate::eq, owner, none));
    AssertOp::create(
        b, isAlone,
        b.getStringAttr("an iteration of a parallel loop uses an element of " +
                        name +
                        " here that another iteration writes, so that its "
                        "value and its gradient would be wrong; write to "
                        "another field, or use an atomic operation"),
        ValueRange(), failure);
  }
  if (!storage.collides)
    return;
  for (DifferentiableAccessInterface store : storage.stores) {
    auto [owner, isOutside] = createOwner(store);
    auto branch = scf::IfOp::create(b, createOwnership(owner, isOutside),
                                    /*withElseRegion=*/false);
    store->moveBefore(branch.thenBlock(), branch.thenBlock()->begin());
  }
}

/// True if `read` returns the same value in the copy of the loop that decides
/// the owners as in the loop itself.
static bool isUnchanged(DifferentiableAccessInterface read,
                        ParallelForOp loop) {
  const void *key = getStorageKey(read);
  return !loop.getBody()
              .walk([&](DifferentiableAccessInterface write) {
                bool isWrite = write.getAccessKind() != AccessKind::Read &&
                               getStorageKey(write) == key;
                return isWrite && (mayReachLater(write, read) ||
                                   mayMeet(loop, write, read))
                           ? WalkResult::interrupt()
                           : WalkResult::advance();
              })
              .wasInterrupted();
}

/// Emits the copy of the loop and erases the ops that the owners do not depend
/// on. False if the owners cannot be computed before the loop.
bool LoopWriters::buildDecision() {
  decision = cast<ParallelForOp>(b.clone(*loop, copies));
  DenseMap<Operation *, Operation *> originals;
  loop.getBody().walk(
      [&](Operation *op) { originals[copies.lookup(op)] = op; });
  // Stores stay in the copy until `claim` replaces them. They store zero, so
  // that the ops that compute the stored values can be erased.
  DenseSet<Operation *> kept;
  for (const OpenStorage &storage : open)
    for (DifferentiableAccessInterface write : storage.getClaims()) {
      Operation *copy = copies.lookup(write.getOperation());
      kept.insert(copy);
      Value value =
          cast<DifferentiableAccessInterface>(copy).getAccessedValue();
      b.setInsertionPoint(copy);
      Value zero = arith::ConstantOp::create(b, b.getZeroAttr(value.getType()));
      copy->replaceUsesOfWith(value, zero);
    }
  needsUpdate = !reduceTo(decision, kept);
  if (needsUpdate ||
      llvm::any_of(kept, [](Operation *write) { return !write->use_empty(); }))
    return false;
  bool isKnown = true;
  decision.getBody().walk([&](DifferentiableAccessInterface copy) {
    if (kept.contains(copy) || isPrivate(copy, decision))
      return;
    isKnown &= isUnchanged(
        cast<DifferentiableAccessInterface>(originals.at(copy)), loop);
  });
  return isKnown;
}

bool LoopWriters::decide() {
  if (llvm::any_of(open, [](auto &storage) { return storage.isMixed; }))
    return false;
  b.setInsertionPoint(loop);
  SmallVector<Owned> owned(open.size());
  for (auto [storage, into] : llvm::zip(open, owned))
    if (!findDimensions(storage, into))
      return false;
  if (loop.getLevel() || !buildDecision()) {
    if (decision)
      decision->erase();
    return false;
  }
  b.setInsertionPoint(decision);
  b.setLoc(loop.getLoc());
  countIterations();
  for (Owned &into : owned) {
    SmallVector<int64_t> shape;
    SmallVector<Value> sizes, dynamic;
    for (const Dimension &dimension : into.dimensions) {
      sizes.push_back(dimension.extent);
      APInt size;
      bool isKnown = matchPattern(dimension.extent, m_ConstantInt(&size));
      shape.push_back(isKnown ? size.getSExtValue() : ShapedType::kDynamic);
      if (!isKnown)
        dynamic.push_back(dimension.extent);
    }
    into.owners =
        memref::AllocOp::create(b, MemRefType::get(shape, type), dynamic);
    Value none = arith::ConstantIntOp::create(b, -1, type.getWidth());
    if (sizes.empty()) {
      memref::StoreOp::create(b, none, into.owners, ValueRange());
      continue;
    }
    SmallVector<Value> from(sizes.size(), index(0));
    auto fill = ParallelForOp::create(b, from, sizes);
    OpBuilder::InsertionGuard guard(b);
    b.setInsertionPoint(fill.getBody().front().getTerminator());
    SmallVector<Value> ivs(fill.getInductionVars());
    memref::StoreOp::create(b, none, into.owners, ivs);
  }
  auto inBody = [&](ParallelForOp in) {
    auto body = OpBuilder::atBlockBegin(&in.getBody().front());
    SmallVector<Value> ivs(in.getInductionVars());
    return createNumber(body, ivs);
  };
  Value number = inBody(decision);
  for (auto [storage, into] : llvm::zip(open, owned)) {
    claim(storage, into, copies, number);
    for (DifferentiableAccessInterface write : storage.getClaims())
      copies.lookup(write.getOperation())->erase();
  }
  number = inBody(loop);
  for (auto [storage, into] : llvm::zip(open, owned))
    restrict(storage, into, number);
  b.setInsertionPointAfter(loop);
  for (Owned &into : owned)
    memref::DeallocOp::create(b, into.owners);
  return true;
}

LogicalResult LoopWriters::serialize(bool isReversed) {
  if (!loop.isStructFor() || !isReversed) {
    loop.setSerialize(true);
    return success();
  }
  FieldLayout layout = *getFieldLayout(lookupField(loop, loop.getFieldAttr()));
  if (layout.path.getFirstSparse() || loop.getLevel()) {
    // If the owners depend on the result of an op with a side effect, the
    // adjoint needs that result too, and will report the error.
    if (needsUpdate &&
        llvm::all_of(open, [](auto &storage) { return storage.isActive; }))
      return success();
    DifferentiableAccessInterface write = open.front().getClaims().front();
    InFlightDiagnostic diag = write->emitError(
        "iterations of a parallel loop may write the same element here, "
        "and which of them is the last cannot be decided before the loop");
    diag.attachNote(loop.getLoc()) << "the loop visits the cells of a sparse "
                                      "field";
    diag.attachNote() << "compute the index, and the condition, in an earlier "
                         "loop and store them to fields";
    return failure();
  }
  // A loop over a field cannot be reversed on one thread: a loop over the range
  // of its indices replaces it.
  b.setInsertionPoint(loop);
  SmallVector<Value> from, to;
  for (auto [extent, first] : llvm::zip(layout.shape, layout.offset)) {
    from.push_back(index(first));
    to.push_back(index(first + extent));
  }
  if (from.empty())
    return success();
  auto box = ParallelForOp::create(b, from, to);
  box.copyNotesFrom(loop);
  box.setSerialize(true);
  Block &body = box.getBody().front();
  Block &old = loop.getBody().front();
  old.getTerminator()->erase();
  body.getOperations().splice(body.getTerminator()->getIterator(),
                              old.getOperations());
  for (auto [a, iv] : llvm::zip(old.getArguments(), body.getArguments()))
    a.replaceAllUsesWith(iv);
  loop->erase();
  return success();
}

LogicalResult mlir::tai::chooseWriters(FunctionOpInterface function,
                                       StoreFilter matters, bool isReversed) {
  // All loops are analysed before any of them is changed.
  SmallVector<std::pair<ParallelForOp, SmallVector<OpenStorage>>> loops;
  for (ParallelForOp loop : getParallelLoops(function))
    if (SmallVector<OpenStorage> open = findOpen(loop, matters, isReversed);
        !open.empty())
      loops.emplace_back(loop, std::move(open));
  LogicalResult result = success();
  for (auto &[loop, open] : loops) {
    LoopWriters writers(loop, std::move(open));
    if (!writers.decide() && failed(writers.serialize(isReversed)))
      result = failure();
  }
  return result;
}

//===----------------------------------------------------------------------===//
// The pass
//===----------------------------------------------------------------------===//

namespace {
struct ChooseWriters
    : SelectedFunctionsPass<ChooseWriters, tai::impl::ChooseWritersBase> {
  using SelectedFunctionsPass::SelectedFunctionsPass;

  LogicalResult runOnFunction(FunctionOpInterface function) {
    if (!function.getFunctionBody().hasOneBlock())
      return success();
    Activity activity(function, [&](Storage storage) {
      return mayHaveAdjoint(function, storage);
    });
    if (failed(checkLoopsWithoutOrder(function, activity)))
      return failure();
    auto isActive = [&](DifferentiableAccessInterface access) {
      return activity.isActiveAccess(access);
    };
    auto kernel = dyn_cast<KernelOp>(function.getOperation());
    if (!kernel || kernel.getPartOf())
      return chooseWriters(function, isActive, /*isReversed=*/true);
    if (!hasOpenStores(kernel, isActive, /*isReversed=*/true))
      return success();
    // The kernel without a tape stays as it is, because it does not matter
    // there which iteration's value remains. The tape gets a copy with owners.
    KernelOp part = kernel.clone();
    part.setSymName((kernel.getSymName() + ".0").str());
    part.setPartOfAttr(FlatSymbolRefAttr::get(kernel.getSymNameAttr()));
    kernel->getBlock()->getOperations().insertAfter(kernel->getIterator(),
                                                    part);
    if (succeeded(runOnFunction(part)))
      return success();
    part->erase();
    return failure();
  }
};
} // namespace
