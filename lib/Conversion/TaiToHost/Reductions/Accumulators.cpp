//===- Accumulators.cpp - Partial sums of a parallel loop -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Conversion/TaiToHost/Reductions/Accumulators.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Analysis/Cost.h"
#include "tai/Transforms/Utils/IndexMath.h"

using namespace mlir;
using namespace mlir::tai;

/// Partial sums of two partitions must not share a cache line.
constexpr int64_t kCacheLine = 64;

/// Returns the indices as values before the loop; copies constants that are
/// defined inside the loop.
static SmallVector<Value> getOutside(ValueRange values, ParallelForOp loop) {
  OpBuilder builder(loop);
  return llvm::map_to_vector(values, [&](Value value) -> Value {
    if (loop.isDefinedOutsideOfLoop(value))
      return value;
    return IndexMath(builder, loop.getLoc())
        .constant(*getConstantIntValue(value));
  });
}

Accumulators::Register::Register(const FieldInfo *field, Total updates)
    : field(field), updates(std::move(updates)),
      form(TotalForm::create(TotalUpdates(this->updates))) {}

FailureOr<Accumulators> Accumulators::collect(ParallelForOp loop,
                                              ModuleLowering &lowering) {
  Accumulators result(lowering);
  SmallVector<AtomicOp> inBuffers;
  SmallVector<Operation *> inRegisters;
  WalkResult walked = loop.walk([&](Operation *op) {
    auto atomic = dyn_cast<AtomicOp>(op);
    if (isKeptInRegister(op)) {
      inRegisters.push_back(op);
      return WalkResult::advance();
    }
    if (!atomic)
      return WalkResult::advance();
    ReductionAttr reduction = atomic.getReductionAttr();
    if (reduction && reduction.getForm() == ReductionForm::Buffer) {
      inBuffers.push_back(atomic);
      return WalkResult::advance();
    }
    op->emitOpError("reaches the lowering of loops; expects tai-lower-layout "
                    "to run before");
    return WalkResult::interrupt();
  });
  if (walked.wasInterrupted() || failed(checkOrderIsFixed(loop)))
    return failure();
  for (Total &total : groupTotals(inRegisters)) {
    auto atomic = dyn_cast<AtomicOp>(total.front());
    if (!atomic) {
      Value address = cast<LLVM::AtomicRMWOp>(total.front()).getPtr();
      result.registers.push_back(Register(nullptr, std::move(total)));
      result.registers.back().address = address;
      continue;
    }
    FailureOr<const FieldInfo *> field =
        lowering.fields.lookup(atomic, atomic.getFieldAttr());
    if (failed(field))
      return failure();
    result.registers.push_back(Register(*field, std::move(total)));
    result.registers.back().indices = getOutside(atomic.getIndices(), loop);
    result.registers.back().components =
        getOutside(atomic.getComponents(), loop);
  }

  FailureOr<SmallVector<AccumulationGroup>> groups =
      groupAccumulations(loop, inBuffers, lowering.fields);
  if (failed(groups))
    return failure();
  for (AccumulationGroup &group : *groups) {
    FailureOr<BufferSums> buffer = BufferSums::create(std::move(group), loop);
    if (failed(buffer))
      return failure();
    result.buffers.push_back(std::move(*buffer));
  }
  return result;
}

//===----------------------------------------------------------------------===//
// In the kernel
//===----------------------------------------------------------------------===//

Value Accumulators::limitParts(OpBuilder &builder, Location loc, Value parts,
                               Value count, double iterationsPerCount) {
  double elements = 0, updates = 0;
  for (const BufferSums &buffer : buffers) {
    elements += buffer.getNumElements();
    updates += buffer.getUpdatesPerIteration();
  }
  if (buffers.empty())
    return parts;
  // An additional partition costs time for each element of its buffer, and
  // saves time for each of its updates.
  double partsPerCount =
      updates * iterationsPerCount * kElementsPerUpdate / elements;
  RuntimeCalls &runtime = lowering->runtime;
  Value limit;
  if (partsPerCount >= 1)
    limit = arith::MulIOp::create(
        builder, loc, count,
        runtime.i64(builder, loc, int64_t(std::min(partsPerCount, 1e6))));
  else
    limit = arith::DivUIOp::create(
        builder, loc, count,
        runtime.i64(builder, loc, int64_t(1 / partsPerCount)));
  limit =
      arith::MaxSIOp::create(builder, loc, limit, runtime.i64(builder, loc, 1));
  return arith::MinSIOp::create(builder, loc, parts, limit);
}

/// Returns the first slot of the partial sum for register sum `i`.
int64_t Accumulators::getPartialSlot(size_t i) const {
  int64_t slot = 0;
  for (const Register &sum : ArrayRef(registers).take_front(i))
    slot += sum.form->getNumSlots();
  return slot;
}

int64_t Accumulators::getPartialBytes() const {
  return llvm::alignTo(getPartialSlot(registers.size()) * 8, kCacheLine);
}

void Accumulators::emitBefore(OpBuilder &builder, Location loc, Value frame,
                              Value parts) {
  RuntimeCalls &runtime = lowering->runtime;
  Type pointer = runtime.getPointerType();
  Value one = runtime.i64(builder, loc, 1);
  Value single =
      arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::eq, parts, one);
  for (Register &sum : registers)
    sum.form->emitBefore(builder, loc);
  if (getPartialSlot(registers.size()) != 0) {
    Value onStack =
        emitStackSlots(builder, loc, getPartialBytes() / sizeof(uint64_t));
    auto choice = scf::IfOp::create(builder, loc, TypeRange{pointer}, single,
                                    /*addThenBlock=*/true,
                                    /*addElseBlock=*/true);
    OpBuilder then = OpBuilder::atBlockBegin(choice.thenBlock());
    scf::YieldOp::create(then, loc, onStack);
    OpBuilder otherwise = OpBuilder::atBlockBegin(choice.elseBlock());
    Value bytes = arith::MulIOp::create(
        otherwise, loc, parts, runtime.i64(otherwise, loc, getPartialBytes()));
    Value memory = runtime.tai_rt_scratch(otherwise, loc, frame, bytes);
    scf::YieldOp::create(otherwise, loc, memory);
    partials = choice.getResult(0);
  }

  for (BufferSums &buffer : buffers)
    buffer.emitBefore(builder, loc, *lowering, frame, parts, single);
}

/// Emits the addition of the sum over all iterations to its element.
void Accumulators::emitTotal(OpBuilder &builder, Location loc,
                             const Register &sum, ValueRange total) {
  Value address = sum.address;
  AliasScopes scopes;
  if (sum.field) {
    const FieldInfo &field = *sum.field;
    SmallVector<Value> zeroBased =
        emitZeroBased(builder, loc, field, sum.indices);
    Value offset =
        emitElementOffset(builder, loc, field, zeroBased, sum.components);
    address = emitPointer(builder, loc, getStorageType(field.scalarType),
                          emitFieldBase(builder, loc, field), offset);
    scopes = lowering->fields.getScopes(field);
  }
  sum.form->emitUpdate(builder, loc, total, address, scopes);
}

void Accumulators::emitAfter(OpBuilder &builder, Location loc, Value frame,
                             Value parts) {
  RuntimeCalls &runtime = lowering->runtime;
  IndexMath math(builder, loc);

  if (getPartialSlot(registers.size()) != 0) {
    SmallVector<Value> initial;
    for (Register &sum : registers)
      llvm::append_range(initial, sum.form->emitNone(builder, loc));
    auto combine = [&](OpBuilder &b, Location, Value part, ValueRange sums) {
      Value bytes =
          arith::MulIOp::create(b, loc, IndexMath(b, loc).toI64(part),
                                runtime.i64(b, loc, getPartialBytes()));
      Value slots = emitPointer(b, loc, b.getI8Type(), partials, bytes);
      SmallVector<Value> next;
      for (auto [i, sum] : llvm::enumerate(registers)) {
        ValueRange own = sums.slice(getPartialSlot(i), sum.form->getNumSlots());
        SmallVector<Value> partial;
        for (auto [k, number] : llvm::enumerate(own))
          partial.push_back(
              emitSlotLoad(b, loc, number.getType(),
                           emitSlot(b, loc, slots, getPartialSlot(i) + k)));
        llvm::append_range(next, sum.form->emitCombined(b, loc, own, partial));
      }
      scf::YieldOp::create(b, loc, next);
    };
    auto total =
        scf::ForOp::create(builder, loc, math.constant(0), math.toIndex(parts),
                           math.constant(1), initial, combine);
    for (auto [i, sum] : llvm::enumerate(registers))
      if (unsigned count = sum.form->getNumSlots())
        emitTotal(builder, loc, sum,
                  total.getResults().slice(getPartialSlot(i), count));
  }

  if (buffers.empty())
    return;
  Value one = runtime.i64(builder, loc, 1);
  Value several =
      arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::ne, parts, one);
  auto branch = scf::IfOp::create(builder, loc, several);
  OpBuilder whereSeveral = branch.getThenBodyBuilder();
  for (BufferSums &buffer : buffers)
    buffer.emitAfter(builder, whereSeveral, loc, *lowering, frame, parts);
}

void Accumulators::emitAfterChunks(OpBuilder &builder, Location loc,
                                   Value chunks) {
  for (Register &sum : registers)
    if (sum.form->getNumSlots() == 0)
      emitTotal(builder, loc, sum,
                sum.form->emitChunksTotal(builder, loc, chunks));
}

//===----------------------------------------------------------------------===//
// Code in the function of the loop
//===----------------------------------------------------------------------===//

void Accumulators::emitEntry(OpBuilder &builder, Location loc, Value part) {
  for (Register &sum : registers)
    sum.form->emitEntry(builder, loc);
  if (getPartialSlot(registers.size()) != 0) {
    RuntimeCalls &runtime = lowering->runtime;
    Value bytes = arith::MulIOp::create(
        builder, loc, part, runtime.i64(builder, loc, getPartialBytes()));
    insidePartials =
        emitPointer(builder, loc, builder.getI8Type(), partials, bytes);
  }
  for (BufferSums &buffer : buffers)
    buffer.emitEntry(builder, loc, part);
}

/// Moves an update out of the branches around it; where a branch is not taken,
/// the update adds a neutral value. LLVM then vectorises the sum; it does not
/// vectorise sums that only some iterations update.
static void moveBehindBranches(Operation *update, OpOperand &updated,
                               AtomicKind kind) {
  while (auto branch = dyn_cast<scf::IfOp>(update->getParentOp())) {
    // tai-split-index-sets will move this branch out of the loop.
    if (branch->hasAttr("tai.interior"))
      return;
    Location loc = branch.getLoc();
    Type type = updated.get().getType();
    SmallVector<Type> types(branch.getResultTypes());
    types.push_back(type);
    OpBuilder builder(branch);
    auto moved = scf::IfOp::create(builder, loc, types, branch.getCondition(),
                                   /*addThenBlock=*/false,
                                   /*addElseBlock=*/false);
    moved->setDiscardableAttrs(branch->getDiscardableAttrDictionary());
    moved.getThenRegion().takeBody(branch.getThenRegion());
    moved.getElseRegion().takeBody(branch.getElseRegion());
    if (moved.getElseRegion().empty()) {
      builder.setInsertionPointToEnd(&moved.getElseRegion().emplaceBlock());
      scf::YieldOp::create(builder, loc);
    }
    for (Region *region : moved.getRegions()) {
      Operation *yield = region->front().getTerminator();
      Value value = updated.get();
      if (!region->isAncestor(update->getParentRegion())) {
        builder.setInsertionPoint(yield);
        // Where the branch is not taken, -0 is added: x + -0 is x, also for x =
        // -0.
        TypedAttr nothing = getIdentity(kind, type);
        if (kind == AtomicKind::Add && isa<FloatType>(type))
          nothing = builder.getFloatAttr(type, -0.0);
        value = arith::ConstantOp::create(builder, loc, nothing);
      }
      yield->insertOperands(yield->getNumOperands(), value);
    }
    branch->replaceAllUsesWith(
        moved.getResults().take_front(branch.getNumResults()));
    branch.erase();
    update->moveAfter(moved);
    updated.assign(moved.getResults().back());
  }
}

void Accumulators::rewriteUpdates() {
  for (Register &sum : registers)
    for (auto [number, update] : llvm::enumerate(sum.updates)) {
      auto atomic = dyn_cast<AtomicOp>(update);
      OpOperand &term = atomic
                            ? atomic.getValueMutable()
                            : cast<LLVM::AtomicRMWOp>(update).getValMutable();
      AtomicKind kind = atomic ? atomic.getKind() : AtomicKind::Add;
      moveBehindBranches(update, term, kind);
      OpBuilder builder(update);
      sum.form->emitTerm(builder, update->getLoc(), number, kind, term.get(),
                         innermost);
      update->erase();
    }
  for (BufferSums &buffer : buffers)
    buffer.rewriteUpdates(*lowering);
}

bool Accumulators::storesTerms() const {
  return llvm::any_of(
      registers, [](const Register &sum) { return sum.form->storesTerms(); });
}

int64_t Accumulators::getBlockLength() const {
  int64_t length = 0;
  for (const Register &sum : registers)
    if (int64_t block = sum.form->getBlockLength())
      length = length == 0 ? block : std::min(length, block);
  return length;
}

void Accumulators::emitBlockEnd(OpBuilder &builder, Location loc,
                                scf::ForOp loop) {
  innermost.loop = loop;
  for (Register &sum : registers)
    sum.form->emitBlockEnd(builder, loc, loop);
}

void Accumulators::emitExit(OpBuilder &builder, Location loc) {
  for (auto [i, sum] : llvm::enumerate(registers))
    for (auto [k, number] :
         llvm::enumerate(sum.form->emitPartial(builder, loc)))
      emitSlotStore(
          builder, loc, number,
          emitSlot(builder, loc, insidePartials, getPartialSlot(i) + k));
}

void Accumulators::emitChunkStart(OpBuilder &builder, Location loc) {
  for (Register &sum : registers)
    sum.form->emitChunkStart(builder, loc);
}

void Accumulators::emitChunkEnd(OpBuilder &builder, Location loc, Value chunk) {
  for (Register &sum : registers)
    sum.form->emitChunkEnd(builder, loc, chunk);
}

LogicalResult tai::lowerNonAtomic(AtomicOp atomic, FieldTable &fields) {
  FailureOr<const FieldInfo *> field =
      fields.lookup(atomic, atomic.getFieldAttr());
  if (failed(field))
    return failure();
  OpBuilder builder(atomic);
  Location loc = atomic.getLoc();
  SmallVector<Value> zeroBased =
      emitZeroBased(builder, loc, **field, atomic.getIndices());
  Value offset = emitElementOffset(builder, loc, **field, zeroBased,
                                   atomic.getComponents());
  Value address =
      emitPointer(builder, loc, getStorageType((*field)->scalarType),
                  emitFieldBase(builder, loc, **field), offset);
  Value old = emitPlainUpdate(builder, loc, atomic.getKind(), atomic.getValue(),
                              address, fields.getScopes(**field));
  atomic.getOld().replaceAllUsesWith(old);
  atomic.erase();
  return success();
}
