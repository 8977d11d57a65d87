//===- Accumulators.cpp - Partial sums of a parallel loop -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Accumulators.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/ABI/SumModes.h"
#include "tai/Analysis/Cost.h"
#include "tai/Transforms/Utils/IndexMath.h"
#include "tai/Transforms/Utils/SumOrder.h"

using namespace mlir;
using namespace mlir::tai;

/// Partial sums of two partitions do not share a cache line.
constexpr int64_t kCacheLine = 64;

/// The given indices as values before the loop; constants inside are copied.
static SmallVector<Value> getOutside(ValueRange values, ParallelForOp loop) {
  OpBuilder builder(loop);
  return llvm::map_to_vector(values, [&](Value value) -> Value {
    if (loop.isDefinedOutsideOfLoop(value))
      return value;
    return IndexMath(builder, loop.getLoc())
        .constant(*getConstantIntValue(value));
  });
}

/// The type of partial sums: f32 for 16-bit floats, since those stop growing at
/// 2048 of their terms; f64 for sums with more digits.
static Type getSumType(Type type, AtomicKind kind, SumDigits digits) {
  if (!isa<FloatType>(type) || kind != AtomicKind::Add)
    return type;
  if (digits != SumDigits::Own)
    return Float64Type::get(type.getContext());
  bool isNarrow = isa<Float16Type, BFloat16Type>(type);
  return isNarrow ? Float32Type::get(type.getContext()) : type;
}

/// A number in a wider type of floats, or as it is.
static Value emitWidened(OpBuilder &builder, Location loc, Value value,
                         Type type) {
  if (value.getType() == type)
    return value;
  return arith::ExtFOp::create(builder, loc, type, value);
}

/// A sum of such partial sums, in the type of the field.
static Value emitNarrowed(OpBuilder &builder, Location loc, Value sum,
                          Type type) {
  if (sum.getType() == type)
    return sum;
  return arith::TruncFOp::create(builder, loc, type, sum);
}

// A sum of n numbers one after another is off by about n roundings; in blocks
// of m it is off by the square root of m n of them, and adding the blocks up
// in f64 costs nothing.
Accumulators::Register::Register(const FieldInfo *field, Total updates)
    : field(field), updates(std::move(updates)),
      reduction(getReduction(this->updates.front())),
      kind(getCombiningKind(this->updates.front())),
      termType(getTermType(this->updates.front())),
      type(getSumType(termType, kind, reduction.getDigits())),
      totalType(isBlocked() ? Float64Type::get(termType.getContext()) : type) {
  if (reduction.getOrder() == ReductionOrder::Common)
    ordered.emplace(kind, termType);
}

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
    SmallVector<bool> fixed = llvm::map_to_vector(
        group.fixed, [](Value index) { return bool(index); });
    std::optional<FieldSlice> slice = FieldTable::getSlice(*group.field, fixed);
    if (!slice)
      return group.atomics.front().emitOpError(
          "updates a part of a field that is not evenly spaced in memory");
    Buffer buffer;
    buffer.digits = group.atomics.front().getReductionAttr().getDigits();
    for (AtomicOp atomic : group.atomics)
      buffer.updatesPerIteration += estimateRuns(atomic, loop);
    buffer.group = std::move(group);
    buffer.slice = std::move(*slice);
    result.buffers.push_back(std::move(buffer));
  }
  return result;
}

//===----------------------------------------------------------------------===//
// In the kernel
//===----------------------------------------------------------------------===//

Value Accumulators::limitParts(OpBuilder &builder, Location loc, Value parts,
                               Value count, double iterationsPerCount) {
  double elements = 0, updates = 0;
  for (const Buffer &buffer : buffers) {
    elements += buffer.numElements();
    updates += buffer.updatesPerIteration;
  }
  if (buffers.empty())
    return parts;
  // Each partition costs its elements, and saves the updates.
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

/// The slot at which register `i` begins: pairs take two slots.
int64_t Accumulators::getPartialSlot(size_t i) const {
  int64_t slot = 0;
  for (const Register &sum : ArrayRef(registers).take_front(i))
    slot += sum.ordered ? 0 : sum.isPair() ? 2 : 1;
  return slot;
}

int64_t Accumulators::getPartialBytes() const {
  return llvm::alignTo(getPartialSlot(registers.size()) * 8, kCacheLine);
}

/// The address of the first element of the updated part.
Value Accumulators::emitTarget(OpBuilder &builder, Location loc,
                               const Buffer &buffer) {
  const FieldInfo &field = *buffer.group.field;
  IndexMath math(builder, loc);
  Value base = emitFieldBase(builder, loc, field);
  Value offset = math.constant(0);
  for (const IndexDigit &digit : field.storage.digits) {
    if (!buffer.slice.fixed[digit.dimension] || digit.extent == 1)
      continue;
    // The indices of free dimensions are not looked at.
    SmallVector<Value> zeroBased(field.layout.shape.size());
    zeroBased[digit.dimension] = math.sub(buffer.group.fixed[digit.dimension],
                                          field.layout.offset[digit.dimension]);
    Value value = emitDigit(builder, loc, field, digit, zeroBased);
    offset = math.add(offset, math.mul(value, digit.stride / field.scalarSize));
  }
  return emitPointer(builder, loc, getStorageType(field.scalarType), base,
                     offset);
}

void Accumulators::emitBefore(OpBuilder &builder, Location loc, Value frame,
                              Value parts) {
  RuntimeCalls &runtime = lowering->runtime;
  Type pointer = runtime.getPointerType();
  Value one = runtime.i64(builder, loc, 1);
  Value single =
      arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::eq, parts, one);
  for (Register &sum : registers)
    if (sum.ordered)
      sum.ordered->emitGroups(builder, loc);
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

  for (Buffer &buffer : buffers) {
    buffer.target = emitTarget(builder, loc, buffer);
    int64_t bytes = buffer.numElements() * buffer.scalarSize();
    buffer.partStride =
        runtime.i64(builder, loc, llvm::alignTo(bytes, kCacheLine));
    if (buffer.isApart()) {
      buffer.memory = runtime.tai_rt_private(
          builder, loc, frame, runtime.i64(builder, loc, bytes), parts);
      continue;
    }
    // One partition has the field to itself.
    auto choice = scf::IfOp::create(builder, loc, TypeRange{pointer}, single,
                                    /*addThenBlock=*/true,
                                    /*addElseBlock=*/true);
    OpBuilder then = OpBuilder::atBlockBegin(choice.thenBlock());
    scf::YieldOp::create(then, loc, buffer.target);
    OpBuilder otherwise = OpBuilder::atBlockBegin(choice.elseBlock());
    Value memory = runtime.tai_rt_private(
        otherwise, loc, frame, runtime.i64(otherwise, loc, bytes), parts);
    scf::YieldOp::create(otherwise, loc, memory);
    buffer.memory = choice.getResult(0);
    if (!buffer.isContiguous())
      buffer.cellStride = arith::SelectOp::create(
          builder, loc, single,
          runtime.i64(builder, loc, buffer.slice.cellStride),
          runtime.i64(builder, loc, buffer.compactStride()));
  }
}

/// a (kind) b, in an op to which no float options are added: its order is part
/// of the result in every mode.
static Value emitInOrder(OpBuilder &builder, Location loc, AtomicKind kind,
                         Value a, Value b) {
  if (isa<FloatType>(a.getType()))
    switch (kind) {
    case AtomicKind::Add:
      return LLVM::FAddOp::create(builder, loc, a, b);
    case AtomicKind::Mul:
      return LLVM::FMulOp::create(builder, loc, a, b);
    case AtomicKind::Min:
      return LLVM::MinimumOp::create(builder, loc, a, b);
    case AtomicKind::Max:
      return LLVM::MaximumOp::create(builder, loc, a, b);
    default:
      break;
    }
  return emitCombination(builder, loc, kind, a, b);
}

/// Adds a compensated sum to its element, and rounds once.
static void emitCompensatedUpdate(OpBuilder &builder, Location loc, Pair sum,
                                  Type type, Value address,
                                  AliasScopes scopes) {
  Value old = emitLoad(builder, loc, type, address, scopes);
  Value next;
  if (sum.rest) {
    next = emitRounded(builder, loc, emitPairSum(builder, loc, sum, old));
  } else {
    Value wide = emitWidened(builder, loc, old, sum.sum.getType());
    next = emitNarrowed(
        builder, loc, LLVM::FAddOp::create(builder, loc, wide, sum.sum), type);
  }
  emitStore(builder, loc, next, address, scopes);
}

/// Adds the sum of all iterations to its element.
void Accumulators::emitTotal(OpBuilder &builder, Location loc,
                             const Register &sum, Pair total) {
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
  if (sum.reduction.getDigits() != SumDigits::Own)
    return emitCompensatedUpdate(builder, loc, total, sum.termType, address,
                                 scopes);
  Value narrowed = emitNarrowed(builder, loc, total.sum, sum.termType);
  emitPlainUpdate(builder, loc, sum.kind, narrowed, address, scopes);
}

void Accumulators::emitAfter(OpBuilder &builder, Location loc, Value frame,
                             Value parts) {
  RuntimeCalls &runtime = lowering->runtime;
  IndexMath math(builder, loc);

  if (getPartialSlot(registers.size()) != 0) {
    SmallVector<Value> initial;
    for (Register &sum : registers)
      if (!sum.ordered)
        initial.append(sum.isPair() ? 2 : 1,
                       arith::ConstantOp::create(
                           builder, loc, getIdentity(sum.kind, sum.totalType)));
    auto combine = [&](OpBuilder &b, Location, Value part, ValueRange sums) {
      Value bytes =
          arith::MulIOp::create(b, loc, IndexMath(b, loc).toI64(part),
                                runtime.i64(b, loc, getPartialBytes()));
      Value slots = emitPointer(b, loc, b.getI8Type(), partials, bytes);
      SmallVector<Value> next;
      for (auto [i, sum] : llvm::enumerate(registers)) {
        if (sum.ordered)
          continue;
        int64_t at = getPartialSlot(i);
        auto load = [&](int64_t slot) {
          return emitSlotLoad(b, loc, sums[at].getType(),
                              emitSlot(b, loc, slots, slot));
        };
        Value partial = load(at);
        if (!sum.isPair()) {
          next.push_back(emitInOrder(b, loc, sum.kind, sums[at], partial));
          continue;
        }
        Pair pair = emitPairSum(b, loc, {sums[at], sums[at + 1]}, partial);
        next.push_back(pair.sum);
        next.push_back(LLVM::FAddOp::create(b, loc, pair.rest, load(at + 1)));
      }
      scf::YieldOp::create(b, loc, next);
    };
    auto total =
        scf::ForOp::create(builder, loc, math.constant(0), math.toIndex(parts),
                           math.constant(1), initial, combine);
    for (auto [i, sum] : llvm::enumerate(registers)) {
      if (sum.ordered)
        continue;
      int64_t at = getPartialSlot(i);
      emitTotal(builder, loc, sum,
                {total.getResult(at),
                 sum.isPair() ? total.getResult(at + 1) : Value()});
    }
  }

  if (buffers.empty())
    return;
  Value one = runtime.i64(builder, loc, 1);
  Value several =
      arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::ne, parts, one);
  auto branch = scf::IfOp::create(builder, loc, several);
  OpBuilder whereSeveral = branch.getThenBodyBuilder();
  for (Buffer &buffer : buffers) {
    const FieldInfo &field = *buffer.group.field;
    OpBuilder &inside = buffer.isApart() ? builder : whereSeveral;
    Value kind = runtime.i32(inside, loc,
                             buffer.isPair()                  ? kSumsPairs
                             : field.scalarType.isF16()       ? kSumsF16
                             : field.scalarType.isBF16()      ? kSumsBF16
                             : buffer.isApart()               ? kSumsWide
                             : field.scalarType.isF64()       ? kSumsF64
                             : field.scalarType.isInteger(32) ? kSumsI32
                             : field.scalarType.isInteger(64) ? kSumsI64
                                                              : kSumsF32);
    if (buffer.isContiguous()) {
      Value count = runtime.i64(inside, loc, buffer.numElements());
      runtime.tai_rt_combine(inside, loc, frame, buffer.target, buffer.memory,
                             count, parts, kind);
      continue;
    }
    runtime.tai_rt_combine_strided(
        inside, loc, frame, buffer.target, buffer.memory,
        runtime.i64(inside, loc, buffer.slice.numCells),
        runtime.i64(inside, loc, field.numComponents),
        runtime.i64(inside, loc, buffer.slice.cellStride), parts, kind);
  }
}

void Accumulators::emitAfterChunks(OpBuilder &builder, Location loc,
                                   Value chunks) {
  for (Register &sum : registers)
    if (sum.ordered)
      emitTotal(builder, loc, sum,
                {sum.ordered->emitTotal(builder, loc, chunks), Value()});
}

//===----------------------------------------------------------------------===//
// In the function of the loop
//===----------------------------------------------------------------------===//

void Accumulators::emitEntry(OpBuilder &builder, Location loc, Value part) {
  RuntimeCalls &runtime = lowering->runtime;
  for (Register &sum : registers) {
    if (sum.ordered) {
      sum.ordered->emitLanes(builder, loc);
      continue;
    }
    sum.slot = emitStackSlots(builder, loc, 1);
    Value identity = arith::ConstantOp::create(builder, loc,
                                               getIdentity(sum.kind, sum.type));
    emitSlotStore(builder, loc, identity, sum.slot);
    if (sum.isPair()) {
      sum.rest = emitStackSlots(builder, loc, 1);
      emitSlotStore(builder, loc, identity, sum.rest);
      if (sum.storesTerms())
        sum.lanes.emplace(builder, loc, sum.updates.size(),
                          sum.reduction.getBlock());
    }
    if (!sum.isBlocked())
      continue;
    sum.total = emitStackSlots(builder, loc, 1);
    Value zero = arith::ConstantOp::create(
        builder, loc, getIdentity(sum.kind, sum.totalType));
    emitSlotStore(builder, loc, zero, sum.total);
  }
  if (getPartialSlot(registers.size()) != 0) {
    Value bytes = arith::MulIOp::create(
        builder, loc, part, runtime.i64(builder, loc, getPartialBytes()));
    insidePartials =
        emitPointer(builder, loc, builder.getI8Type(), partials, bytes);
  }
  for (Buffer &buffer : buffers) {
    Value bytes = arith::MulIOp::create(builder, loc, part, buffer.partStride);
    buffer.base =
        emitPointer(builder, loc, builder.getI8Type(), buffer.memory, bytes);
  }
}

/// Moves an update behind the branches that it stands in; where it would not
/// run it adds a neutral value. LLVM vectorises the sum then, which it does not
/// do for one that only some iterations change.
static void moveBehindBranches(Operation *update, OpOperand &updated,
                               AtomicKind kind) {
  while (auto branch = dyn_cast<scf::IfOp>(update->getParentOp())) {
    // tai-split-index-sets takes this branch out of the loop.
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
        // x + -0 is x, also for x = -0.
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
  auto reassociable = arith::FastMathFlagsAttr::get(
      lowering->module.getContext(),
      arith::FastMathFlags::reassoc | arith::FastMathFlags::contract);
  auto rewrite = [&](Register &sum, size_t i, Operation *update,
                     OpOperand &value, AtomicKind kind) {
    moveBehindBranches(update, value, kind);
    OpBuilder builder(update);
    Location loc = update->getLoc();
    if (sum.ordered) {
      Value lane =
          IndexMath(builder, loc).sub(innermost.getInductionVar(), laneBase);
      sum.ordered->emitTerm(builder, loc, kind, value.get(), lane);
      update->erase();
      return;
    }
    Value old = emitSlotLoad(builder, loc, sum.type, sum.slot);
    Value term = value.get();
    if (term.getType() != sum.type)
      term = arith::ExtFOp::create(builder, loc, sum.type, term);
    if (sum.isPair()) {
      if (kind == AtomicKind::Sub)
        term = LLVM::FNegOp::create(builder, loc, term);
      if (sum.lanes) {
        sum.lanes->emitTerm(builder, loc, i, innermost, term);
        update->erase();
        return;
      }
      Value rest = emitSlotLoad(builder, loc, sum.type, sum.rest);
      Pair pair = emitPairSum(builder, loc, {old, rest}, term);
      emitSlotStore(builder, loc, pair.sum, sum.slot);
      emitSlotStore(builder, loc, pair.rest, sum.rest);
      update->erase();
      return;
    }
    Value next = emitCombination(builder, loc, kind, old, term);
    // The order of a sum over iterations is ours to choose; LLVM needs to
    // know to vectorise it.
    if (sum.reduction.getOrder() == ReductionOrder::Any &&
        isa<arith::AddFOp, arith::SubFOp>(next.getDefiningOp()))
      next.getDefiningOp()->setAttr("fastmath", reassociable);
    emitSlotStore(builder, loc, next, sum.slot);
    update->erase();
  };
  for (Register &sum : registers)
    for (auto [i, update] : llvm::enumerate(sum.updates)) {
      if (auto atomic = dyn_cast<AtomicOp>(update))
        rewrite(sum, i, update, atomic.getValueMutable(), atomic.getKind());
      else
        rewrite(sum, i, update, cast<LLVM::AtomicRMWOp>(update).getValMutable(),
                AtomicKind::Add);
    }
  for (Buffer &buffer : buffers) {
    const FieldInfo &field = *buffer.group.field;
    // A buffer stands for its field: accesses that do not reach the one do not
    // reach the other.
    AliasScopes scopes = lowering->fields.getScopes(field);
    for (AtomicOp atomic : buffer.group.atomics) {
      OpBuilder builder(atomic);
      Location loc = atomic.getLoc();
      IndexMath math(builder, loc);
      SmallVector<Value> zeroBased =
          emitZeroBased(builder, loc, field, atomic.getIndices());
      Value cell = math.constant(0);
      for (auto [digit, cells] :
           llvm::zip(field.storage.digits, buffer.slice.digitCells))
        if (cells != 0)
          cell = math.add(
              cell, math.mul(emitDigit(builder, loc, field, digit, zeroBased),
                             cells));
      Type scalar = buffer.isApart() ? Float64Type::get(builder.getContext())
                                     : field.scalarType;
      Type storage = getStorageType(scalar);
      Value address = buffer.base;
      if (buffer.isApart() || buffer.isContiguous()) {
        cell = math.mul(cell, field.numComponents);
      } else {
        Value bytes = math.mul(cell, math.toIndex(buffer.cellStride));
        address =
            emitPointer(builder, loc, builder.getI8Type(), address, bytes);
        cell = math.constant(0);
      }
      if (!atomic.getComponents().empty())
        cell = math.add(cell, emitComponent(builder, loc, field.elementShape,
                                            atomic.getComponents()));
      if (buffer.isPair()) {
        // Errors follow all sums, so that neighbours are neighbours in memory.
        address = emitPointer(builder, loc, storage, address, cell);
        Value restAt = emitPointer(builder, loc, storage, address,
                                   math.constant(buffer.numElements()));
        Value term = atomic.getValue();
        if (atomic.getKind() == AtomicKind::Sub)
          term = LLVM::FNegOp::create(builder, loc, term);
        Pair pair = {emitLoad(builder, loc, scalar, address, scopes),
                     emitLoad(builder, loc, scalar, restAt, scopes)};
        pair = emitPairSum(builder, loc, pair, term);
        emitStore(builder, loc, pair.sum, address, scopes);
        emitStore(builder, loc, pair.rest, restAt, scopes);
        atomic.erase();
        continue;
      }
      address = emitPointer(builder, loc, storage, address, cell);
      Value term = emitWidened(builder, loc, atomic.getValue(), scalar);
      emitPlainUpdate(builder, loc, atomic.getKind(), term, address, scopes);
      atomic.erase();
    }
  }
}

bool Accumulators::storesTerms() const {
  return llvm::any_of(registers,
                      [](const Register &sum) { return sum.storesTerms(); });
}

int64_t Accumulators::getBlockLength() const {
  int64_t length = 0;
  for (const Register &sum : registers)
    if (int64_t block = sum.reduction.getBlock())
      length = length == 0 ? block : std::min(length, block);
  return length;
}

void Accumulators::emitBlockEnd(OpBuilder &builder, Location loc,
                                scf::ForOp loop) {
  innermost = loop;
  emitBlockSums(builder, loc);
  for (Register &sum : registers)
    if (sum.lanes)
      sum.lanes->emitBlockEnd(builder, loc, loop);
}

void Accumulators::emitBlockSums(OpBuilder &builder, Location loc) {
  for (Register &sum : registers) {
    if (!sum.isBlocked())
      continue;
    Value block = emitWidened(builder, loc,
                              emitSlotLoad(builder, loc, sum.type, sum.slot),
                              sum.totalType);
    Value total = emitSlotLoad(builder, loc, sum.totalType, sum.total);
    emitSlotStore(builder, loc,
                  arith::AddFOp::create(builder, loc, total, block), sum.total);
    Value zero = arith::ConstantOp::create(builder, loc,
                                           getIdentity(sum.kind, sum.type));
    emitSlotStore(builder, loc, zero, sum.slot);
  }
}

void Accumulators::emitExit(OpBuilder &builder, Location loc) {
  emitBlockSums(builder, loc);
  for (auto [i, sum] : llvm::enumerate(registers)) {
    if (sum.ordered)
      continue;
    if (sum.lanes) {
      Pair total = sum.lanes->emitTotal(builder, loc);
      emitSlotStore(builder, loc, total.sum, sum.slot);
      emitSlotStore(builder, loc, total.rest, sum.rest);
    }
    auto keep = [&, &sum = sum](Value slot, int64_t at) {
      emitSlotStore(builder, loc,
                    emitSlotLoad(builder, loc, sum.totalType, slot),
                    emitSlot(builder, loc, insidePartials, at));
    };
    int64_t at = getPartialSlot(i);
    keep(sum.isBlocked() ? sum.total : sum.slot, at);
    if (sum.isPair())
      keep(sum.rest, at + 1);
  }
}

void Accumulators::emitChunkStart(OpBuilder &builder, Location loc) {
  for (Register &sum : registers)
    if (sum.ordered)
      sum.ordered->emitChunkStart(builder, loc);
}

void Accumulators::emitChunkEnd(OpBuilder &builder, Location loc, Value chunk) {
  for (Register &sum : registers)
    if (sum.ordered)
      sum.ordered->emitChunkEnd(builder, loc, chunk);
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
