//===- Contention.cpp - Derivatives of contended atomics ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Minimum and maximum: the contributions equal to the extreme one share the
// adjoint equally, and the old value of the element gets nothing, unless the
// old value is more extreme; then it gets the whole adjoint.
//
// Product: the old value of the element is one of the factors. Each factor gets
// the product of the others: without zeros, the total divided by the factor;
// with one zero, only that factor gets a non-zero adjoint; with more, none
// does.
//
//===----------------------------------------------------------------------===//

#include "ContendedAtomics.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Dialect/Tai/IR/Layout.h"

using namespace mlir;
using namespace mlir::tai;

/// The maximal number of elements of a field with contended updates.
static constexpr int64_t kMaxElements = int64_t(1) << 28;

//===----------------------------------------------------------------------===//
// Small helpers
//===----------------------------------------------------------------------===//

Value Contention::load(Value buffer, Value at) {
  return memref::LoadOp::create(b, buffer, at);
}

void Contention::store(Value value, Value buffer, Value at) {
  memref::StoreOp::create(b, value, buffer, at);
}

Value Contention::compare(arith::CmpFPredicate predicate, Value lhs,
                          Value rhs) {
  return arith::CmpFOp::create(b, predicate, lhs, rhs);
}

Value Contention::select(Value condition, Value yes, Value no) {
  return arith::SelectOp::create(b, condition, yes, no);
}

Value Contention::integer(int64_t value) {
  return arith::ConstantIntOp::create(b, value, 32);
}

Value Contention::isInteger(Value value, int64_t expected) {
  return arith::CmpIOp::create(b, arith::CmpIPredicate::eq, value,
                               integer(expected));
}

Value Contention::isZero(Value value) {
  return compare(arith::CmpFPredicate::OEQ, value, constant(0));
}

Value Contention::toReal(Value value) {
  if (value.getType() == real)
    return value;
  return arith::ExtFOp::create(b, real, value);
}

/// The float type in which the field in `storage` holds its elements. It can be
/// wider for an adjoint field than for the primal field.
static Type getNumberType(Storage storage, Operation *op) {
  return getElementTypeOrSelf(lookupField(op, storage.field).getType());
}

Value Contention::loadElement(Storage storage, const Element &element) {
  Type type = getNumberType(storage, atomics.front());
  return toReal(LoadOp::create(b, type, storage.field, element.indices,
                               element.components));
}

void Contention::storeElement(Value value, Storage storage,
                              const Element &element) {
  Type type = getNumberType(storage, atomics.front());
  if (type != real)
    value = arith::TruncFOp::create(b, type, value);
  StoreOp::create(b, value, storage.field, element.indices, element.components);
}

//===----------------------------------------------------------------------===//
// Memory and loops
//===----------------------------------------------------------------------===//

LogicalResult Contention::findDimensions() {
  AtomicOp first = atomics.front();
  FieldLayout layout =
      *getFieldLayout(lookupField(first, first.getFieldAttr()));
  rank = layout.shape.size();
  for (auto [extent, offset] : llvm::zip(layout.shape, layout.offset))
    dimensions.push_back({Value(), offset, extent});
  if (auto vector = dyn_cast<VectorType>(layout.path.getElementType()))
    for (int64_t extent : vector.getShape())
      dimensions.push_back({Value(), 0, extent});
  SmallVector<Value> position = getElementPosition(first);
  int64_t elements = 1;
  for (auto [i, dimension] : llvm::enumerate(dimensions)) {
    bool isFixed = llvm::all_of(atomics, [&, i = i](AtomicOp atomic) {
      Value index = getElementPosition(atomic)[i];
      return isKnownBefore(loop, index) && areProvablyEqual(index, position[i]);
    });
    if (isFixed) {
      dimension.fixed = b.getPrimal(position[i]);
      continue;
    }
    elements *= dimension.extent;
    if (elements > kMaxElements) {
      b.emitError(first, "the gradient needs room for every element of the "
                         "field that iterations combine here, and they are too "
                         "many")
              .attachNote()
          << "combine into a smaller field";
      return failure();
    }
  }
  numElements = arith::ConstantIndexOp::create(b, elements);
  return success();
}

/// Allocates a one-dimensional buffer of `size` numbers of `type`, and sets all
/// to `init`.
Value Contention::createBuffer(Value size, Type type, Value init) {
  auto bufferType = MemRefType::get({ShapedType::kDynamic}, type);
  Value buffer = memref::AllocOp::create(b, bufferType, size);
  createLoop(size, [&](ValueRange ivs) { store(init, buffer, ivs.front()); });
  return buffer;
}

void Contention::createLoop(ValueRange sizes,
                            llvm::function_ref<void(ValueRange)> createBody) {
  Value zero = arith::ConstantIndexOp::create(b, 0);
  SmallVector<Value> lower(sizes.size(), zero);
  auto parallel = ParallelForOp::create(b, lower, sizes);
  OpBuilder::InsertionGuard guard(b);
  Block &body = parallel.getBody().front();
  b.setInsertionPoint(body.getTerminator());
  SmallVector<Value> ivs(body.getArguments());
  createBody(ivs);
}

void Contention::createElementLoop(
    llvm::function_ref<void(const Element &)> createBody) {
  SmallVector<Value> sizes;
  for (const Dimension &dimension : dimensions)
    if (!dimension.fixed)
      sizes.push_back(arith::ConstantIndexOp::create(b, dimension.extent));
  if (sizes.empty())
    sizes.push_back(arith::ConstantIndexOp::create(b, 1));
  createLoop(sizes, [&](ValueRange ivs) {
    Element element;
    element.number = arith::ConstantIndexOp::create(b, 0);
    for (auto [i, dimension] : llvm::enumerate(dimensions)) {
      Value index = dimension.fixed;
      if (!index) {
        Value extent = arith::ConstantIndexOp::create(b, dimension.extent);
        Value first = arith::ConstantIndexOp::create(b, dimension.first);
        index = b.createOrFold<arith::AddIOp>(ivs.front(), first);
        element.number = b.createOrFold<arith::AddIOp>(
            b.createOrFold<arith::MulIOp>(element.number, extent), ivs.front());
        ivs = ivs.drop_front();
      }
      (i < rank ? element.indices : element.components).push_back(index);
    }
    createBody(element);
  });
}

/// Emits a loop over the executions of an atomic, whose body create(run,
/// element, value) emits.
void Contention::createValueLoop(
    const KeptValues &kept,
    llvm::function_ref<void(Value, Value, Value)> create) {
  createLoop(kept.size, [&](ValueRange ivs) {
    Value run = ivs.front(), element = load(kept.elements, run);
    Value zero = arith::ConstantIndexOp::create(b, 0);
    Value ran =
        arith::CmpIOp::create(b, arith::CmpIPredicate::sge, element, zero);
    auto branch = scf::IfOp::create(b, ran, /*withElseRegion=*/false);
    b.setInsertionPointToStart(branch.thenBlock());
    create(run, element, load(kept.values, run));
  });
}

LogicalResult Contention::prepare() {
  Type type = atomics.front().getValue().getType();
  if (!isa<FloatType>(type)) {
    b.emitError(atomics.front(), "this combines several components at once; "
                                 "run 'tai-expand-atomics' first");
    return failure();
  }
  // The adjoint is computed in a type at least as wide as the type of the
  // adjoint field.
  Type adjoint =
      getNumberType(b.getAdjointStorage(getStorage()), atomics.front());
  real = type.getIntOrFloatBitWidth() < 32 ? Type(b.getF32Type()) : type;
  if (adjoint.getIntOrFloatBitWidth() > real.getIntOrFloatBitWidth())
    real = adjoint;
  if (failed(findDimensions()))
    return failure();
  double infinity = std::numeric_limits<double>::infinity();
  double identity = kind == AtomicKind::Mul   ? 1.0
                    : kind == AtomicKind::Max ? -infinity
                                              : infinity;
  total = createBuffer(numElements, real, constant(identity));
  count = createBuffer(numElements, b.getI32Type(), integer(0));
  weight = createBuffer(numElements, real, constant(0));
  if (kind == AtomicKind::Mul)
    startProduct();
  return success();
}

KeptValues Contention::createKept(ArrayRef<CountedLoop> loops) {
  KeptValues kept;
  llvm::append_range(kept.loops, loops);
  kept.size = arith::ConstantIndexOp::create(b, 1);
  for (const CountedLoop &counted : loops)
    kept.size = b.createOrFold<arith::MulIOp>(kept.size, counted.extent);
  kept.values = memref::AllocOp::create(
      b, MemRefType::get({ShapedType::kDynamic}, real), kept.size);
  Value none = arith::ConstantIndexOp::create(b, -1);
  kept.elements = createBuffer(kept.size, b.getIndexType(), none);
  return kept;
}

//===----------------------------------------------------------------------===//
// Values
//===----------------------------------------------------------------------===//

/// The product starts at 1, without the old value of the element: an old value
/// may be so small that its product with the factors has no digits left.
void Contention::startProduct() {
  createElementLoop([&](const Element &element) {
    store(constant(1), total, element.number);
    store(integer(0), count, element.number);
  });
}

void Contention::keepValue(const KeptValues &kept, AtomicOp copy, Value run) {
  Value element = arith::ConstantIndexOp::create(b, 0);
  for (auto [index, dimension] :
       llvm::zip(getElementPosition(copy), dimensions)) {
    if (dimension.fixed)
      continue;
    Value extent = arith::ConstantIndexOp::create(b, dimension.extent);
    Value first = arith::ConstantIndexOp::create(b, dimension.first);
    element = b.createOrFold<arith::AddIOp>(
        b.createOrFold<arith::MulIOp>(element, extent),
        b.createOrFold<arith::SubIOp>(index, first));
  }
  Value value = toReal(copy.getValue());
  store(value, kept.values, run);
  store(element, kept.elements, run);
  arith::AtomicRMWKind combine = arith::AtomicRMWKind::minimumf;
  if (kind == AtomicKind::Mul) {
    combine = arith::AtomicRMWKind::mulf;
    value = select(isZero(value), constant(1), value);
  } else if (kind == AtomicKind::Max) {
    combine = arith::AtomicRMWKind::maximumf;
  }
  memref::AtomicRMWOp::create(b, combine, value, total, element);
}

/// Emits a count of the contributions that decide the result: the values equal
/// to the extreme one, or the zeros of a product.
void Contention::countDeciding(const KeptValues &kept) {
  createValueLoop(kept, [&](Value, Value element, Value value) {
    Value decides =
        kind == AtomicKind::Mul
            ? isZero(value)
            : compare(arith::CmpFPredicate::OEQ, value, load(total, element));
    Value one = select(decides, integer(1), integer(0));
    memref::AtomicRMWOp::create(b, arith::AtomicRMWKind::addi, one, count,
                                element);
  });
}

//===----------------------------------------------------------------------===//
// Adjoints
//===----------------------------------------------------------------------===//

/// Emits the adjoint of one factor of an element. The weight of the element is
/// its adjoint times its old value and all non-zero factors.
Value Contention::createFactorAdjoint(Value factor, Value element) {
  Value all = load(weight, element), zeros = load(count, element);
  Value zero = constant(0);
  Value isFactorZero = isZero(factor);
  Value others =
      arith::DivFOp::create(b, all, select(isFactorZero, constant(1), factor));
  Value only = select(isFactorZero, all, zero);
  return select(isInteger(zeros, 0), others,
                select(isInteger(zeros, 1), only, zero));
}

void Contention::createProductWeights() {
  Storage adjoint = b.getAdjointStorage(getStorage());
  createElementLoop([&](const Element &element) {
    // A product with an adjoint g that is zero is zero, whatever the other
    // factor is (it may be infinite).
    auto times = [&](Value g, Value factor) {
      return select(isZero(g), constant(0),
                    arith::MulFOp::create(b, g, factor));
    };
    Value g = loadElement(adjoint, element);
    Value all = times(g, load(total, element.number));
    Value before = loadElement(getStorage(), element);
    store(times(all, before), weight, element.number);
    Value zeros = load(count, element.number);
    storeElement(select(isInteger(zeros, 0), all, constant(0)), adjoint,
                 element);
  });
}

void Contention::createExtremeWeights() {
  Storage adjoint = b.getAdjointStorage(getStorage());
  createElementLoop([&](const Element &element) {
    Value g = loadElement(adjoint, element);
    Value number = load(count, element.number);
    // In a tie the contributions win against the old value.
    Value wins = compare(kind == AtomicKind::Max ? arith::CmpFPredicate::OGE
                                                 : arith::CmpFPredicate::OLE,
                         load(total, element.number),
                         loadElement(getStorage(), element));
    Value any =
        arith::CmpIOp::create(b, arith::CmpIPredicate::sgt, number, integer(0));
    wins = arith::AndIOp::create(b, wins, any);
    Value shares = arith::SIToFPOp::create(b, real, number);
    Value share = arith::DivFOp::create(b, g, shares);
    store(select(wins, share, constant(0)), weight, element.number);
    storeElement(select(wins, constant(0), g), adjoint, element);
  });
}

void Contention::createShares(const KeptValues &kept) {
  createValueLoop(kept, [&](Value run, Value element, Value value) {
    Value share;
    if (kind == AtomicKind::Mul) {
      share = createFactorAdjoint(value, element);
    } else {
      Value decides =
          compare(arith::CmpFPredicate::OEQ, value, load(total, element));
      share = select(decides, load(weight, element), constant(0));
    }
    store(share, kept.values, run);
  });
}

void Contention::createAdjoints(ArrayRef<KeptValues> kept) {
  for (const KeptValues &values : kept)
    countDeciding(values);
  if (kind == AtomicKind::Mul)
    createProductWeights();
  else
    createExtremeWeights();
  for (const KeptValues &values : kept)
    createShares(values);
  for (Value buffer : {total, count, weight})
    memref::DeallocOp::create(b, buffer);
}
