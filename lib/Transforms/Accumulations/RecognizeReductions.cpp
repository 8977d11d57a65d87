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
// all that lies in between is one associative and commutative operation, at
// which each step becomes an atomic:
//
//   old                          nothing
//   update + e, e + update, ...  the update, and then an atomic with e
//   select c, update, update     each under its condition
//   scf.if, whose branches yield updates
//   select (e < old), e, old     an atomic minimum with e
//   if (e < old) { store e }     the same, also where more conditions hold
//
// The last step of all is the store, which goes.
//
//===----------------------------------------------------------------------===//

#include "Guards.h"
#include "SharedUpdate.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "tai/ABI/Abi.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Transforms/Passes.h"
#include "tai/Transforms/Utils/Accumulation.h"
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
/// The updates of one loop.
class LoopUpdates {
public:
  explicit LoopUpdates(ParallelForOp loop) : loop(loop), same(loop) {}

  LogicalResult run(bool oneThread, bool checks);

private:
  void check(DifferentiableAccessInterface store);
  bool isAlone(SharedUpdate &update);
  void report(DifferentiableAccessInterface store);

  ParallelForOp loop;
  SameIteration same;
  SmallVector<DifferentiableAccessInterface> accesses;
  SmallVector<std::unique_ptr<SharedUpdate>> updates;
};
} // namespace

static std::string getName(DifferentiableAccessInterface access) {
  if (FlatSymbolRefAttr field = access.getAccessedStorage().field)
    return ("an element of field '@" + field.getValue() + "'").str();
  return "an element of an array";
}

void LoopUpdates::report(DifferentiableAccessInterface store) {
  InFlightDiagnostic diag =
      store->emitError()
      << getName(store)
      << " is read and written by the iterations of a parallel loop, and the "
         "result would depend on which of them comes first";
  diag.attachNote(loop->getLoc())
      << "run this loop on one thread ('serialize')";
  diag.attachNote() << "or update it by one operation whose order does not "
                       "matter (+, -, *, min, max, &, |, ^), and read it in a "
                       "later loop";
}

/// True if all that the loop does with the element is updates of one kind.
bool LoopUpdates::isAlone(SharedUpdate &update) {
  DifferentiableAccessInterface store = update.getStore();
  const void *key = getStorageKey(store);
  for (DifferentiableAccessInterface other : accesses) {
    if (getStorageKey(other) != key || other == store ||
        llvm::is_contained(update.getLoads(), other) ||
        areProvablyDistinct(store.getAccessIndices(),
                            other.getAccessIndices()) ||
        (!store.getAccessComponents().empty() &&
         areProvablyDistinct(store.getAccessComponents(),
                             other.getAccessComponents())))
      continue;
    auto atomic = dyn_cast<AtomicOp>(other.getOperation());
    if (atomic && getCombiningKind(atomic.getKind()) == update.getFamily())
      continue;
    bool isOfUpdate = llvm::any_of(updates, [&](auto &known) {
      return known->getFamily() == update.getFamily() &&
             (known->getStore() == other ||
              llvm::is_contained(known->getLoads(), other));
    });
    if (isOfUpdate)
      continue;
    // Reads of an element that is not certainly the same are left to the
    // program, as beside an atomic.
    if (other.getAccessKind() == AccessKind::Read &&
        !same.reachSame(store, other))
      continue;
    return false;
  }
  return true;
}

/// Has the loop report the store if another iteration has come to its element
/// by it before. Each leaves its number: the greatest so far is another one at
/// the latest when the second one comes.
void LoopUpdates::check(DifferentiableAccessInterface store) {
  constexpr int64_t most = int64_t(1) << 27;
  ImplicitLocOpBuilder b(store->getLoc(), loop);
  auto index = [&](int64_t value) -> Value {
    return arith::ConstantIndexOp::create(b, value);
  };
  SmallVector<Value> position(store.getAccessIndices());
  llvm::append_range(position, store.getAccessComponents());
  SmallVector<Value> extents;
  int64_t known = 1;
  if (FlatSymbolRefAttr name = store.getAccessedStorage().field) {
    FieldOp field = lookupField(loop, name);
    FailureOr<FieldLayout> layout = getFieldLayout(field);
    if (failed(layout))
      return;
    SmallVector<int64_t> shape(layout->shape);
    if (auto vector = dyn_cast<VectorType>(field.getType());
        vector && !store.getAccessComponents().empty())
      llvm::append_range(shape, vector.getShape());
    for (int64_t extent : shape) {
      if (llvm::MulOverflow(known, extent, known) || known > most)
        return;
      extents.push_back(index(extent));
    }
  } else {
    Value array = store.getAccessedStorage().memref;
    for (auto [dim, value] : llvm::enumerate(position))
      extents.push_back(memref::DimOp::create(b, array, index(dim)));
  }
  Value size = index(1);
  for (Value extent : extents)
    size = b.createOrFold<arith::MulIOp>(size, extent);
  size = b.createOrFold<arith::MaxSIOp>(size, index(1));
  Type real = b.getF64Type();
  auto constant = [&](double value) -> Value {
    return arith::ConstantOp::create(b, b.getF64FloatAttr(value));
  };
  Value shadow = memref::AllocOp::create(
      b, MemRefType::get({ShapedType::kDynamic}, real), size);
  auto clear = ParallelForOp::create(b, index(0), size);
  {
    OpBuilder::InsertionGuard guard(b);
    b.setInsertionPointToStart(&clear.getBody().front());
    memref::StoreOp::create(b, constant(-1), shadow,
                            clear.getInductionVars().front());
  }
  // Indices beyond the extents are reported by others.
  b.setInsertionPoint(store);
  Value number = index(0), iteration = index(0);
  for (auto [value, extent] : llvm::zip_equal(position, extents))
    number = arith::AddIOp::create(b, arith::MulIOp::create(b, number, extent),
                                   value);
  number = arith::RemUIOp::create(b, number, size);
  for (Value iv : loop.getInductionVars())
    iteration = arith::AddIOp::create(
        b, arith::MulIOp::create(b, iteration, index(1000003)), iv);
  Value wide = arith::IndexCastOp::create(b, b.getI64Type(), iteration);
  wide = arith::AndIOp::create(
      b, wide, arith::ConstantIntOp::create(b, (int64_t(1) << 52) - 1, 64));
  Value own = arith::SIToFPOp::create(b, real, wide);
  Value before = memref::AtomicRMWOp::create(b, arith::AtomicRMWKind::maximumf,
                                             own, shadow, number);
  using Predicate = arith::CmpFPredicate;
  Value isAlone = arith::OrIOp::create(
      b, arith::CmpFOp::create(b, Predicate::OLT, before, constant(0)),
      arith::CmpFOp::create(b, Predicate::OEQ, before, own));
  std::string message = getName(store);
  if (!position.empty()) {
    message += ", at [";
    for (size_t i = 0; i != position.size(); ++i)
      message += i ? ", {}" : "{}";
    message += "],";
  }
  message += " is read and written by two iterations of a parallel loop, and "
             "the result would depend on which of them comes first";
  AssertOp::create(b, isAlone, b.getStringAttr(message), position,
                   b.getI32IntegerAttr(TAI_FAIL_ASSERT));
  b.setInsertionPointAfter(loop);
  memref::DeallocOp::create(b, shadow);
}

LogicalResult LoopUpdates::run(bool oneThread, bool checks) {
  llvm::DenseMap<const void *, SmallVector<DifferentiableAccessInterface>>
      reads;
  loop.walk([&](DifferentiableAccessInterface access) {
    accesses.push_back(access);
    if (access.getAccessKind() == AccessKind::Read)
      reads[getStorageKey(access)].push_back(access);
  });
  auto isCandidate = [&](DifferentiableAccessInterface access) {
    return isa<StoreOp, memref::StoreOp>(access.getOperation()) &&
           reads.contains(getStorageKey(access));
  };
  // Before anything is remembered about the branches.
  for (DifferentiableAccessInterface access : accesses) {
    if (!isCandidate(access))
      continue;
    SharedUpdate update(access, loop, reads[getStorageKey(access)], same);
    if (update.readsElement() && !update.match())
      joinGuards(access, loop, same, accesses);
  }
  SmallVector<DifferentiableAccessInterface> others, certain, possible;
  for (DifferentiableAccessInterface access : accesses) {
    if (!isCandidate(access))
      continue;
    auto update = std::make_unique<SharedUpdate>(
        access, loop, reads[getStorageKey(access)], same);
    if (!update->readsElement())
      continue;
    if (update->readsOtherIteration()) {
      certain.push_back(access);
      continue;
    }
    if (getSharing(access, loop) == Sharing::Own)
      continue;
    if (update->match())
      updates.push_back(std::move(update));
    else if (!update->storesTheSame())
      others.push_back(access);
  }
  // Taking one away may take the reason of another one away.
  bool changed = true;
  while (changed) {
    changed = false;
    llvm::erase_if(updates, [&](std::unique_ptr<SharedUpdate> &update) {
      if (isAlone(*update))
        return false;
      if (!update->storesTheSame())
        others.push_back(update->getStore());
      return changed = true;
    });
  }
  for (DifferentiableAccessInterface store : others)
    (getSharing(store, loop) == Sharing::Certain ? certain : possible)
        .push_back(store);
  if (!certain.empty() && !oneThread) {
    llvm::for_each(certain, [&](auto store) { report(store); });
    return failure();
  }
  if (!certain.empty())
    loop.setSerialize(true);
  else if (checks)
    llvm::for_each(possible, [&](auto store) { check(store); });
  for (std::unique_ptr<SharedUpdate> &update : updates)
    update->rewrite();
  return success();
}

namespace {
struct RecognizeReductions
    : tai::impl::RecognizeReductionsBase<RecognizeReductions> {
  using Base::Base;

  void runOnOperation() override {
    // Kernels made by differentiation have their updates in order.
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
      for (ParallelForOp loop : loops)
        hasErrors |= failed(LoopUpdates(loop).run(
            oneThread, checks && function->hasAttr(kCheckUpdatesAttrName)));
    }
    if (hasErrors)
      signalPassFailure();
  }
};
} // namespace
