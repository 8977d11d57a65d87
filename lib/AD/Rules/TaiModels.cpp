//===- TaiModels.cpp - Derivatives of accesses and parallel loops ---------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Models.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "tai/AD/NarrowAdjoints.h"
#include "tai/AD/Reverse/AdjointBuilder.h"
#include "tai/AD/Reverse/ParallelReverse.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

namespace {

/// The methods that the models of all accesses share: the adjoint of an element
/// is read and accumulated at the same indices of the adjoint field.
template <typename Model, typename OpTy>
struct AccessModel : DifferentiableAccessInterface::ExternalModel<Model, OpTy> {
  Storage getAccessedStorage(Operation *op) const {
    return cast<OpTy>(op).getFieldAttr();
  }
  OperandRange getAccessIndices(Operation *op) const {
    return cast<OpTy>(op).getIndices();
  }
  ValueRange getAccessComponents(Operation *op) const {
    return cast<OpTy>(op).getComponents();
  }
  Value getAccessedValue(Operation *op) const {
    return cast<OpTy>(op).getValue();
  }
  Value createAdjointRead(Operation *op, OpBuilder &b, Storage storage,
                          ValueRange indices, ValueRange components) const {
    Type type = getAccessedValue(op).getType();
    Value read =
        LoadOp::create(b, op->getLoc(), getStoredType(op, storage, type),
                       storage.field, indices, components);
    if (read.getType() == type)
      return read;
    return arith::TruncFOp::create(b, op->getLoc(), type, read);
  }
  void createAdjointAccumulate(Operation *op, OpBuilder &b, Value value,
                               Storage storage, ValueRange indices,
                               ValueRange components) const {
    AtomicOp::create(b, op->getLoc(), AtomicKind::Add,
                     widen(op, b, value, storage), storage.field, indices,
                     components);
  }
  void createAdjointStore(Operation *op, OpBuilder &b, Value value,
                          Storage storage, ValueRange indices,
                          ValueRange components) const {
    StoreOp::create(b, op->getLoc(), widen(op, b, value, storage),
                    storage.field, indices, components);
  }

private:
  /// Replaces the float type in `type` by that of the field in `storage`. An
  /// adjoint field may have a wider type than its primal: gradients of narrow
  /// floats are sums, which would lose digits in narrow floats.
  static Type getStoredType(Operation *op, Storage storage, Type type) {
    FieldOp field = lookupField(op, storage.field);
    Type element = getElementTypeOrSelf(field.getType());
    if (element == getElementTypeOrSelf(type))
      return type;
    if (auto vector = dyn_cast<VectorType>(type))
      return vector.clone(element);
    return element;
  }
  static Value widen(Operation *op, OpBuilder &b, Value value,
                     Storage storage) {
    Type type = getStoredType(op, storage, value.getType());
    return createCastOfAdjoint(b, op->getLoc(), value, type);
  }
};

struct LoadModel : AccessModel<LoadModel, LoadOp> {
  AccessKind getAccessKind(Operation *) const { return AccessKind::Read; }
  LogicalResult buildTangent(Operation *op, TangentBuilder &b,
                             Storage tangents) const {
    auto load = cast<LoadOp>(op);
    b.setTangent(load.getValue(),
                 LoadOp::create(b, load.getType(), tangents.field,
                                load.getIndices(), load.getComponents()));
    return success();
  }
};

struct StoreModel : AccessModel<StoreModel, StoreOp> {
  AccessKind getAccessKind(Operation *) const { return AccessKind::Write; }
  LogicalResult buildTangent(Operation *op, TangentBuilder &b,
                             Storage tangents) const {
    auto store = cast<StoreOp>(op);
    StoreOp::create(b, b.getTangentOrZero(store.getValue()), tangents.field,
                    store.getIndices(), store.getComponents());
    return success();
  }
};

struct AtomicModel : AccessModel<AtomicModel, AtomicOp> {
  AccessKind getAccessKind(Operation *op) const {
    AtomicKind kind = cast<AtomicOp>(op).getKind();
    return kind == AtomicKind::Add || kind == AtomicKind::Sub
               ? AccessKind::Accumulate
               : AccessKind::Update;
  }
  bool isNegated(Operation *op) const {
    return cast<AtomicOp>(op).getKind() == AtomicKind::Sub;
  }
  LogicalResult buildTangent(Operation *op, TangentBuilder &b,
                             Storage tangents) const;
};

// The tangent of an atomic addition is an atomic addition, in any order. The
// tangents of other kinds depend on the element before the update, which other
// iterations may change between the update of the element and the update of its
// tangent.
LogicalResult AtomicModel::buildTangent(Operation *op, TangentBuilder &b,
                                        Storage tangents) const {
  auto atomic = cast<AtomicOp>(op);
  AtomicKind kind = atomic.getKind();
  Value value = atomic.getValue(), old = atomic.getOld();
  Value tangent = b.getTangent(value);
  bool isSum = kind == AtomicKind::Add || kind == AtomicKind::Sub;
  bool isLinear = isSum || (kind == AtomicKind::Mul && !tangent);
  bool isAlone = isLinear && old.use_empty();
  if (!isAlone && !b.isExclusive(op) && failed(b.runInOrder(op)))
    return failure();
  ValueRange indices = atomic.getIndices(), components = atomic.getComponents();
  Value oldTangent;
  if (!isAlone) {
    oldTangent =
        LoadOp::create(b, old.getType(), tangents.field, indices, components);
    b.setTangent(old, oldTangent);
  }
  if (isLinear) {
    if (Value operand = isSum ? tangent : value)
      AtomicOp::create(b, kind, operand, tangents.field, indices, components,
                       atomic.getExclusive());
    return success();
  }
  UpdateKind update = kind == AtomicKind::Mul   ? UpdateKind::Product
                      : kind == AtomicKind::Max ? UpdateKind::Greatest
                                                : UpdateKind::Least;
  StoreOp::create(b, createUpdatedTangent(b, update, old, oldTangent, value),
                  tangents.field, indices, components);
  return success();
}

/// A parallel loop stays parallel: each iteration is reversed on its own.
struct ParallelForModel
    : AdjointLoopInterface::ExternalModel<ParallelForModel, ParallelForOp> {
  bool runsInParallel(Operation *) const { return true; }

  LogicalResult buildReverse(Operation *op, AdjointBuilder &b) const {
    auto primal = cast<ParallelForOp>(op);
    SmallVector<Value> lower = b.getPrimals(primal.getLowerBounds());
    SmallVector<Value> upper = b.getPrimals(primal.getUpperBounds());
    if (primal.getSerialize() && primal.isStructFor()) {
      b.emitError(op, "cannot reverse a serialized loop over a field")
              .attachNote()
          << "run it over a range, or use 'scf.for'";
      return failure();
    }
    if (failed(b.beginContended(primal)))
      return failure();
    IRMapping mapping;
    mapping.map(primal.getLowerBounds(), lower);
    mapping.map(primal.getUpperBounds(), upper);
    Operation *loop = b.insert(op->cloneWithoutRegions(mapping));
    OpBuilder::InsertionGuard guard(b);
    Block *mirror = b.createBlock(&loop->getRegion(0));
    for (BlockArgument iv : primal.getInductionVars())
      mirror->addArgument(iv.getType(), iv.getLoc());
    auto begin = [&](Frame &frame) {
      for (auto [i, iv] : llvm::enumerate(primal.getInductionVars())) {
        Value position = mirror->getArgument(i);
        if (primal.getSerialize()) {
          // An iteration may depend on earlier ones, so the iterations run
          // backwards.
          Value last = arith::SubIOp::create(
              b, arith::AddIOp::create(b, lower[i], upper[i]),
              arith::ConstantIndexOp::create(b, 1));
          position = arith::SubIOp::create(b, last, position);
        }
        frame.values.map(iv, position);
      }
    };
    LogicalResult result =
        reverseParallelBody(b, loop, primal.getBody().getBlocks().front(),
                            *mirror, begin, [&] { YieldOp::create(b); });
    b.endContended();
    return result;
  }
};
} // namespace

void mlir::tai::registerTaiModels(DialectRegistry &registry) {
  registry.addExtension(+[](MLIRContext *context, TaiDialect *) {
    LoadOp::attachInterface<LoadModel>(*context);
    StoreOp::attachInterface<StoreModel>(*context);
    AtomicOp::attachInterface<AtomicModel>(*context);
    ParallelForOp::attachInterface<ParallelForModel>(*context);
  });
}
