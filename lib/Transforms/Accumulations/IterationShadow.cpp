//===- IterationShadow.cpp - Who came to an element -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An entry is -1 if no iteration has reached its element, the number of the
// iteration if one has, and greater than all numbers if several have. Atomic
// maxima update the entries: of two iterations, the second one sees the number
// of the first.
//
//===----------------------------------------------------------------------===//

#include "IterationShadow.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/ABI/Abi.h"
#include "tai/Dialect/Tai/IR/Layout.h"

using namespace mlir;
using namespace mlir::tai;

/// The shadow entry of an element that several iterations have reached. Numbers
/// of iterations are smaller; f64 represents all of them exactly.
static constexpr int64_t kSeveral = int64_t(1) << 52;

std::string mlir::tai::describeElement(DifferentiableAccessInterface access) {
  if (FlatSymbolRefAttr field = access.getAccessedStorage().field)
    return ("an element of field '@" + field.getValue() + "'").str();
  return "an element of an array";
}

Value IterationShadow::index(int64_t value) {
  return arith::ConstantIndexOp::create(b, value);
}

Value IterationShadow::real(double value) {
  return arith::ConstantOp::create(b, b.getF64FloatAttr(value));
}

std::optional<IterationShadow>
IterationShadow::create(ParallelForOp loop,
                        DifferentiableAccessInterface access, Value isWanted) {
  constexpr int64_t most = int64_t(1) << 27;
  IterationShadow shadow(loop);
  shadow.isWanted = isWanted;
  ImplicitLocOpBuilder &b = shadow.b;
  int64_t known = 1;
  if (FlatSymbolRefAttr name = access.getAccessedStorage().field) {
    FieldOp field = lookupField(loop, name);
    FailureOr<FieldLayout> layout = getFieldLayout(field);
    if (failed(layout))
      return std::nullopt;
    if (auto vector = dyn_cast<VectorType>(field.getType()))
      llvm::append_range(shadow.shape, vector.getShape());
    for (int64_t extent : shadow.shape)
      if (llvm::MulOverflow(known, extent, known) || known > most)
        return std::nullopt;
    for (int64_t extent : layout->shape) {
      if (llvm::MulOverflow(known, extent, known) || known > most)
        return std::nullopt;
      shadow.extents.push_back(shadow.index(extent));
    }
  } else {
    Value array = access.getAccessedStorage().memref;
    for (size_t dim = 0; dim != access.getAccessIndices().size(); ++dim)
      shadow.extents.push_back(
          memref::DimOp::create(b, array, shadow.index(dim)));
  }
  shadow.size = shadow.index(1);
  for (Value extent : shadow.extents)
    shadow.size = b.createOrFold<arith::MulIOp>(shadow.size, extent);
  for (int64_t extent : shadow.shape)
    shadow.size =
        b.createOrFold<arith::MulIOp>(shadow.size, shadow.index(extent));
  shadow.size = b.createOrFold<arith::MaxSIOp>(shadow.size, shadow.index(1));
  if (isWanted)
    shadow.size =
        b.createOrFold<arith::SelectOp>(isWanted, shadow.size, shadow.index(1));
  return shadow;
}

Value IterationShadow::createArray() {
  b.setLoc(loop.getLoc());
  b.setInsertionPoint(loop);
  Value array = memref::AllocOp::create(
      b, MemRefType::get({ShapedType::kDynamic}, b.getF64Type()), size);
  auto clear = ParallelForOp::create(b, index(0), size);
  b.setInsertionPointToStart(&clear.getBody().front());
  memref::StoreOp::create(b, real(-1), array, clear.getInductionVars().front());
  b.setInsertionPointAfter(loop);
  memref::DeallocOp::create(b, array);
  return array;
}

void IterationShadow::moveTo(DifferentiableAccessInterface access) {
  b.setLoc(access->getLoc());
  b.setInsertionPoint(access);
  if (isWanted)
    b.setInsertionPointToStart(
        scf::IfOp::create(b, isWanted, /*withElseRegion=*/false).thenBlock());
}

/// Returns the positions in the shadow array of the components that the access
/// reaches. Indices out of range wrap around; other checks report them.
SmallVector<Value>
IterationShadow::getNumbers(DifferentiableAccessInterface access) {
  Value first = index(0);
  auto add = [&](Value position, Value extent) {
    if (!position.getType().isIndex())
      position = arith::IndexCastOp::create(b, b.getIndexType(), position);
    first = arith::AddIOp::create(b, arith::MulIOp::create(b, first, extent),
                                  position);
  };
  for (auto [position, extent] :
       llvm::zip_equal(access.getAccessIndices(), extents))
    add(position, extent);
  int64_t count = 1;
  ValueRange components = access.getAccessComponents();
  for (auto [dim, extent] : llvm::enumerate(shape)) {
    if (components.empty())
      count *= extent;
    else
      add(components[dim], index(extent));
  }
  SmallVector<Value> numbers;
  for (int64_t i = 0; i != count; ++i) {
    Value number = first;
    if (count != 1)
      number = arith::AddIOp::create(
          b, arith::MulIOp::create(b, first, index(count)), index(i));
    numbers.push_back(arith::RemUIOp::create(b, number, size));
  }
  return numbers;
}

Value IterationShadow::getIteration() {
  Value iteration = index(0);
  for (Value iv : loop.getInductionVars())
    iteration = arith::AddIOp::create(
        b, arith::MulIOp::create(b, iteration, index(1000003)), iv);
  Value lowBits = arith::IndexCastOp::create(b, b.getI64Type(), iteration);
  lowBits = arith::AndIOp::create(
      b, lowBits, arith::ConstantIntOp::create(b, kSeveral - 1, 64));
  return arith::SIToFPOp::create(b, b.getF64Type(), lowBits);
}

Value IterationShadow::isNoneOr(Value number, Value own) {
  using Predicate = arith::CmpFPredicate;
  return arith::OrIOp::create(
      b, arith::CmpFOp::create(b, Predicate::OLT, number, real(0)),
      arith::CmpFOp::create(b, Predicate::OEQ, number, own));
}

Value IterationShadow::leave(Value array,
                             DifferentiableAccessInterface access) {
  Value own = getIteration(), isAlone;
  for (Value number : getNumbers(access)) {
    Value before = memref::AtomicRMWOp::create(
        b, arith::AtomicRMWKind::maximumf, own, array, number);
    Value isFirst = isNoneOr(before, own);
    Value mark = arith::SelectOp::create(b, isFirst, own,
                                         real(static_cast<double>(kSeveral)));
    memref::AtomicRMWOp::create(b, arith::AtomicRMWKind::maximumf, mark, array,
                                number);
    isAlone = isAlone ? arith::AndIOp::create(b, isAlone, isFirst).getResult()
                      : isFirst;
  }
  return isAlone;
}

Value IterationShadow::isFree(Value array,
                              DifferentiableAccessInterface access) {
  Value own = getIteration(), isFree;
  for (Value number : getNumbers(access)) {
    // The shadow is read by an atomic maximum with -1, which, unlike a load, is
    // not moved before the update that leaves this iteration's own number for
    // other iterations.
    Value found = memref::AtomicRMWOp::create(b, arith::AtomicRMWKind::maximumf,
                                              real(-1), array, number);
    Value isMine = isNoneOr(found, own);
    isFree =
        isFree ? arith::AndIOp::create(b, isFree, isMine).getResult() : isMine;
  }
  return isFree;
}

void IterationShadow::require(Value condition,
                              DifferentiableAccessInterface access,
                              const Twine &message) {
  SmallVector<Value> position(access.getAccessIndices());
  llvm::append_range(position, access.getAccessComponents());
  std::string text = describeElement(access);
  if (!position.empty()) {
    text += ", at [";
    for (size_t i = 0; i != position.size(); ++i)
      text += i ? ", {}" : "{}";
    text += "],";
  }
  text += (" " + message).str();
  AssertOp::create(b, condition, b.getStringAttr(text), position,
                   b.getI32IntegerAttr(TAI_FAIL_ASSERT));
}
