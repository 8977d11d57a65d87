//===- MemRefModels.cpp - Derivatives of memref accesses ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Models.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "tai/AD/AdjointBuilder.h"

using namespace mlir;
using namespace mlir::tai;

namespace {

/// Adds to an element of a memref. Atomic updates exist for scalars alone.
void createAccumulate(OpBuilder &b, Location loc, Value value, Value memref,
                      ValueRange indices) {
  if (!isa<VectorType>(value.getType())) {
    memref::AtomicRMWOp::create(b, loc, arith::AtomicRMWKind::addf, value,
                                memref, indices);
    return;
  }
  Value old = memref::LoadOp::create(b, loc, memref, indices);
  Value sum = arith::AddFOp::create(b, loc, old, value);
  auto store = memref::StoreOp::create(b, loc, sum, memref, indices);
  store->setAttr(kPlainAccumulation, b.getUnitAttr());
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
    return memref::LoadOp::create(b, op->getLoc(), storage.memref, indices);
  }
  void createAdjointAccumulate(Operation *op, OpBuilder &b, Value value,
                               Storage storage, ValueRange indices,
                               ValueRange) const {
    createAccumulate(b, op->getLoc(), value, storage.memref, indices);
  }
  void createAdjointStore(Operation *op, OpBuilder &b, Value value,
                          Storage storage, ValueRange indices,
                          ValueRange) const {
    memref::StoreOp::create(b, op->getLoc(), value, storage.memref, indices);
  }
};

struct LoadModel : AccessModel<LoadModel, memref::LoadOp> {
  AccessKind getAccessKind(Operation *) const { return AccessKind::Read; }
  Value getAccessedValue(Operation *op) const { return op->getResult(0); }
};

struct StoreModel : AccessModel<StoreModel, memref::StoreOp> {
  AccessKind getAccessKind(Operation *) const { return AccessKind::Write; }
  Value getAccessedValue(Operation *op) const {
    return cast<memref::StoreOp>(op).getValueToStore();
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
};
} // namespace

void mlir::tai::registerMemRefModels(DialectRegistry &registry) {
  registry.addExtension(+[](MLIRContext *context, memref::MemRefDialect *) {
    memref::LoadOp::attachInterface<LoadModel>(*context);
    memref::StoreOp::attachInterface<StoreModel>(*context);
    memref::AtomicRMWOp::attachInterface<AtomicModel>(*context);
  });
}
