//===- RowBuilder.cpp - Vector code for the rows of a block ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "RowBuilder.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"

using namespace mlir;
using namespace mlir::tai;

RowBuilder::RowBuilder(OpBuilder &builder, const BlockLoop &block,
                       FieldTable &fields, ValueRange indices)
    : builder(builder), block(block), fields(fields),
      loc(ParallelForOp(block.loop).getLoc()), math(builder, loc),
      origin(emitZeroBased(builder, loc, *block.field, indices)) {
  findNeeded();
}

/// Finds the ops that compute the stored values of blocks in the interior.
void RowBuilder::findNeeded() {
  SmallVector<Value> pending;
  for (const auto &[op, access] : block.accesses) {
    if (!isa<LoadOp>(op))
      written.insert(access.field->scope);
    if (auto store = dyn_cast<StoreOp>(op))
      pending.push_back(store.getValue());
    else if (auto atomic = dyn_cast<AtomicOp>(op))
      pending.push_back(atomic.getValue());
  }
  while (!pending.empty()) {
    Value value = pending.pop_back_val();
    Operation *op = value.getDefiningOp();
    if (!op || block.answers.contains(value) || !needed.insert(op).second)
      continue;
    if (auto branch = dyn_cast<scf::IfOp>(op)) {
      Region &taken = block.answers.lookup(branch.getCondition())
                          ? branch.getThenRegion()
                          : branch.getElseRegion();
      llvm::append_range(pending, taken.front().getTerminator()->getOperands());
      continue;
    }
    const auto *access = block.accesses.find(op);
    if (access == block.accesses.end() || !access->second.rowIndex)
      llvm::append_range(pending, op->getOperands());
  }
}

//===----------------------------------------------------------------------===//
// Addresses
//===----------------------------------------------------------------------===//

const IndexDigit &RowBuilder::getRowDigit(const BlockAccess &access) const {
  return *findInnermost(*access.field, *access.rowIndex);
}

int64_t RowBuilder::getStep(const BlockAccess &access) const {
  return getRowDigit(access).stride / access.field->scalarSize;
}

bool RowBuilder::isWhole(const BlockAccess &access) const {
  return getRowDigit(access).extent ==
         access.field->layout.shape[*access.rowIndex];
}

int64_t RowBuilder::getRowShift(const BlockAccess &access) const {
  return access.indices[*access.rowIndex].shift +
         block.field->layout.offset[block.rowDimension] -
         access.field->layout.offset[*access.rowIndex];
}

int64_t RowBuilder::getFirst(const BlockAccess &access) const {
  return access.field->cellOffset / access.field->scalarSize + access.component;
}

/// Emits a digit of the address of a row. A digit that counts the elements of a
/// block is constant if the position of the row in its block is.
Value RowBuilder::emitIndex(const BlockAccess &access, const IndexDigit &digit,
                            int64_t blocks) {
  const FieldInfo &field = *access.field;
  unsigned position = digit.dimension;
  const IndexForm &form = access.indices[position];
  SmallVector<Value> zeroBased(field.layout.shape.size());
  Value &index = zeroBased[position];
  if (!form.isShift()) {
    index = math.sub(form.invariant, field.layout.offset[position]);
    return emitDigit(builder, loc, field, digit, zeroBased);
  }
  unsigned d = form.variable;
  int64_t shift = form.shift + block.field->layout.offset[d] -
                  field.layout.offset[position];
  int64_t extent = block.extents[d];
  if (d == block.rowDimension) {
    if (isWhole(access)) {
      index = math.add(origin[d], math.constant(shift));
      return emitDigit(builder, loc, field, digit, zeroBased);
    }
    if (&digit == &getRowDigit(access))
      return math.constant(0);
    index = math.add(origin[d], math.constant(blocks * extent));
    return emitDigit(builder, loc, field, digit, zeroBased);
  }
  std::optional<int64_t> distance = getConstantIntValue(at[d]);
  if (!distance) {
    index =
        math.add(math.add(origin[d], cast<Value>(at[d])), math.constant(shift));
    return emitDigit(builder, loc, field, digit, zeroBased);
  }
  int64_t place = *distance + shift;
  int64_t carry = llvm::divideFloorSigned(place, extent);
  bool sameBlocks =
      llvm::any_of(field.storage.digits, [&](const IndexDigit &other) {
        return other.dimension == position && other.divisor == 1 &&
               other.extent == extent;
      });
  if (!sameBlocks || digit.isWhole) {
    index = math.add(origin[d], math.constant(place));
    return emitDigit(builder, loc, field, digit, zeroBased);
  }
  if (digit.divisor == 1)
    return math.constant(place - carry * extent);
  index = math.add(origin[d], math.constant(carry * extent));
  return emitDigit(builder, loc, field, digit, zeroBased);
}

Value RowBuilder::emitRowPointer(const BlockAccess &access, int64_t blocks) {
  const FieldInfo &field = *access.field;
  // Constants are added last, so that the addresses of several blocks share the
  // other terms.
  Value offset = math.constant(0);
  int64_t known = 0;
  for (const IndexDigit &digit : field.storage.digits) {
    if (digit.extent == 1)
      continue;
    Value value = emitIndex(access, digit, blocks);
    int64_t stride = digit.stride / field.scalarSize;
    if (std::optional<int64_t> constant = getConstantIntValue(value))
      known += *constant * stride;
    else
      offset = math.add(offset, math.mul(value, stride));
  }
  offset = math.add(offset, math.constant(known));
  // The address is where the first cell of the row of iterations begins; the
  // place of the field within a cell comes later.
  return emitPointer(builder, loc, field.scalarType,
                     emitTreeAddress(builder, loc, field,
                                     field.storage.offset - field.cellOffset),
                     offset);
}

//===----------------------------------------------------------------------===//
// Rows
//===----------------------------------------------------------------------===//

static Value shuffle(OpBuilder &builder, Location loc, Value a, Value b,
                     ArrayRef<int32_t> mask) {
  return LLVM::ShuffleVectorOp::create(builder, loc, a, b, mask);
}

/// Returns `count` integers: first, first + step, and so on.
static SmallVector<int32_t> getSteps(int64_t first, int64_t step,
                                     int64_t count) {
  SmallVector<int32_t> mask;
  for (int64_t i = 0; i < count; ++i)
    mask.push_back(static_cast<int32_t>(first + i * step));
  return mask;
}

RowBuilder::RowKey RowBuilder::getKey(const BlockAccess &access,
                                      int64_t blocks) const {
  RowKey key{access.field->scope, {}};
  for (const IndexForm &form : access.indices) {
    if (!form.isShift()) {
      key.second.push_back({form.invariant.getAsOpaquePointer(), 0});
      continue;
    }
    // A distance that is not constant counts as 0, since it is equal in all
    // rows that are compared.
    int64_t distance = 0;
    if (form.variable == block.rowDimension)
      distance = isWhole(access) ? form.shift : blocks;
    else
      distance =
          form.shift + getConstantIntValue(at[form.variable]).value_or(0);
    auto variable = static_cast<uintptr_t>(form.variable) + 1;
    key.second.push_back({reinterpret_cast<const void *>(variable), distance});
  }
  return key;
}

Value RowBuilder::loadPart(const BlockAccess &access, int64_t blocks) {
  const FieldInfo &field = *access.field;
  int64_t step = getStep(access), length = block.rowLength();
  RowKey key = getKey(access, blocks);
  auto known = rows.find(key);
  Value load = known == rows.end() ? Value() : known->second;
  if (!load) {
    auto type = VectorType::get({length * step}, field.scalarType);
    auto op =
        LLVM::LoadOp::create(builder, loc, type, emitRowPointer(access, blocks),
                             /*alignment=*/field.scalarSize);
    AliasScopes scopes = fields.getScopes(field);
    op.setAliasScopesAttr(scopes.own);
    op.setNoaliasScopesAttr(scopes.others);
    load = op;
    if (!written.contains(field.scope))
      rows[key] = load;
  }
  if (step == 1)
    return load;
  return shuffle(builder, loc, load, load,
                 getSteps(getFirst(access), step, length));
}

Value RowBuilder::loadRow(const BlockAccess &access) {
  if (isWhole(access))
    return loadPart(access, 0);
  int64_t length = block.rowLength(), shift = getRowShift(access);
  int64_t blocks = llvm::divideFloorSigned(shift, length);
  Value near = loadPart(access, blocks);
  if (shift == blocks * length)
    return near;
  return shuffle(builder, loc, near, loadPart(access, blocks + 1),
                 getSteps(shift - blocks * length, 1, length));
}

void RowBuilder::storeRow(const BlockAccess &access, Value vector) {
  const FieldInfo &field = *access.field;
  int64_t length = block.rowLength(), step = getStep(access);
  Value pointer = emitRowPointer(
      access, isWhole(access)
                  ? 0
                  : llvm::divideFloorSigned(getRowShift(access), length));
  AliasScopes scopes = fields.getScopes(field);
  if (step == 1) {
    auto store = LLVM::StoreOp::create(builder, loc, vector, pointer,
                                       /*alignment=*/field.scalarSize);
    store.setAliasScopesAttr(scopes.own);
    store.setNoaliasScopesAttr(scopes.others);
    return;
  }
  // Bytes between the elements of a row belong to other fields and may be
  // written concurrently.
  int64_t first = getFirst(access);
  SmallVector<int32_t> spread(length * step, -1);
  SmallVector<bool> mask(length * step, false);
  for (int64_t i = 0; i < length; ++i) {
    spread[i * step + first] = static_cast<int32_t>(i);
    mask[i * step + first] = true;
  }
  auto maskType = VectorType::get({length * step}, builder.getI1Type());
  Value chosen = arith::ConstantOp::create(
      builder, loc, DenseElementsAttr::get(maskType, mask));
  LLVM::MaskedStoreOp::create(
      builder, loc, shuffle(builder, loc, vector, vector, spread), pointer,
      chosen, builder.getI32IntegerAttr(field.scalarSize));
}

//===----------------------------------------------------------------------===//
// Values
//===----------------------------------------------------------------------===//

Value RowBuilder::broadcast(Value scalar) {
  Type type = scalar.getType();
  if (type.isIndex()) {
    Value extended = broadcast(math.toI64(scalar));
    return arith::IndexCastOp::create(builder, loc, vectorOf(type), extended);
  }
  VectorType vector = vectorOf(type);
  Attribute constant;
  if (matchPattern(scalar, m_Constant(&constant)))
    return arith::ConstantOp::create(builder, loc,
                                     DenseElementsAttr::get(vector, constant));
  Value poison = LLVM::PoisonOp::create(builder, loc, vector);
  Value zero =
      LLVM::ConstantOp::create(builder, loc, builder.getI32IntegerAttr(0));
  Value one = LLVM::InsertElementOp::create(builder, loc, poison, scalar, zero);
  return shuffle(builder, loc, one, poison,
                 SmallVector<int32_t>(block.rowLength(), 0));
}

Value RowBuilder::toVector(Value value) {
  if (isa<VectorType>(value.getType()))
    return value;
  Value &vector = vectors[value];
  if (!vector)
    vector = broadcast(value);
  return vector;
}

void RowBuilder::emitOp(Operation *op) {
  bool isUniform = llvm::none_of(op->getOperands(), [&](Value operand) {
    return isa<VectorType>(values.lookupOrDefault(operand).getType());
  });
  if (isUniform) {
    builder.clone(*op, values);
    return;
  }
  IRMapping operands;
  for (Value operand : op->getOperands())
    operands.map(operand, toVector(values.lookupOrDefault(operand)));
  Operation *copy = builder.clone(*op, operands);
  for (auto [from, to] : llvm::zip(op->getResults(), copy->getResults())) {
    to.setType(vectorOf(from.getType()));
    values.map(from, to);
  }
}

void RowBuilder::emitAccess(const BlockAccess &access) {
  if (auto load = dyn_cast<LoadOp>(access.op)) {
    if (!needed.contains(load))
      return;
    // An access without a row index reads the same element in all iterations: a
    // scalar.
    if (!access.rowIndex)
      builder.clone(*load, values);
    else
      values.map(load.getResult(), loadRow(access));
    return;
  }
  if (auto store = dyn_cast<StoreOp>(access.op)) {
    storeRow(access, toVector(values.lookupOrDefault(store.getValue())));
    return;
  }
  auto atomic = cast<AtomicOp>(access.op);
  Value value = toVector(values.lookupOrDefault(atomic.getValue()));
  storeRow(access, emitCombination(builder, loc, atomic.getKind(),
                                   loadRow(access), value));
}

void RowBuilder::emitBody(Block &body) {
  for (Operation &op : body.without_terminator()) {
    if (const auto *access = block.accesses.find(&op);
        access != block.accesses.end()) {
      emitAccess(access->second);
      continue;
    }
    if (auto branch = dyn_cast<scf::IfOp>(op)) {
      Region &taken = block.answers.lookup(branch.getCondition())
                          ? branch.getThenRegion()
                          : branch.getElseRegion();
      if (taken.empty())
        continue;
      emitBody(taken.front());
      for (auto [result, value] :
           llvm::zip(branch.getResults(),
                     taken.front().getTerminator()->getOperands()))
        values.map(result, values.lookupOrDefault(value));
      continue;
    }
    if (needed.contains(&op))
      emitOp(&op);
  }
}

void RowBuilder::emitRow(ArrayRef<OpFoldResult> distances) {
  at = llvm::to_vector(distances);
  values.clear();
  vectors.clear();
  ParallelForOp loop = block.loop;
  for (auto [d, iv] : llvm::enumerate(loop.getInductionVars())) {
    Value index =
        math.add(origin[d], math.constant(block.field->layout.offset[d]));
    if (d == block.rowDimension) {
      SmallVector<int64_t> steps =
          llvm::to_vector(llvm::seq<int64_t>(block.rowLength()));
      auto type = vectorOf(builder.getIndexType());
      Value step = arith::ConstantOp::create(
          builder, loc, DenseElementsAttr::get(type, ArrayRef(steps)));
      index = arith::AddIOp::create(builder, loc, broadcast(index), step);
    } else if (std::optional<int64_t> constant = getConstantIntValue(at[d])) {
      index = math.add(index, math.constant(*constant));
    } else {
      index = math.add(index, cast<Value>(at[d]));
    }
    values.map(iv, index);
  }
  for (auto [value, answer] : block.answers)
    values.map(value,
               arith::ConstantIntOp::create(builder, loc, int64_t(answer), 1));
  emitBody(loop.getBody().front());
}
