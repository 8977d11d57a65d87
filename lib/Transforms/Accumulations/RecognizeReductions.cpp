//===- RecognizeReductions.cpp - Updates of shared elements ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An iteration of a parallel loop loads an element, combines it with a value
// and stores it. Where other iterations may do so with the same element, some
// of the updates are lost, unless they are atomic.
//
// A store is followed backwards to the loads of its element. It is an update if
// all ops in between are one associative and commutative operation; each of
// these steps becomes an atomic:
//
//   old                          nothing
//   update + e, e + update, ...  the update, and then an atomic with e
//   select c, update, update     each under its condition
//   scf.if, whose branches yield updates of one update in front of it
//   select (e < old), e, old     an atomic minimum with e
//   if (e < old) { store e }     an atomic minimum with e
//   a minimum under conditions   an atomic under them (ChosenExtremum.h)
//   components of a vector       each for itself (SplitComponents.h)
//
// The store itself is erased.
//
// Other updates are refused where they certainly are races; so are reads of
// elements that other iterations write (OtherIterations.cpp).
//
//===----------------------------------------------------------------------===//

#include "IterationShadow.h"
#include "OtherIterations.h"
#include "SharedUpdate.h"
#include "SplitComponents.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/IterationOrder.h"
#include "tai/Analysis/Reductions/Accumulation.h"
#include "tai/Transforms/Passes.h"
#include "llvm/ADT/StringSet.h"

namespace mlir::tai {
#define GEN_PASS_DEF_RECOGNIZEREDUCTIONS
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Loops
//===----------------------------------------------------------------------===//

namespace {
/// Finds and rewrites the updates of shared elements in one parallel loop.
class LoopUpdates {
public:
  explicit LoopUpdates(ParallelForOp loop) : loop(loop), same(loop) {}

  /// Rewrites the updates of the loop. `oneThread`: a single thread runs the
  /// loop. `atLaunch`, `atRun`: possible races are checked at the launch, or as
  /// the loop runs.
  LogicalResult run(bool oneThread, bool atLaunch, bool atRun);

private:
  using Reads =
      llvm::DenseMap<const void *, SmallVector<DifferentiableAccessInterface>>;

  OtherIterations findOthers(ArrayRef<DifferentiableAccessInterface> refused);
  static bool isCandidate(DifferentiableAccessInterface access,
                          const Reads &reads);
  void findOwned(Reads &reads);
  bool mayMeet(DifferentiableAccessInterface store,
               DifferentiableAccessInterface other) const;
  void check(DifferentiableAccessInterface store);
  bool isAlone(SharedUpdate &update);
  void report(DifferentiableAccessInterface store);

  ParallelForOp loop;
  SameIteration same;
  SmallVector<DifferentiableAccessInterface> accesses;
  /// Updates of elements that other iterations may reach.
  SmallVector<std::unique_ptr<SharedUpdate>> updates;
  /// Updates of elements that no other iteration reaches by the same access,
  /// but possibly by another access.
  SmallVector<std::unique_ptr<SharedUpdate>> owned;
};
} // namespace

void LoopUpdates::report(DifferentiableAccessInterface store) {
  InFlightDiagnostic diag =
      store->emitError()
      << describeElement(store)
      << " is read and written by the iterations of a parallel loop, and the "
         "result would depend on which of them comes first";
  diag.attachNote(loop->getLoc())
      << "run this loop on one thread ('serialize')";
  diag.attachNote() << "or update it by one operation whose order does not "
                       "matter (+, -, *, min, max, &, |, ^), and read it in a "
                       "later loop";
}

/// True for a store to a storage that the loop also reads, which may be an
/// update.
bool LoopUpdates::isCandidate(DifferentiableAccessInterface access,
                              const Reads &reads) {
  return isa<StoreOp, memref::StoreOp>(access.getOperation()) &&
         reads.contains(getStorageKey(access));
}

/// True unless the two accesses provably reach different elements or
/// components.
bool LoopUpdates::mayMeet(DifferentiableAccessInterface store,
                          DifferentiableAccessInterface other) const {
  return getStorageKey(store) == getStorageKey(other) &&
         !areProvablyDistinct(store.getAccessIndices(),
                              other.getAccessIndices()) &&
         (store.getAccessComponents().empty() ||
          !areProvablyDistinct(store.getAccessComponents(),
                               other.getAccessComponents()));
}

static ElementPlace getPlace(DifferentiableAccessInterface access) {
  return {access.getAccessIndices(), access.getAccessComponents()};
}

/// Finds the updates whose own indices reach a different element in each
/// iteration, while other accesses may write these elements in other
/// iterations.
void LoopUpdates::findOwned(Reads &reads) {
  auto isMetBy = [&](DifferentiableAccessInterface access, auto other) {
    return other != access && other.getAccessKind() != AccessKind::Read &&
           getStorageKey(other) == getStorageKey(access) &&
           tai::mayMeet(loop, getPlace(access), getPlace(other));
  };
  for (DifferentiableAccessInterface access : accesses) {
    if (!isCandidate(access, reads) ||
        getSharing(access, loop) != Sharing::Own ||
        llvm::none_of(accesses,
                      [&](auto other) { return isMetBy(access, other); }))
      continue;
    auto update = std::make_unique<SharedUpdate>(
        access, loop, accesses, reads[getStorageKey(access)], same);
    if (update->readsElement() && update->match())
      owned.push_back(std::move(update));
  }
}

/// True if the loop accesses the element of an update by updates of one kind
/// alone.
bool LoopUpdates::isAlone(SharedUpdate &update) {
  DifferentiableAccessInterface store = update.getStore();
  for (DifferentiableAccessInterface other : accesses) {
    if (other == store || llvm::is_contained(update.getLoads(), other) ||
        !mayMeet(store, other))
      continue;
    auto atomic = dyn_cast<AtomicOp>(other.getOperation());
    if (atomic && getCombiningKind(atomic.getKind()) == update.getFamily())
      continue;
    auto isOfUpdate = [&](const std::unique_ptr<SharedUpdate> &known) {
      return known->getFamily() == update.getFamily() &&
             (known->getStore() == other ||
              llvm::is_contained(known->getLoads(), other));
    };
    if (llvm::any_of(
            llvm::concat<std::unique_ptr<SharedUpdate>>(updates, owned),
            isOfUpdate))
      continue;
    // A read that may reach another element is allowed beside an update, as it
    // is beside an atomic.
    if (other.getAccessKind() == AccessKind::Read &&
        !same.reachSame(store, other))
      continue;
    return false;
  }
  return true;
}

/// Adds code to the loop that reports the store if another iteration has
/// reached its element by the same store before.
void LoopUpdates::check(DifferentiableAccessInterface store) {
  std::optional<IterationShadow> shadow = IterationShadow::create(loop, store);
  if (!shadow)
    return;
  Value array = shadow->createArray();
  shadow->moveTo(store);
  Value isAlone = shadow->leave(array, store);
  shadow->require(isAlone, store,
                  "is read and written by two iterations of a parallel loop, "
                  "and the result would depend on which of them comes first");
}

/// True if the value of a read reaches a value or an index of a write: a total
/// so far, as in `count[None] += 1; list[count[None]] = i`. Comparisons end
/// the search, because `if count[None] < n` only saves work.
static bool leavesData(DifferentiableAccessInterface read, ParallelForOp loop) {
  SmallVector<OpOperand *> todo;
  llvm::SmallPtrSet<Value, 16> seen;
  auto follow = [&](ValueRange values) {
    for (Value value : values)
      if (!value.getType().isInteger(1) && seen.insert(value).second)
        for (OpOperand &use : value.getUses())
          todo.push_back(&use);
  };
  follow(read->getResults());
  while (!todo.empty()) {
    OpOperand &use = *todo.pop_back_val();
    Operation *op = use.getOwner();
    if (auto access = dyn_cast<DifferentiableAccessInterface>(op);
        access && access.getAccessKind() != AccessKind::Read) {
      Value memref = access.getAccessedStorage().memref;
      if (!memref || isa<BlockArgument>(memref))
        return true;
      continue;
    }
    if (op->hasTrait<OpTrait::IsTerminator>()) {
      Operation *parent = op->getParentOp();
      if (parent == loop)
        continue;
      follow(parent->getResults());
      for (Region &region : parent->getRegions())
        if (!isa<scf::IfOp>(parent))
          follow(region.getArguments());
      continue;
    }
    // Bounds of loops and conditions of branches decide; they are no data.
    if (auto inner = dyn_cast<scf::ForOp>(op)) {
      if (OpResult result = inner.getTiedLoopResult(&use))
        follow({result, inner.getTiedLoopRegionIterArg(&use)});
    } else if (op->getNumRegions() != 0) {
      for (Region &region : op->getRegions())
        follow(region.getArguments());
    } else {
      follow(op->getResults());
    }
  }
  return false;
}

/// Finds reads of elements that other iterations write. Atomics on a shared
/// element commute, and do not count as writes, except where the loop keeps a
/// total so far; an atomic on an element that belongs to its iteration does.
/// `known` are stores that are not updates: reads of the element that they
/// store are not reported again.
OtherIterations
LoopUpdates::findOthers(ArrayRef<DifferentiableAccessInterface> known) {
  SmallVector<DifferentiableAccessInterface> writes, reads;
  auto isWrite = [&](DifferentiableAccessInterface access) {
    if (isTotal(access))
      return true;
    return isa<StoreOp, memref::StoreOp>(access.getOperation()) &&
           llvm::none_of(
               llvm::concat<std::unique_ptr<SharedUpdate>>(updates, owned),
               [&](auto &update) { return update->getStore() == access; });
  };
  for (DifferentiableAccessInterface access : accesses) {
    Value memref = access.getAccessedStorage().memref;
    if (getEnclosingParallelLoop(access) != loop ||
        (memref && !isa<BlockArgument>(memref)))
      continue;
    if (access.getAccessKind() == AccessKind::Read)
      reads.push_back(access);
    else if (isWrite(access))
      writes.push_back(access);
  }
  OtherIterations others(loop);
  // Iterations that store one value to a shared element set a flag, and may
  // read it to save work.
  llvm::DenseMap<Operation *, bool> readsFlag;
  auto isFlag = [&](auto write, auto read) {
    if (!isa<StoreOp, memref::StoreOp>(write.getOperation()) ||
        getSharing(write, loop) == Sharing::Own || !storesTheSame(write, loop))
      return false;
    auto [found, isNew] = readsFlag.insert({read, false});
    if (isNew)
      found->second = decidesOnlyFlags(read, loop);
    return found->second;
  };
  llvm::DenseMap<Operation *, bool> isData;
  auto isHint = [&](auto write, auto read) {
    if (!isTotal(write) || getSharing(write, loop) == Sharing::Own)
      return false;
    auto [found, isNew] = isData.insert({read, false});
    if (isNew)
      found->second = leavesData(read, loop);
    return !found->second;
  };
  others.find(
      writes, reads,
      [&](auto write, auto read) {
        return isHint(write, read) ||
               (llvm::is_contained(known, write) &&
                same.reachSame(write, read)) ||
               isFlag(write, read);
      },
      [&](auto write, auto read) {
        // All iterations that do it update the element, and there are several.
        return isTotal(write) && getSharing(write, loop) == Sharing::Certain &&
               same.reachSame(write, read);
      });
  return others;
}

LogicalResult LoopUpdates::run(bool oneThread, bool atLaunch, bool atRun) {
  Reads reads;
  loop.walk([&](DifferentiableAccessInterface access) {
    accesses.push_back(access);
    if (access.getAccessKind() == AccessKind::Read)
      reads[getStorageKey(access)].push_back(access);
  });
  SmallVector<DifferentiableAccessInterface> others, certain, possible;
  for (DifferentiableAccessInterface access : accesses) {
    if (!isCandidate(access, reads))
      continue;
    auto update = std::make_unique<SharedUpdate>(
        access, loop, accesses, reads[getStorageKey(access)], same);
    if (!update->readsElement())
      continue;
    if (getSharing(access, loop) == Sharing::Own)
      continue;
    if (update->match())
      updates.push_back(std::move(update));
    else if (!storesTheSame(access, loop))
      others.push_back(access);
  }
  findOwned(reads);
  // Removing an update from `owned` can leave others with conflicting accesses,
  // so the check is repeated until nothing changes.
  bool changed = true;
  while (changed) {
    changed = false;
    llvm::erase_if(owned, [&](std::unique_ptr<SharedUpdate> &update) {
      return !isAlone(*update) && (changed = true);
    });
    llvm::erase_if(updates, [&](std::unique_ptr<SharedUpdate> &update) {
      if (isAlone(*update))
        return false;
      if (!storesTheSame(update->getStore(), loop))
        others.push_back(update->getStore());
      return changed = true;
    });
  }
  OtherIterations otherIterations = findOthers(others);
  for (DifferentiableAccessInterface store : others)
    (getSharing(store, loop) == Sharing::Certain ? certain : possible)
        .push_back(store);
  bool isCertain = !certain.empty() || otherIterations.anyCertain();
  if (isCertain && !oneThread) {
    llvm::for_each(certain, [&](auto store) { report(store); });
    otherIterations.report();
    return failure();
  }
  if (isCertain)
    loop.setSerialize(true);
  // If one thread runs the iterations in order, reads of elements that other
  // iterations write are defined.
  if (atLaunch && !oneThread)
    otherIterations.refuseLaunches();
  if (atRun && !oneThread) {
    llvm::for_each(possible, [&](auto store) { check(store); });
    otherIterations.check();
  }
  for (std::unique_ptr<SharedUpdate> &update :
       llvm::concat<std::unique_ptr<SharedUpdate>>(updates, owned))
    update->rewrite();
  return success();
}

namespace {
struct RecognizeReductions
    : tai::impl::RecognizeReductionsBase<RecognizeReductions> {
  using Base::Base;

  void runOnOperation() override {
    // Kernels made by differentiation already have atomics where necessary, and
    // are skipped.
    llvm::StringSet<> derived;
    getOperation().walk([&](KernelOp kernel) {
      for (FlatSymbolRefAttr name :
           {kernel.getAdjointAttr(), kernel.getTangentAttr()})
        if (name)
          derived.insert(name.getValue());
    });
    bool hasErrors = false;
    for (auto function : getOperation().getOps<FunctionOpInterface>()) {
      if (derived.contains(function.getName()))
        continue;
      SmallVector<ParallelForOp> loops;
      function.walk([&](ParallelForOp loop) {
        if (!loop.getSerialize())
          loops.push_back(loop);
      });
      for (ParallelForOp loop : loops) {
        splitComponents(loop);
        hasErrors |= failed(LoopUpdates(loop).run(
            oneThread, checks,
            checks && function->hasAttr(kCheckUpdatesAttrName)));
      }
    }
    if (hasErrors)
      signalPassFailure();
  }
};
} // namespace
