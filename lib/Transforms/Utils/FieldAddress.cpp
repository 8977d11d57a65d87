//===- FieldAddress.cpp - Addresses of the elements of fields -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Transforms/Utils/FieldAddress.h"
#include "mlir/IR/Matchers.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "tai/Transforms/Utils/IndexMath.h"

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Addresses
//===----------------------------------------------------------------------===//

SmallVector<Value> tai::emitZeroBased(OpBuilder &builder, Location loc,
                                      const FieldInfo &field,
                                      ValueRange indices) {
  IndexMath math(builder, loc);
  SmallVector<Value> result;
  for (auto [index, offset] : llvm::zip(indices, field.layout.offset))
    result.push_back(math.sub(index, offset));
  return result;
}

Value tai::emitDigit(OpBuilder &builder, Location loc, const FieldInfo &field,
                     const IndexDigit &digit, ValueRange zeroBased) {
  IndexMath math(builder, loc);
  Value value = math.div(zeroBased[digit.dimension], digit.divisor);
  // The digit of a dimension at the outermost level needs no remainder, because
  // an index in range cannot exceed it.
  if (digit.divisor * digit.extent == field.layout.shape[digit.dimension])
    return value;
  return math.rem(value, digit.extent);
}

Value tai::emitComponent(OpBuilder &builder, Location loc,
                         ArrayRef<int64_t> elementShape,
                         ValueRange components) {
  IndexMath math(builder, loc);
  Value position = math.constant(0);
  for (auto [extent, component] : llvm::zip(elementShape, components))
    position = math.add(math.mul(position, extent), component);
  return position;
}

Value tai::emitElementOffset(OpBuilder &builder, Location loc,
                             const FieldInfo &field, ValueRange zeroBased,
                             ValueRange components) {
  IndexMath math(builder, loc);
  Value offset;
  for (const IndexDigit &digit : field.storage.digits) {
    if (digit.extent == 1)
      continue;
    Value value = emitDigit(builder, loc, field, digit, zeroBased);
    Value part = math.mul(value, digit.stride / field.scalarSize);
    offset = offset ? math.add(offset, part) : part;
  }
  if (!components.empty()) {
    Value part = emitComponent(builder, loc, field.elementShape, components);
    offset = offset ? math.add(offset, part) : part;
  }
  return offset ? offset : math.constant(0);
}

Value tai::emitCellNumber(OpBuilder &builder, Location loc,
                          const FieldInfo &field, unsigned level,
                          ValueRange zeroBased) {
  IndexMath math(builder, loc);
  Value cell = math.constant(0);
  for (unsigned l = 0; l <= level; ++l) {
    cell = math.mul(cell, field.layout.path.levels[l].type.getNumCells());
    for (const IndexDigit &digit : field.storage.digits)
      if (digit.level == l && digit.extent != 1)
        cell = math.add(
            cell, math.mul(emitDigit(builder, loc, field, digit, zeroBased),
                           digit.weight));
  }
  return cell;
}

const SparseInfo &tai::getInnermostList(const FieldInfo &field) {
  return *llvm::find_if(
      llvm::reverse(field.sparse),
      [](const SparseInfo &level) { return level.type.isList(); });
}

unsigned tai::getListDimension(const FieldInfo &field) {
  unsigned level = getInnermostList(field).level;
  const IndexDigit *digit =
      llvm::find_if(field.storage.digits, [&](const IndexDigit &digit) {
        return digit.level == level;
      });
  return digit->dimension;
}

Value tai::emitListNumber(OpBuilder &builder, Location loc,
                          const FieldInfo &field, ValueRange indices) {
  // The index zero within the list addresses the list's first cell.
  SmallVector<Value> all(indices);
  unsigned dimension = getListDimension(field);
  IndexMath math(builder, loc);
  all.insert(all.begin() + dimension,
             math.constant(field.layout.offset[dimension]));
  SmallVector<Value> zeroBased = emitZeroBased(builder, loc, field, all);
  const SparseInfo &list = getInnermostList(field);
  return math.div(emitCellNumber(builder, loc, field, list.level, zeroBased),
                  list.capacity);
}

Value tai::emitLength(OpBuilder &builder, Location loc,
                      const SparseInfo &sparse, Value tree, Value list) {
  return emitListLength(builder, loc, sparse.at(tree, Value()), list);
}

Value tai::emitTreeBase(OpBuilder &builder, Location loc,
                        const FieldInfo &field) {
  return TreeBaseOp::create(
      builder, loc, LLVM::LLVMPointerType::get(builder.getContext()),
      FlatSymbolRefAttr::get(TreeOp(field.layout.tree).getSymNameAttr()));
}

Value tai::emitTreeAddress(OpBuilder &builder, Location loc,
                           const FieldInfo &field, uint64_t bytes) {
  auto pointerType = LLVM::LLVMPointerType::get(builder.getContext());
  Value base = emitTreeBase(builder, loc, field);
  if (bytes == 0)
    return base;
  // A constant operand of LLVM::GEPOp has 29 bits; offsets in trees may be
  // larger.
  LLVM::GEPArg offset = static_cast<int32_t>(bytes);
  if (!llvm::isInt<29>(bytes))
    offset =
        IndexMath(builder, loc).toI64(IndexMath(builder, loc).constant(bytes));
  return LLVM::GEPOp::create(
      builder, loc, pointerType, builder.getI8Type(), base, {offset},
      LLVM::GEPNoWrapFlags::inbounds | LLVM::GEPNoWrapFlags::nuw);
}

Value tai::emitFieldBase(OpBuilder &builder, Location loc,
                         const FieldInfo &field) {
  return emitTreeAddress(builder, loc, field, field.storage.offset);
}

//===----------------------------------------------------------------------===//
// Loads and stores
//===----------------------------------------------------------------------===//

unsigned tai::getAlignment(const FieldInfo &field, ValueRange components) {
  // The alignment is at most 16 bytes: trees start at multiples of 64 bytes,
  // and no access needs more than 16.
  uint64_t multiples = 16 | field.storage.offset;
  for (const IndexDigit &digit : field.storage.digits)
    if (digit.extent != 1)
      multiples |= digit.stride;
  uint64_t position = 0;
  for (auto [component, extent] : llvm::zip(components, field.elementShape)) {
    std::optional<int64_t> constant = getConstantIntValue(component);
    if (!constant)
      return 0;
    position = position * extent + *constant;
  }
  multiples |= position * field.scalarSize;
  uint64_t alignment = multiples & -multiples;
  return alignment > uint64_t(field.scalarSize) ? alignment : 0;
}

Type tai::getStorageType(Type scalar) {
  if (scalar.isInteger(1))
    return IntegerType::get(scalar.getContext(), 8);
  if (scalar.isIndex())
    return IntegerType::get(scalar.getContext(), 64);
  return scalar;
}

Value tai::emitPointer(OpBuilder &builder, Location loc, Type storageType,
                       Value base, Value offset) {
  std::optional<int64_t> constant = getConstantIntValue(offset);
  if (constant && *constant == 0)
    return base;
  Value amount = IndexMath(builder, loc).toI64(offset);
  return LLVM::GEPOp::create(
      builder, loc, LLVM::LLVMPointerType::get(builder.getContext()),
      storageType, base, ArrayRef<LLVM::GEPArg>{amount},
      LLVM::GEPNoWrapFlags::inbounds | LLVM::GEPNoWrapFlags::nuw);
}

/// Splits a small constant off `index`, to which the program adds it, and
/// returns the constant.
static int64_t peelConstant(OpBuilder &builder, Location loc, Value &index) {
  // The index of an access is in range, so a sum within `most` of it is far
  // from the limits of its type and does not overflow.
  constexpr int64_t most = 64;
  int64_t sum = 0;
  Value value = index;
  bool isCast = false;
  for (;;) {
    Operation *op = value.getDefiningOp();
    // Sums outside of parallel loops are computed only once, so they are not
    // split.
    if (op && !op->getParentOfType<ParallelForOp>())
      break;
    if (auto cast = dyn_cast_if_present<arith::IndexCastOp>(op);
        cast && !isCast && cast.getType().isIndex() &&
        cast.getIn().getType().isInteger(32)) {
      isCast = true;
      value = cast.getIn();
      continue;
    }
    bool isSub = isa_and_present<arith::SubIOp>(op);
    if (!isSub && !isa_and_present<arith::AddIOp>(op))
      break;
    APInt amount;
    if (!matchPattern(op->getOperand(1), m_ConstantInt(&amount)))
      break;
    int64_t next = sum + (isSub ? -amount.getSExtValue() //
                                : amount.getSExtValue());
    if (std::abs(next) > most)
      break;
    sum = next;
    value = op->getOperand(0);
  }
  if (sum != 0)
    index = isCast ? arith::IndexCastOp::create(builder, loc,
                                                builder.getIndexType(), value)
                         .getResult()
                   : value;
  return sum;
}

/// Returns the address distance, in bytes, of neighbouring elements along each
/// dimension; 0 where the distance varies or is large.
static SmallVector<int64_t> getStrides(const FieldInfo &field) {
  SmallVector<int64_t> strides(field.layout.shape.size(), 0);
  llvm::SmallDenseSet<unsigned> several;
  constexpr uint64_t tooFar = 1 << 22;
  for (const IndexDigit &digit : field.storage.digits) {
    if (digit.extent == 1)
      continue;
    int64_t &stride = strides[digit.dimension];
    if (stride != 0 || !digit.isWhole || digit.stride >= tooFar)
      several.insert(digit.dimension);
    stride = int64_t(digit.stride);
  }
  for (unsigned dimension : several)
    strides[dimension] = 0;
  return strides;
}

SmallVector<int64_t> tai::peelConstants(OpBuilder &builder, Location loc,
                                        const FieldInfo &field,
                                        MutableArrayRef<Value> zeroBased) {
  SmallVector<int64_t> peeled(zeroBased.size(), 0);
  SmallVector<int64_t> strides = getStrides(field);
  for (auto [dimension, stride] : llvm::enumerate(strides))
    if (stride != 0)
      peeled[dimension] = peelConstant(builder, loc, zeroBased[dimension]);
  return peeled;
}

Value tai::emitNearPointer(OpBuilder &builder, Location loc,
                           const FieldInfo &field, Value base,
                           ValueRange indices, ArrayRef<int64_t> peeled,
                           ValueRange components) {
  int64_t distance = 0;
  for (auto [stride, count] : llvm::zip_equal(getStrides(field), peeled))
    distance += stride * count;
  // Without the peeled constants, the address may lie outside of the field.
  bool isElement =
      llvm::all_of(peeled, [](int64_t count) { return count == 0; });
  if (!components.empty())
    if (auto position = getConstantIntValue(
            emitComponent(builder, loc, field.elementShape, components))) {
      distance += *position * field.scalarSize;
      components = {};
    }
  auto flags = isElement
                   ? LLVM::GEPNoWrapFlags::inbounds | LLVM::GEPNoWrapFlags::nuw
                   : LLVM::GEPNoWrapFlags::none;
  Type pointer = LLVM::LLVMPointerType::get(builder.getContext());
  IndexMath math(builder, loc);
  Value offset = emitElementOffset(builder, loc, field, indices, components);
  Value address = base;
  if (getConstantIntValue(offset) != 0)
    address = LLVM::GEPOp::create(
        builder, loc, pointer, getStorageType(field.scalarType), address,
        ArrayRef<LLVM::GEPArg>{math.toI64(offset)}, flags);
  if (distance != 0)
    address = LLVM::GEPOp::create(
        builder, loc, pointer, builder.getI8Type(), address,
        ArrayRef<LLVM::GEPArg>{static_cast<int32_t>(distance)}, flags);
  return address;
}

/// Sets the alias scopes and other attributes of a load or store.
template <typename Op> static void addScopes(Op access, AliasScopes scopes) {
  access.setAliasScopesAttr(scopes.own);
  access.setNoaliasScopesAttr(scopes.others);
  access.setAccessGroupsAttr(scopes.groups);
  if (scopes.alignment)
    access.setAlignment(scopes.alignment);
  if (scopes.digits)
    access->setAttr(kDigitsAttrName, scopes.digits);
}

Value tai::emitLoad(OpBuilder &builder, Location loc, Type scalar,
                    Value pointer, AliasScopes scopes) {
  Type storage = getStorageType(scalar);
  auto load = LLVM::LoadOp::create(builder, loc, storage, pointer);
  addScopes(load, scopes);
  if (scalar.isInteger(1))
    return arith::TruncIOp::create(builder, loc, scalar, load);
  if (scalar.isIndex())
    return arith::IndexCastOp::create(builder, loc, scalar, load);
  return load;
}

void tai::emitStore(OpBuilder &builder, Location loc, Value value,
                    Value pointer, AliasScopes scopes) {
  Type storage = getStorageType(value.getType());
  if (value.getType().isInteger(1))
    value = arith::ExtUIOp::create(builder, loc, storage, value);
  else if (value.getType().isIndex())
    value = arith::IndexCastOp::create(builder, loc, storage, value);
  auto store = LLVM::StoreOp::create(builder, loc, value, pointer);
  addScopes(store, scopes);
}
