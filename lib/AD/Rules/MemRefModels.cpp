//===- MemRefModels.cpp - Derivatives of memref accesses ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Models.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/Utils/IndexingUtils.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "tai/AD/Reverse/AdjointBuilder.h"

using namespace mlir;
using namespace mlir::tai;

namespace {

/// For each component of an element of `type`, calls `action` with its position
/// and with its indices in the array of adjoints, which has one element for
/// each component.
void forEachComponent(
    OpBuilder &b, Location loc, Type type, ValueRange indices,
    function_ref<void(ArrayRef<int64_t>, ValueRange)> action) {
  auto vector = dyn_cast<VectorType>(type);
  if (!vector)
    return action({}, indices);
  for (int64_t i = 0, e = vector.getNumElements(); i != e; ++i) {
    SmallVector<int64_t> position =
        delinearize(i, computeSuffixProduct(vector.getShape()));
    SmallVector<Value> all(indices);
    for (int64_t index : position)
      all.push_back(arith::ConstantIndexOp::create(b, loc, index));
    action(position, all);
  }
}

template <typename Model, typename OpTy>
struct AccessModel : DifferentiableAccessInterface::ExternalModel<Model, OpTy> {
  Storage getAccessedStorage(Operation *op) const {
    return Storage(Value(cast<OpTy>(op).getMemref()));
  }
  OperandRange getAccessIndices(Operation *op) const {
    return cast<OpTy>(op).getIndices();
  }
  Value createAdjointRead(Operation *op, OpBuilder &b, Storage storage,
                          ValueRange indices, ValueRange) const {
    Location loc = op->getLoc();
    auto array = cast<MemRefType>(cast<OpTy>(op).getMemref().getType());
    Type type = array.getElementType();
    auto held = cast<MemRefType>(storage.memref.getType());
    if (held.getElementType() == type)
      return memref::LoadOp::create(b, loc, storage.memref, indices);
    SmallVector<Value> parts;
    forEachComponent(
        b, loc, type, indices, [&](ArrayRef<int64_t>, ValueRange at) {
          parts.push_back(memref::LoadOp::create(b, loc, storage.memref, at));
        });
    return vector::FromElementsOp::create(b, loc, type, parts);
  }
  void createAdjointAccumulate(Operation *op, OpBuilder &b, Value value,
                               Storage storage, ValueRange indices,
                               ValueRange) const {
    Location loc = op->getLoc();
    forEachComponent(
        b, loc, value.getType(), indices,
        [&](ArrayRef<int64_t> position, ValueRange at) {
          Value part = value;
          if (!position.empty())
            part = vector::ExtractOp::create(b, loc, value, position);
          memref::AtomicRMWOp::create(b, loc, arith::AtomicRMWKind::addf, part,
                                      storage.memref, at);
        });
  }
  void createAdjointStore(Operation *op, OpBuilder &b, Value value,
                          Storage storage, ValueRange indices,
                          ValueRange) const {
    Location loc = op->getLoc();
    auto array = cast<MemRefType>(storage.memref.getType());
    if (array.getElementType() == value.getType()) {
      memref::StoreOp::create(b, loc, value, storage.memref, indices);
      return;
    }
    forEachComponent(
        b, loc, value.getType(), indices,
        [&](ArrayRef<int64_t> position, ValueRange at) {
          Value part = vector::ExtractOp::create(b, loc, value, position);
          memref::StoreOp::create(b, loc, part, storage.memref, at);
        });
  }
};

struct LoadModel : AccessModel<LoadModel, memref::LoadOp> {
  AccessKind getAccessKind(Operation *) const { return AccessKind::Read; }
  Value getAccessedValue(Operation *op) const { return op->getResult(0); }
  LogicalResult buildTangent(Operation *op, TangentBuilder &b,
                             Storage tangents) const {
    b.setTangent(op->getResult(0),
                 memref::LoadOp::create(b, tangents.memref,
                                        cast<memref::LoadOp>(op).getIndices()));
    return success();
  }
};

struct StoreModel : AccessModel<StoreModel, memref::StoreOp> {
  AccessKind getAccessKind(Operation *) const { return AccessKind::Write; }
  Value getAccessedValue(Operation *op) const {
    return cast<memref::StoreOp>(op).getValueToStore();
  }
  LogicalResult buildTangent(Operation *op, TangentBuilder &b,
                             Storage tangents) const {
    auto store = cast<memref::StoreOp>(op);
    memref::StoreOp::create(b, b.getTangentOrZero(store.getValueToStore()),
                            tangents.memref, store.getIndices());
    return success();
  }
};

struct AtomicModel : AccessModel<AtomicModel, memref::AtomicRMWOp> {
  AccessKind getAccessKind(Operation *op) const {
    switch (cast<memref::AtomicRMWOp>(op).getKind()) {
    case arith::AtomicRMWKind::addf:
      return AccessKind::Accumulate;
    case arith::AtomicRMWKind::assign:
      return AccessKind::Write;
    default:
      return AccessKind::Update;
    }
  }
  Value getAccessedValue(Operation *op) const {
    return cast<memref::AtomicRMWOp>(op).getValue();
  }
  LogicalResult buildTangent(Operation *op, TangentBuilder &b,
                             Storage tangents) const;
};

// The tangent of a memref.atomic_rmw follows the rule for `tai.atomic`; see
// TaiModels.cpp.
LogicalResult AtomicModel::buildTangent(Operation *op, TangentBuilder &b,
                                        Storage tangents) const {
  using Kind = arith::AtomicRMWKind;
  auto atomic = cast<memref::AtomicRMWOp>(op);
  Kind kind = atomic.getKind();
  Value value = atomic.getValue(), old = atomic.getResult();
  Value tangent = b.getTangent(value), memref = tangents.memref;
  ValueRange indices = atomic.getIndices();
  bool isLinear = kind == Kind::addf || (kind == Kind::mulf && !tangent);
  bool isAlone = isLinear && old.use_empty();
  if (!isAlone && !b.isExclusive(op) && failed(b.runInOrder(op)))
    return failure();
  Value oldTangent;
  if (!isAlone) {
    oldTangent = memref::LoadOp::create(b, memref, indices);
    b.setTangent(old, oldTangent);
  }
  if (isLinear) {
    if (Value operand = kind == Kind::addf ? tangent : value)
      memref::AtomicRMWOp::create(b, kind, operand, memref, indices);
    return success();
  }
  Value result;
  switch (kind) {
  case Kind::assign:
    result = b.getTangentOrZero(value);
    break;
  case Kind::mulf:
    result =
        createUpdatedTangent(b, UpdateKind::Product, old, oldTangent, value);
    break;
  case Kind::maximumf:
  case Kind::maxnumf:
    result =
        createUpdatedTangent(b, UpdateKind::Greatest, old, oldTangent, value);
    break;
  case Kind::minimumf:
  case Kind::minnumf:
    result = createUpdatedTangent(b, UpdateKind::Least, old, oldTangent, value);
    break;
  default:
    return refuseTangent(op, b);
  }
  memref::StoreOp::create(b, result, memref, indices);
  return success();
}
} // namespace

void mlir::tai::registerMemRefModels(DialectRegistry &registry) {
  registry.addExtension(+[](MLIRContext *context, memref::MemRefDialect *) {
    memref::LoadOp::attachInterface<LoadModel>(*context);
    memref::StoreOp::attachInterface<StoreModel>(*context);
    memref::AtomicRMWOp::attachInterface<AtomicModel>(*context);
  });
}
