//===- StoreFirst.cpp - Adjoints that are stored before they are read -----===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Finds the adjoint fields to which a kernel adds, in each element once, before
// it uses them in any other way. The number that such an addition finds is zero
// if the launch says so, so that nobody has to clear the field before.
//
// Results have the same bits: the addition is made to a zero, as it would be in
// memory that has been cleared.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/Interfaces/CallInterfaces.h"
#include "tai/Analysis/FieldTable.h"
#include "tai/Dialect/Tai/IR/StoresFirst.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "tai/Transforms/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_STOREFIRST
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

namespace {
/// Decides about one adjoint field of a kernel.
class FirstStores {
public:
  FirstStores(FieldTable &fields, const FieldInfo &adjoint)
      : fields(fields), adjoint(adjoint) {}

  /// True if the first accesses to the field store all of its elements.
  bool match(KernelOp kernel) {
    bool isDone = false;
    return visitKernel(kernel.getBody().front(), isDone) && isDone;
  }
  /// Makes these accesses start at zero if the launch says so.
  void rewrite(uint32_t number) const;

private:
  /// The components of an element that have been stored.
  using Stored = SmallVector<bool, 4>;

  bool isAccess(Operation *op) const;
  bool hasAccess(Operation *op) const;
  bool visitKernel(Block &block, bool &isDone);
  bool coversField(ParallelForOp loop) const;
  bool visitBody(ParallelForOp loop, Block &block, Stored &stored);
  bool visitAddition(ParallelForOp loop, AtomicOp op, Stored &stored);

  FieldTable &fields;
  const FieldInfo &adjoint;
  /// The index of the loop along each dimension of the field.
  SmallVector<Value> indices;
  SmallVector<AtomicOp> first;
};
} // namespace

/// True if `op` names the field, or another field at the same place.
bool FirstStores::isAccess(Operation *op) const {
  auto name = op->getAttrOfType<FlatSymbolRefAttr>("field");
  if (!name || isa<ParallelForOp>(op))
    return false;
  FailureOr<const FieldInfo *> info = fields.lookup(op, name);
  return failed(info) || (*info)->scope == adjoint.scope;
}

bool FirstStores::hasAccess(Operation *op) const {
  return op
      ->walk([&](Operation *inner) {
        return isAccess(inner) ? WalkResult::interrupt()
                               : WalkResult::advance();
      })
      .wasInterrupted();
}

/// True if the loop has an iteration for each element of the field.
bool FirstStores::coversField(ParallelForOp loop) const {
  ArrayRef<int64_t> shape = adjoint.layout.shape;
  if (loop.getField() || loop.getBody().getNumArguments() != shape.size() ||
      llvm::any_of(adjoint.layout.offset,
                   [](int64_t offset) { return offset != 0; }))
    return false;
  for (auto [index, extent] : llvm::zip(indices, shape)) {
    auto argument = dyn_cast<BlockArgument>(index);
    if (!argument || argument.getOwner() != &loop.getBody().front() ||
        llvm::count(indices, index) != 1)
      return false;
    unsigned number = argument.getArgNumber();
    if (getConstantIntValue(loop.getLowerBounds()[number]) != 0 ||
        getConstantIntValue(loop.getUpperBounds()[number]) != extent)
      return false;
  }
  return true;
}

/// Visits an addition in the loop. False if it is none that an iteration makes
/// to an element of its own, or if the loop does not reach all elements.
bool FirstStores::visitAddition(ParallelForOp loop, AtomicOp op,
                                Stored &stored) {
  if (op.getKind() != AtomicKind::Add || !op.getExclusive() ||
      !op.getOld().use_empty() || op.getValue().getType() != adjoint.scalarType)
    return false;
  if (indices.empty()) {
    llvm::append_range(indices, op.getIndices());
    if (!coversField(loop))
      return false;
  }
  if (!llvm::equal(indices, op.getIndices()))
    return false;
  int64_t component = 0;
  if (!op.getComponents().empty()) {
    for (auto [index, extent] :
         llvm::zip_equal(op.getComponents(), adjoint.elementShape)) {
      std::optional<int64_t> number = getConstantIntValue(index);
      if (!number)
        return false;
      component = component * extent + *number;
    }
  }
  if (component < 0 || component >= int64_t(stored.size()))
    return false;
  if (!stored[component])
    first.push_back(op);
  stored[component] = true;
  return true;
}

/// Visits a block that each iteration runs once. False if an iteration may
/// leave out an element that another one stores, or read it before.
bool FirstStores::visitBody(ParallelForOp loop, Block &block, Stored &stored) {
  for (Operation &op : block) {
    if (isAccess(&op)) {
      auto addition = dyn_cast<AtomicOp>(op);
      if (!addition || !visitAddition(loop, addition, stored))
        return false;
      continue;
    }
    if (op.getNumRegions() == 0 || !hasAccess(&op))
      continue;
    auto branch = dyn_cast<scf::IfOp>(op);
    if (!branch || branch.getElseRegion().empty())
      return false;
    Stored other = stored;
    if (!visitBody(loop, branch.getThenRegion().front(), stored) ||
        !visitBody(loop, branch.getElseRegion().front(), other) ||
        stored != other)
      return false;
  }
  return true;
}

/// Visits a block of the kernel outside of parallel loops, up to the loop that
/// stores the field, and sets `isDone` there.
bool FirstStores::visitKernel(Block &block, bool &isDone) {
  for (Operation &op : block) {
    if (isa<CallOpInterface>(op))
      return false;
    if (isDone || !hasAccess(&op))
      continue;
    if (auto loop = dyn_cast<ParallelForOp>(op)) {
      indices.clear();
      Stored stored(adjoint.numComponents, false);
      if (!visitBody(loop, loop.getBody().front(), stored) ||
          llvm::is_contained(stored, false))
        return false;
      isDone = true;
      continue;
    }
    auto branch = dyn_cast<scf::IfOp>(op);
    if (!branch || branch.getElseRegion().empty())
      return false;
    bool isDoneElse = isDone;
    if (!visitKernel(branch.getThenRegion().front(), isDone) ||
        !visitKernel(branch.getElseRegion().front(), isDoneElse) ||
        isDone != isDoneElse)
      return false;
  }
  return true;
}

void FirstStores::rewrite(uint32_t number) const {
  for (AtomicOp op : first) {
    OpBuilder builder(op);
    Location loc = op.getLoc();
    Type type = op.getValue().getType();
    Value known =
        StartsAtZeroOp::create(builder, loc, builder.getI1Type(),
                               builder.getI32IntegerAttr(int32_t(number)));
    Value old = LoadOp::create(builder, loc, type, op.getFieldAttr(),
                               op.getIndices(), op.getComponents());
    Value zero = arith::ConstantOp::create(builder, loc, type,
                                           builder.getFloatAttr(type, 0.0));
    Value start = arith::SelectOp::create(builder, loc, known, zero, old);
    Value sum = arith::AddFOp::create(builder, loc, start, op.getValue());
    StoreOp::create(builder, loc, sum, op.getFieldAttr(), op.getIndices(),
                    op.getComponents());
    AtomicOp(op).erase();
  }
}

namespace {
struct StoreFirst : tai::impl::StoreFirstBase<StoreFirst> {
  using Base::Base;

  void runOnOperation() override {
    auto kernel = dyn_cast<KernelOp>(getOperation());
    Operation *table = SymbolTable::getNearestSymbolTable(getOperation());
    if (!kernel || !table)
      return;
    DenseSet<StringRef> adjoints;
    for (FieldOp field : table->getRegion(0).getOps<FieldOp>())
      if (std::optional<StringRef> adjoint = field.getAdjoint())
        adjoints.insert(*adjoint);
    if (adjoints.empty())
      return;
    FieldTable fields(table);
    llvm::SetVector<StringRef> names;
    kernel.walk([&](AtomicOp op) {
      if (op.getExclusive() && adjoints.contains(op.getField()))
        names.insert(op.getField());
    });
    SmallVector<Attribute> stored;
    for (StringRef name : names) {
      FailureOr<const FieldInfo *> info =
          fields.lookup(kernel, FlatSymbolRefAttr::get(&getContext(), name));
      if (failed(info))
        return signalPassFailure();
      const FieldInfo &field = **info;
      Type type = field.scalarType;
      if (!field.sparse.empty() || !(type.isF32() || type.isF64()) ||
          field.getNumElements() * field.numComponents * field.scalarSize <
              minBytes ||
          stored.size() == kMostStoresFirst)
        continue;
      FirstStores first(fields, field);
      if (!first.match(kernel))
        continue;
      first.rewrite(stored.size());
      stored.push_back(StringAttr::get(&getContext(), name));
    }
    if (!stored.empty())
      kernel->setAttr(kStoresFirst, ArrayAttr::get(&getContext(), stored));
  }
};
} // namespace
