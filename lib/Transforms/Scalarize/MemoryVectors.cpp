//===- MemoryVectors.cpp - Chooses vectors for memory ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Finds the vectors that are indexed at run time, with all vectors that loops,
// branches and writes connect with them, and decides whether connected vectors
// can share one buffer.
//
//===----------------------------------------------------------------------===//

#include "MemoryVectors.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"

using namespace mlir;
using namespace mlir::tai;

/// The number of components up to which selects are faster than memory: in a
/// loop, which would carry each component in a register and would not become
/// vectors of iterations, and elsewhere.
static constexpr int64_t kMaxInLoop = 6, kMaxElsewhere = 16;
/// The most bytes of a function's vectors in memory: stacks of threads are
/// small.
static constexpr int64_t kMaxBytes = 1 << 15;
/// The most accesses to vectors that need copies in a function: upstream finds
/// the copies in a time that grows with its third power.
static constexpr int64_t kMaxAccesses = 200;
/// The most comparisons of a vector with a write to a connected vector.
static constexpr int64_t kMaxPairs = 1 << 22;

//===----------------------------------------------------------------------===//
// Effects of ops on vectors
//===----------------------------------------------------------------------===//

bool tai::isControlFlow(Operation *op) {
  return isa<scf::ForOp, scf::WhileOp, scf::IfOp, scf::IndexSwitchOp>(op);
}

Operation *tai::getScope(Operation *op) {
  do
    op = op->getParentOp();
  while (isControlFlow(op));
  return op;
}

/// True if a loop in the scope of the op contains the op.
static bool isInLoop(Operation *op) {
  for (op = op->getParentOp(); isControlFlow(op); op = op->getParentOp())
    if (isa<LoopLikeOpInterface>(op))
      return true;
  return false;
}

Operation *tai::getScope(Value value) {
  if (Operation *op = value.getDefiningOp())
    return getScope(op);
  Operation *parent = cast<BlockArgument>(value).getOwner()->getParentOp();
  return isControlFlow(parent) ? getScope(parent) : parent;
}

template <typename Op> static bool isOfOneComponent(Op op, VectorType type) {
  return static_cast<int64_t>(op.getMixedPosition().size()) == type.getRank();
}
bool tai::isComponentRead(Operation *op) {
  auto extract = dyn_cast<vector::ExtractOp>(op);
  return extract && isOfOneComponent(extract, extract.getSourceVectorType());
}
bool tai::isComponentWrite(Operation *op) {
  auto insert = dyn_cast<vector::InsertOp>(op);
  return insert && isOfOneComponent(insert, insert.getDestVectorType());
}

bool tai::isAtRunTime(Operation *op) {
  if (isComponentRead(op))
    return !cast<vector::ExtractOp>(op).getDynamicPosition().empty();
  return isComponentWrite(op) &&
         !cast<vector::InsertOp>(op).getDynamicPosition().empty();
}
//===----------------------------------------------------------------------===//
// Vectors that share a buffer
//===----------------------------------------------------------------------===//

/// Joins vector values that are one vector of the program at different times,
/// such as the values that a loop carries.
void MemoryVectors::joinValuesOf(Operation *op) {
  auto yielded = [](Region &region) {
    return region.front().getTerminator()->getOperands();
  };
  if (auto loop = dyn_cast<scf::ForOp>(op)) {
    joinAll(loop.getInits(), loop.getRegionIterArgs(), loop.getYieldedValues(),
            loop.getResults());
  } else if (auto loop = dyn_cast<scf::WhileOp>(op)) {
    joinAll(loop.getInits(), loop.getBeforeArguments(),
            loop.getYieldOp().getOperands());
    joinAll(loop.getConditionOp().getArgs(), loop.getAfterArguments(),
            loop.getResults());
  } else if (isControlFlow(op)) {
    for (Region &region : op->getRegions())
      if (!region.empty())
        joinAll(op->getResults(), yielded(region));
  } else if (isComponentWrite(op)) {
    auto insert = cast<vector::InsertOp>(op);
    join(insert.getDest(), insert.getResult());
  } else if (auto cast = dyn_cast<vector::ShapeCastOp>(op)) {
    join(cast.getSource(), cast.getResult());
  }
}

static bool mayBeInMemory(Value value) {
  auto type = dyn_cast<VectorType>(value.getType());
  if (!type || type.isScalable() ||
      !type.getElementType().isIntOrIndexOrFloat())
    return false;
  // If a vector had users in two scopes, iterations of a parallel loop would
  // write the same buffer.
  Operation *scope = getScope(value);
  return llvm::all_of(value.getUsers(),
                      [&](Operation *user) { return getScope(user) == scope; });
}

/// The op that writes the components of a vector into its buffer, or null if
/// the vector is there already.
static Operation *getWriter(Value vector) {
  Operation *op = vector.getDefiningOp();
  return op && !isControlFlow(op) && !isa<vector::ShapeCastOp>(op) ? op
                                                                   : nullptr;
}

/// True if a use of the vector may be reached from `writer` without the vector
/// having been computed again.
static bool mayFollow(OpOperand &use, Operation *writer) {
  Operation *user = use.getOwner();
  Value vector = use.get();
  Region *region = vector.getParentRegion();
  // If a loop contains both the use and the writer, the use may follow in the
  // next iteration.
  for (Operation *op = writer->getParentOp(); op; op = op->getParentOp()) {
    if (op->isAncestor(region->getParentOp()))
      break;
    if (isa<LoopLikeOpInterface>(op) && op->isProperAncestor(user))
      return true;
  }
  if (user == writer)
    return false;
  // If an op contains both the use and the writer in different regions, the
  // region of the use may run later.
  Operation *common = writer->getParentOp();
  while (!common->isAncestor(user))
    common = common->getParentOp();
  if (common == user)
    return false;
  auto childOf = [&](Operation *op) {
    while (op->getParentOp() != common)
      op = op->getParentOp();
    return op;
  };
  Operation *first = childOf(writer), *second = childOf(user);
  if (first->getBlock() == second->getBlock())
    return first->isBeforeInBlock(second);
  // Only one region of a branch runs.
  return !isa<scf::IfOp, scf::IndexSwitchOp>(common);
}

/// True if the vectors `members` can share a buffer: each use of one comes
/// before the next write of another.
static bool canShareBuffer(ArrayRef<Value> members, DominanceInfo &dominance) {
  // The arguments of a block are all written at its start, so only one of them
  // can be in the buffer.
  if (llvm::count_if(members, [](Value member) {
        return isa<BlockArgument>(member) &&
               !isControlFlow(member.getParentBlock()->getParentOp());
      }) > 1)
    return false;
  for (Value written : members) {
    Operation *writer = getWriter(written);
    if (!writer)
      continue;
    for (Value other : members) {
      if (other == written || !dominance.properlyDominates(other, writer))
        continue;
      for (OpOperand &use : other.getUses())
        if (mayFollow(use, writer))
          return false;
    }
  }
  return true;
}

void MemoryVectors::choose(ArrayRef<Value> members, DominanceInfo &dominance) {
  auto type = cast<VectorType>(members.front().getType());
  if (!llvm::all_of(members, mayBeInMemory))
    return;
  int64_t width =
      type.getElementType().isIndex() ? 64 : type.getElementTypeBitWidth();
  int64_t own = type.getNumElements() * llvm::divideCeil(width, 8);
  if (bytes + own > kMaxBytes)
    return;
  int64_t uses = 0;
  for (Value member : members)
    uses += llvm::count_if(member.getUsers(), [](Operation *user) {
      return isComponentRead(user) || isComponentWrite(user);
    });
  int64_t ownPairs =
      int64_t(members.size()) *
      llvm::count_if(members, [](Value v) { return getWriter(v) != nullptr; });
  std::optional<unsigned> buffer;
  if (pairs + ownPairs <= kMaxPairs && canShareBuffer(members, dominance))
    buffer = numBuffers++;
  else if (!withCopies || accesses + uses > kMaxAccesses)
    return;
  else
    accesses += uses;
  pairs += ownPairs;
  bytes += own;
  for (Value member : members)
    chosen[member] = buffer;
}

MemoryVectors::MemoryVectors(FunctionOpInterface function, bool withCopies)
    : withCopies(withCopies) {
  // Vectors that are accessed at a position computed at run time, and the
  // number of components up to which they stay scalars.
  SmallVector<std::pair<Value, int64_t>> roots;
  function.walk([&](Operation *op) {
    joinValuesOf(op);
    if (isAtRunTime(op))
      roots.emplace_back(isComponentRead(op)
                             ? cast<vector::ExtractOp>(op).getSource()
                             : cast<vector::InsertOp>(op).getDest(),
                         isInLoop(op) ? kMaxInLoop : kMaxElsewhere);
  });
  DominanceInfo dominance(function);
  llvm::DenseSet<Value> seen;
  for (auto [root, most] : roots) {
    auto type = cast<VectorType>(root.getType());
    if (type.getNumElements() <= most || seen.contains(root))
      continue;
    SmallVector<Value> members{root};
    if (auto found = classes.findLeader(root); found != classes.member_end())
      members.assign(found, classes.member_end());
    seen.insert(members.begin(), members.end());
    choose(members, dominance);
  }
}
