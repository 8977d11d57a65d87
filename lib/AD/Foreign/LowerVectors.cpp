//===- LowerVectors.cpp - Vectors, element by element ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An adjoint of an array accumulates elements one by one, so that an access by
// a vector becomes one access for each component. Ops on vectors whose
// derivative has no rule become arithmetic on their components.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/Utils/IndexingUtils.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "tai/AD/Foreign/Foreign.h"

using namespace mlir;
using namespace mlir::tai;

/// Vectors with more components are not lowered: the code has at least one op
/// for each component.
static constexpr int64_t kMostComponents = 1024;

namespace {
using Position = SmallVector<int64_t>;

class Lowering {
public:
  explicit Lowering(Operation *op)
      : op(op), b(op->getLoc(), OpBuilder(op).getContext()) {
    b.setInsertionPoint(op);
  }

  LogicalResult run();

private:
  using Loads = function_ref<Value(const Position &)>;

  SmallVector<Value> getElements(Value vector) {
    if (!isa<VectorType>(vector.getType()))
      return {vector};
    return vector::ToElementsOp::create(b, vector).getResults();
  }
  Value constant(int64_t value) {
    return arith::ConstantIndexOp::create(b, value);
  }
  Value add(Value index, int64_t offset) {
    return offset == 0 ? index
                       : b.createOrFold<arith::AddIOp>(index, constant(offset));
  }
  /// Emits `indices` moved by `position`: the position of a component is added
  /// to the last indices.
  SmallVector<Value> move(ValueRange indices, const Position &position) {
    SmallVector<Value> moved(indices);
    size_t first = moved.size() - position.size();
    for (auto [i, offset] : llvm::enumerate(position))
      moved[first + i] = add(moved[first + i], offset);
    return moved;
  }
  static Position at(ArrayRef<int64_t> shape, int64_t number) {
    return delinearize(number, computeSuffixProduct(shape));
  }
  static int64_t number(ArrayRef<int64_t> shape, ArrayRef<int64_t> position) {
    return linearize(position, computeSuffixProduct(shape));
  }
  /// Emits a load that runs only where `condition` holds; elsewhere the value
  /// is `other`. A null condition always holds.
  Value loadIf(Value condition, Value memref, ValueRange indices, Value other) {
    if (!condition)
      return memref::LoadOp::create(b, memref, indices);
    auto branch = scf::IfOp::create(
        b, condition,
        [&](OpBuilder &nested, Location loc) {
          Value value = memref::LoadOp::create(nested, loc, memref, indices);
          scf::YieldOp::create(nested, loc, value);
        },
        [&](OpBuilder &nested, Location loc) {
          scf::YieldOp::create(nested, loc, other);
        });
    return branch.getResult(0);
  }
  void storeIf(Value condition, Value value, Value memref, ValueRange indices) {
    if (!condition) {
      memref::StoreOp::create(b, value, memref, indices);
      return;
    }
    scf::IfOp::create(b, condition, [&](OpBuilder &nested, Location loc) {
      memref::StoreOp::create(nested, loc, value, memref, indices);
      scf::YieldOp::create(nested, loc);
    });
  }
  void replace(VectorType type, ArrayRef<Value> elements) {
    Value made = vector::FromElementsOp::create(b, type, elements);
    op->replaceAllUsesWith(ValueRange{made});
  }
  void load(VectorType type, Loads element) {
    SmallVector<Value> elements;
    for (int64_t i = 0, e = type.getNumElements(); i != e; ++i)
      elements.push_back(element(at(type.getShape(), i)));
    replace(type, elements);
  }
  LogicalResult lowerTransfer(VectorTransferOpInterface transfer);
  LogicalResult lowerContract(vector::ContractionOp contract);
  void lowerReduction(vector::MultiDimReductionOp reduction);
  void lowerOuterProduct(vector::OuterProductOp product);
  void lowerScan(vector::ScanOp scan);
  /// For each component of a mask, emits the indices of its element of an array
  /// that has the chosen components in a row.
  SmallVector<SmallVector<Value>> emitCounts(ValueRange mask,
                                             ValueRange indices);

  Operation *op;
  ImplicitLocOpBuilder b;
};
} // namespace

static bool isTooLong(Type type) {
  auto vector = dyn_cast<VectorType>(type);
  return vector &&
         (vector.isScalable() || vector.getNumElements() > kMostComponents);
}

/// Accesses each element of a transfer by itself. Dimension `d` of the array
/// follows the dimension of the vector that the permutation map assigns to it;
/// elements beyond the end of the array are not accessed.
LogicalResult Lowering::lowerTransfer(VectorTransferOpInterface transfer) {
  auto vectorType = cast<VectorType>(transfer.getVectorType());
  Value memref = transfer.getBase();
  AffineMap map = transfer.getPermutationMap();
  if (isa<VectorType>(cast<MemRefType>(memref.getType()).getElementType()))
    return failure();
  SmallVector<Value> mask;
  if (Value given = transfer.getMask()) {
    if (!map.isMinorIdentity())
      return failure();
    mask = getElements(given);
  }
  auto read = dyn_cast<vector::TransferReadOp>(op);
  SmallVector<Value> elements;
  if (!read)
    elements = getElements(cast<vector::TransferWriteOp>(op).getVector());
  SmallVector<Value> sizes(map.getNumDims());
  ArrayRef<int64_t> shape = vectorType.getShape();
  SmallVector<Value> made;
  for (int64_t i = 0, e = vectorType.getNumElements(); i != e; ++i) {
    Position position = at(shape, i);
    SmallVector<Value> indices(transfer.getIndices());
    Value condition = mask.empty() ? Value() : mask[i];
    for (auto [k, result] : llvm::enumerate(map.getResults())) {
      auto dim = dyn_cast<AffineDimExpr>(result);
      if (!dim) // a broadcast
        continue;
      unsigned d = dim.getPosition();
      indices[d] = add(indices[d], position[k]);
      if (transfer.isDimInBounds(k))
        continue;
      if (!sizes[d])
        sizes[d] = b.createOrFold<memref::DimOp>(memref, d);
      Value isInside = arith::CmpIOp::create(b, arith::CmpIPredicate::slt,
                                             indices[d], sizes[d]);
      condition = condition
                      ? Value(arith::AndIOp::create(b, condition, isInside))
                      : isInside;
    }
    if (read)
      made.push_back(loadIf(condition, memref, indices, read.getPadding()));
    else
      storeIf(condition, elements[i], memref, indices);
  }
  if (read)
    replace(vectorType, made);
  return success();
}

LogicalResult Lowering::lowerContract(vector::ContractionOp contract) {
  SmallVector<AffineMap> maps = contract.getIndexingMapsArray();
  SmallVector<int64_t> bounds;
  contract.getIterationBounds(bounds);
  int64_t count = computeProduct(bounds);
  if (count > kMostComponents)
    return failure();
  auto shapeOf = [](Value value) {
    auto type = dyn_cast<VectorType>(value.getType());
    return type ? type.getShape() : ArrayRef<int64_t>();
  };
  SmallVector<Value> lhs = getElements(contract.getLhs());
  SmallVector<Value> rhs = getElements(contract.getRhs());
  SmallVector<Value> sums = getElements(contract.getAcc());
  for (int64_t i = 0; i != count; ++i) {
    Position position = at(bounds, i);
    auto pick = [&](ArrayRef<Value> elements, Value whole, AffineMap map) {
      return elements[number(shapeOf(whole), map.compose(position))];
    };
    Value left = pick(lhs, contract.getLhs(), maps[0]);
    Value right = pick(rhs, contract.getRhs(), maps[1]);
    Value product = isa<FloatType>(left.getType())
                        ? Value(arith::MulFOp::create(b, left, right))
                        : Value(arith::MulIOp::create(b, left, right));
    Value &sum =
        sums[number(shapeOf(contract.getAcc()), maps[2].compose(position))];
    sum = vector::makeArithReduction(b, op->getLoc(), contract.getKind(),
                                     product, sum);
  }
  if (auto type = dyn_cast<VectorType>(contract.getResultType()))
    replace(type, sums);
  else
    op->replaceAllUsesWith(ValueRange{sums.front()});
  return success();
}

void Lowering::lowerReduction(vector::MultiDimReductionOp reduction) {
  VectorType source = reduction.getSourceVectorType();
  SmallVector<Value> elements = getElements(reduction.getSource());
  SmallVector<Value> sums = getElements(reduction.getAcc());
  SmallVector<int64_t> kept;
  SmallVector<bool> mask = reduction.getReductionMask();
  for (auto [size, isReduced] : llvm::zip(source.getShape(), mask))
    if (!isReduced)
      kept.push_back(size);
  for (auto [i, element] : llvm::enumerate(elements)) {
    Position position;
    for (auto [index, isReduced] :
         llvm::zip(at(source.getShape(), static_cast<int64_t>(i)), mask))
      if (!isReduced)
        position.push_back(index);
    Value &sum = sums[number(kept, position)];
    sum = vector::makeArithReduction(b, op->getLoc(), reduction.getKind(),
                                     element, sum);
  }
  if (auto type = dyn_cast<VectorType>(reduction.getDestType()))
    replace(type, sums);
  else
    op->replaceAllUsesWith(ValueRange{sums.front()});
}

void Lowering::lowerOuterProduct(vector::OuterProductOp product) {
  SmallVector<Value> lhs = getElements(product.getLhs());
  SmallVector<Value> rhs = getElements(product.getRhs());
  SmallVector<Value> sums;
  if (Value acc = product.getAcc())
    sums = getElements(acc);
  SmallVector<Value> made;
  for (Value left : lhs)
    for (Value right : rhs) {
      Value value = isa<FloatType>(left.getType())
                        ? Value(arith::MulFOp::create(b, left, right))
                        : Value(arith::MulIOp::create(b, left, right));
      if (!sums.empty())
        value = vector::makeArithReduction(b, op->getLoc(), product.getKind(),
                                           value, sums[made.size()]);
      made.push_back(value);
    }
  replace(product.getResultVectorType(), made);
}

void Lowering::lowerScan(vector::ScanOp scan) {
  SmallVector<Value> elements = getElements(scan.getSource());
  SmallVector<Value> last = getElements(scan.getInitialValue());
  ArrayRef<int64_t> shape = scan.getSourceType().getShape();
  int64_t dimension = scan.getReductionDim();
  SmallVector<int64_t> kept(shape);
  kept.erase(kept.begin() + dimension);
  SmallVector<Value> made(elements.size());
  for (int64_t i = 0, e = shape[dimension]; i != e; ++i)
    for (size_t k = 0; k != last.size(); ++k) {
      Position position = at(kept, static_cast<int64_t>(k));
      position.insert(position.begin() + dimension, i);
      int64_t own = number(shape, position);
      // As upstream lowers it, an inclusive scan begins with the first
      // component, and does not use the initial value.
      if (i == 0) {
        made[own] = scan.getInclusive() ? elements[own] : last[k];
      } else {
        int64_t term = own;
        if (!scan.getInclusive()) {
          --position[dimension];
          term = number(shape, position);
        }
        made[own] = vector::makeArithReduction(b, op->getLoc(), scan.getKind(),
                                               last[k], elements[term]);
      }
      last[k] = made[own];
    }
  Value accumulated = last.front();
  if (auto type = dyn_cast<VectorType>(scan.getInitialValueType()))
    accumulated = vector::FromElementsOp::create(b, type, last);
  op->replaceAllUsesWith(ValueRange{
      vector::FromElementsOp::create(b, scan.getDestType(), made).getResult(),
      accumulated});
}

SmallVector<SmallVector<Value>> Lowering::emitCounts(ValueRange mask,
                                                     ValueRange indices) {
  SmallVector<SmallVector<Value>> places;
  SmallVector<Value> place(indices);
  for (Value chosen : mask) {
    places.push_back(place);
    Value count = arith::IndexCastUIOp::create(b, b.getIndexType(), chosen);
    place.back() = arith::AddIOp::create(b, place.back(), count);
  }
  return places;
}

LogicalResult Lowering::run() {
  if (llvm::any_of(op->getOperandTypes(), isTooLong) ||
      llvm::any_of(op->getResultTypes(), isTooLong))
    return failure();
  if (auto transfer = dyn_cast<VectorTransferOpInterface>(op))
    return lowerTransfer(transfer);
  if (auto load = dyn_cast<vector::LoadOp>(op)) {
    if (isa<VectorType>(load.getMemRefType().getElementType())) {
      Value value =
          memref::LoadOp::create(b, load.getBase(), load.getIndices());
      op->replaceAllUsesWith(ValueRange{value});
      return success();
    }
    this->load(load.getVectorType(), [&](const Position &position) -> Value {
      return memref::LoadOp::create(b, load.getBase(),
                                    move(load.getIndices(), position));
    });
    return success();
  }
  if (auto store = dyn_cast<vector::StoreOp>(op)) {
    if (isa<VectorType>(store.getMemRefType().getElementType())) {
      memref::StoreOp::create(b, store.getValueToStore(), store.getBase(),
                              store.getIndices());
      return success();
    }
    ArrayRef<int64_t> shape = store.getVectorType().getShape();
    for (auto [i, element] :
         llvm::enumerate(getElements(store.getValueToStore())))
      memref::StoreOp::create(
          b, element, store.getBase(),
          move(store.getIndices(), at(shape, static_cast<int64_t>(i))));
    return success();
  }
  if (auto load = dyn_cast<vector::MaskedLoadOp>(op)) {
    SmallVector<Value> mask = getElements(load.getMask());
    SmallVector<Value> other = getElements(load.getPassThru());
    ArrayRef<int64_t> shape = load.getVectorType().getShape();
    this->load(load.getVectorType(), [&](const Position &position) {
      int64_t i = number(shape, position);
      return loadIf(mask[i], load.getBase(), move(load.getIndices(), position),
                    other[i]);
    });
    return success();
  }
  if (auto store = dyn_cast<vector::MaskedStoreOp>(op)) {
    SmallVector<Value> mask = getElements(store.getMask());
    ArrayRef<int64_t> shape = store.getVectorType().getShape();
    for (auto [i, element] :
         llvm::enumerate(getElements(store.getValueToStore())))
      storeIf(mask[i], element, store.getBase(),
              move(store.getIndices(), at(shape, static_cast<int64_t>(i))));
    return success();
  }
  if (auto load = dyn_cast<vector::ExpandLoadOp>(op)) {
    SmallVector<Value> mask = getElements(load.getMask());
    SmallVector<Value> other = getElements(load.getPassThru());
    SmallVector<SmallVector<Value>> places =
        emitCounts(mask, load.getIndices());
    this->load(load.getVectorType(), [&](const Position &position) {
      int64_t i = position.front();
      return loadIf(mask[i], load.getBase(), places[i], other[i]);
    });
    return success();
  }
  if (auto store = dyn_cast<vector::CompressStoreOp>(op)) {
    SmallVector<Value> mask = getElements(store.getMask());
    SmallVector<SmallVector<Value>> places =
        emitCounts(mask, store.getIndices());
    for (auto [i, element] :
         llvm::enumerate(getElements(store.getValueToStore())))
      storeIf(mask[i], element, store.getBase(), places[i]);
    return success();
  }
  if (auto scan = dyn_cast<vector::ScanOp>(op)) {
    lowerScan(scan);
    return success();
  }
  auto moveBy = [&](ValueRange indices, Value offset) {
    SmallVector<Value> moved(indices);
    if (!offset.getType().isIndex())
      offset = arith::IndexCastOp::create(b, b.getIndexType(), offset);
    moved.back() = arith::AddIOp::create(b, moved.back(), offset);
    return moved;
  };
  if (auto gather = dyn_cast<vector::GatherOp>(op)) {
    if (!isa<MemRefType>(gather.getBase().getType()))
      return failure();
    SmallVector<Value> mask = getElements(gather.getMask());
    SmallVector<Value> other = getElements(gather.getPassThru());
    SmallVector<Value> offsets = getElements(gather.getIndices());
    ArrayRef<int64_t> shape = gather.getVectorType().getShape();
    load(gather.getVectorType(), [&](const Position &position) {
      int64_t i = number(shape, position);
      return loadIf(mask[i], gather.getBase(),
                    moveBy(gather.getOffsets(), offsets[i]), other[i]);
    });
    return success();
  }
  if (auto scatter = dyn_cast<vector::ScatterOp>(op)) {
    if (!isa<MemRefType>(scatter.getBase().getType()))
      return failure();
    SmallVector<Value> mask = getElements(scatter.getMask());
    SmallVector<Value> offsets = getElements(scatter.getIndices());
    for (auto [i, element] :
         llvm::enumerate(getElements(scatter.getValueToStore())))
      storeIf(mask[i], element, scatter.getBase(),
              moveBy(scatter.getOffsets(), offsets[i]));
    return success();
  }
  if (auto contract = dyn_cast<vector::ContractionOp>(op))
    return lowerContract(contract);
  if (auto reduction = dyn_cast<vector::MultiDimReductionOp>(op)) {
    lowerReduction(reduction);
    return success();
  }
  if (auto product = dyn_cast<vector::OuterProductOp>(op)) {
    lowerOuterProduct(product);
    return success();
  }
  if (auto extract = dyn_cast<vector::ExtractStridedSliceOp>(op)) {
    SmallVector<Value> elements = getElements(extract.getSource());
    ArrayRef<int64_t> shape = extract.getSourceVectorType().getShape();
    load(extract.getType(), [&](const Position &position) {
      Position moved(position);
      for (auto [i, offset] : llvm::enumerate(extract.getOffsets()))
        moved[i] =
            cast<IntegerAttr>(offset).getInt() +
            moved[i] * cast<IntegerAttr>(extract.getStrides()[i]).getInt();
      return elements[number(shape, moved)];
    });
    return success();
  }
  if (auto interleave = dyn_cast<vector::InterleaveOp>(op)) {
    SmallVector<Value> made;
    for (auto [first, second] : llvm::zip(getElements(interleave.getLhs()),
                                          getElements(interleave.getRhs())))
      made.append({first, second});
    replace(interleave.getResultVectorType(), made);
    return success();
  }
  if (auto deinterleave = dyn_cast<vector::DeinterleaveOp>(op)) {
    SmallVector<Value> parts[2];
    for (auto [i, element] :
         llvm::enumerate(getElements(deinterleave.getSource())))
      parts[i % 2].push_back(element);
    VectorType type = deinterleave.getResultVectorType();
    for (auto [part, result] : llvm::zip(parts, op->getResults()))
      result.replaceAllUsesWith(vector::FromElementsOp::create(b, type, part));
    return success();
  }
  auto insert = cast<vector::InsertStridedSliceOp>(op);
  SmallVector<Value> elements = getElements(insert.getDest());
  VectorType inner = insert.getSourceVectorType();
  VectorType outer = insert.getDestVectorType();
  SmallVector<int64_t> offsets(outer.getRank());
  for (auto [offset, attr] : llvm::zip(offsets, insert.getOffsets()))
    offset = cast<IntegerAttr>(attr).getInt();
  int64_t first = outer.getRank() - inner.getRank();
  for (auto [i, element] :
       llvm::enumerate(getElements(insert.getValueToStore()))) {
    Position position(offsets);
    for (auto [k, index] :
         llvm::enumerate(at(inner.getShape(), static_cast<int64_t>(i))))
      position[first + k] +=
          index * cast<IntegerAttr>(insert.getStrides()[k]).getInt();
    elements[number(outer.getShape(), position)] = element;
  }
  replace(outer, elements);
  return success();
}

static bool isOnTensors(Operation *op) {
  auto isTensor = [](Type type) { return isa<TensorType>(type); };
  return llvm::any_of(op->getOperandTypes(), isTensor) ||
         llvm::any_of(op->getResultTypes(), isTensor);
}

LogicalResult mlir::tai::lowerVectors(func::FuncOp function) {
  SmallVector<Operation *> ops;
  function.walk([&](Operation *op) {
    if (isa<vector::LoadOp, vector::StoreOp, vector::MaskedLoadOp,
            vector::CompressStoreOp, vector::ExpandLoadOp, vector::ScanOp,
            vector::MaskedStoreOp, vector::GatherOp, vector::ScatterOp,
            vector::TransferReadOp, vector::TransferWriteOp,
            vector::ContractionOp, vector::MultiDimReductionOp,
            vector::OuterProductOp, vector::ExtractStridedSliceOp,
            vector::InsertStridedSliceOp, vector::InterleaveOp,
            vector::DeinterleaveOp>(op) &&
        !isOnTensors(op))
      ops.push_back(op);
  });
  for (Operation *op : ops)
    if (succeeded(Lowering(op).run()))
      op->erase();
  return success();
}
