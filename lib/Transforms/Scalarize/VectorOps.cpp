//===- VectorOps.cpp - Expansion of the vector dialect --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Ops that build small vectors and extract components. A dynamic position
// becomes a chain of selects: vectors are small, and memory would cost more.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "Scalarizer.h"
#include "mlir/Dialect/Utils/IndexingUtils.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "llvm/ADT/TypeSwitch.h"

using namespace mlir;
using namespace mlir::tai;

/// Returns the row-major position of a multi-index.
static int64_t getPosition(ArrayRef<int64_t> shape, ArrayRef<int64_t> indices) {
  return linearize(indices, computeSuffixProduct(shape));
}

/// Returns the multi-index of a row-major position.
static SmallVector<int64_t> getIndices(ArrayRef<int64_t> shape,
                                       int64_t position) {
  return delinearize(position, computeSuffixProduct(shape));
}

static ArrayRef<int64_t> getShape(Type type) {
  auto vector = dyn_cast<VectorType>(type);
  return vector ? vector.getShape() : ArrayRef<int64_t>();
}

static int64_t getCount(Type type) {
  auto vector = dyn_cast<VectorType>(type);
  return vector ? vector.getNumElements() : 1;
}

/// Emits the test index == value, as i1.
static Value isAt(OpBuilder &builder, Location loc, Value index,
                  int64_t value) {
  Value constant = arith::ConstantOp::create(
      builder, loc, builder.getIntegerAttr(index.getType(), value));
  return arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::eq, index,
                               constant);
}

/// Calls `visit(position, condition)` for each leading position in a vector
/// that `indices` can have; the condition is null if it always holds.
static void forEachPosition(
    OpBuilder &builder, Location loc, ArrayRef<OpFoldResult> indices,
    ArrayRef<int64_t> shape,
    function_ref<void(ArrayRef<int64_t> position, Value condition)> visit) {
  SmallVector<SmallVector<std::pair<int64_t, Value>>> choices;
  for (auto [index, extent] : llvm::zip(indices, shape)) {
    auto &choice = choices.emplace_back();
    if (std::optional<int64_t> constant = getConstantIntValue(index)) {
      // A constant position outside of the vector, such as -1, is poison.
      if (*constant >= 0 && *constant < extent)
        choice.push_back({*constant, Value()});
      continue;
    }
    for (int64_t i = 0; i != extent; ++i)
      choice.push_back({i, isAt(builder, loc, cast<Value>(index), i)});
  }
  SmallVector<int64_t> position(indices.size());
  std::function<void(size_t, Value)> descend = [&](size_t d, Value condition) {
    if (d == choices.size())
      return visit(position, condition);
    for (auto [at, holds] : choices[d]) {
      position[d] = at;
      Value both = condition && holds
                       ? arith::AndIOp::create(builder, loc, condition, holds)
                             .getResult()
                   : holds ? holds
                           : condition;
      descend(d + 1, both);
    }
  };
  descend(0, Value());
}

static void expandExtract(vector::ExtractOp op, Scalarizer &scalarizer) {
  OpBuilder builder(op);
  Components source = scalarizer.get(op.getSource());
  ArrayRef<int64_t> shape = op.getSourceVectorType().getShape();
  int64_t count = getCount(op.getType());
  Components result(count);
  SmallVector<OpFoldResult> indices = op.getMixedPosition();
  forEachPosition(
      builder, op.getLoc(), indices, shape,
      [&](ArrayRef<int64_t> position, Value condition) {
        int64_t first =
            getPosition(shape.take_front(position.size()), position);
        for (int64_t i = 0; i != count; ++i) {
          Value value = source[first * count + i];
          // The first candidate position is taken without a condition, since
          // one of the conditions holds.
          result[i] = result[i] && condition
                          ? arith::SelectOp::create(builder, op.getLoc(),
                                                    condition, value, result[i])
                                .getResult()
                          : value;
        }
      });
  // Without a candidate, the position is constant and out of range. The first
  // component is taken, as for a position that is out of range at run time.
  for (int64_t i = 0; i != count; ++i)
    if (!result[i])
      result[i] = source[i];
  scalarizer.set(op.getResult(), std::move(result));
}

static void expandInsert(vector::InsertOp op, Scalarizer &scalarizer) {
  OpBuilder builder(op);
  Components result = scalarizer.get(op.getDest());
  Components value = scalarizer.get(op.getValueToStore());
  ArrayRef<int64_t> shape = op.getDestVectorType().getShape();
  int64_t count = value.size();
  SmallVector<OpFoldResult> indices = op.getMixedPosition();
  forEachPosition(
      builder, op.getLoc(), indices, shape,
      [&](ArrayRef<int64_t> position, Value condition) {
        int64_t first =
            getPosition(shape.take_front(position.size()), position);
        for (int64_t i = 0; i != count; ++i) {
          Value &slot = result[first * count + i];
          slot = condition ? arith::SelectOp::create(builder, op.getLoc(),
                                                     condition, value[i], slot)
                                 .getResult()
                           : value[i];
        }
      });
  scalarizer.set(op.getResult(), std::move(result));
}

/// Expands a broadcast with the rules of NumPy: dimensions are matched from the
/// right, and missing and unit dimensions are repeated.
static void expandBroadcast(vector::BroadcastOp op, Scalarizer &scalarizer) {
  Components source = scalarizer.get(op.getSource());
  ArrayRef<int64_t> from = getShape(op.getSourceType());
  ArrayRef<int64_t> to = op.getResultVectorType().getShape();
  Components result;
  for (int64_t i = 0, e = getCount(op.getType()); i != e; ++i) {
    SmallVector<int64_t> at = getIndices(to, i);
    SmallVector<int64_t> sourceAt(ArrayRef(at).take_back(from.size()));
    for (auto [index, extent] : llvm::zip(sourceAt, from))
      index = extent == 1 ? 0 : index;
    result.push_back(source[getPosition(from, sourceAt)]);
  }
  scalarizer.set(op.getResult(), std::move(result));
}

static void expandTranspose(vector::TransposeOp op, Scalarizer &scalarizer) {
  Components source = scalarizer.get(op.getVector());
  ArrayRef<int64_t> from = op.getSourceVectorType().getShape();
  ArrayRef<int64_t> to = op.getResultVectorType().getShape();
  Components result;
  for (int64_t i = 0, e = getCount(op.getType()); i != e; ++i) {
    SmallVector<int64_t> at = getIndices(to, i), sourceAt(from.size());
    for (auto [d, axis] : llvm::enumerate(op.getPermutation()))
      sourceAt[axis] = at[d];
    result.push_back(source[getPosition(from, sourceAt)]);
  }
  scalarizer.set(op.getResult(), std::move(result));
}

static LogicalResult expandReduction(vector::ReductionOp op,
                                     Scalarizer &scalarizer) {
  OpBuilder builder(op);
  Components values = scalarizer.get(op.getVector());
  Value result = op.getAcc();
  for (Value value : values)
    result =
        result ? vector::makeArithReduction(builder, op.getLoc(), op.getKind(),
                                            result, value, op.getFastmathAttr())
               : value;
  scalarizer.set(op.getResult(), {result});
  return success();
}

static void expandMultiReduction(vector::MultiDimReductionOp op,
                                 Scalarizer &scalarizer) {
  OpBuilder builder(op);
  Components values = scalarizer.get(op.getSource());
  Components result = scalarizer.get(op.getAcc());
  ArrayRef<int64_t> from = op.getSourceVectorType().getShape();
  SmallVector<bool> reduced = op.getReductionMask();
  for (int64_t i = 0, e = values.size(); i != e; ++i) {
    int64_t position = 0;
    SmallVector<int64_t> at = getIndices(from, i);
    for (auto [d, extent] : llvm::enumerate(from))
      if (!reduced[d])
        position = position * extent + at[d];
    result[position] = vector::makeArithReduction(
        builder, op.getLoc(), op.getKind(), result[position], values[i]);
  }
  scalarizer.set(op.getResult(), std::move(result));
}

static void expandShuffle(vector::ShuffleOp op, Scalarizer &scalarizer) {
  Components both = scalarizer.get(op.getV1());
  llvm::append_range(both, scalarizer.get(op.getV2()));
  VectorType type = op.getResultVectorType();
  int64_t row = type.getNumElements() / type.getDimSize(0);
  Components result;
  for (int64_t source : op.getMask())
    for (int64_t i = 0; i != row; ++i)
      // An index of -1 in the mask stands for poison, for which any component
      // will do.
      result.push_back(both[std::max<int64_t>(source, 0) * row + i]);
  scalarizer.set(op.getResult(), std::move(result));
}

static SmallVector<int64_t> getIntegers(ArrayAttr attr) {
  return llvm::map_to_vector(
      attr, [](Attribute a) { return cast<IntegerAttr>(a).getInt(); });
}

static void expandExtractSlice(vector::ExtractStridedSliceOp op,
                               Scalarizer &scalarizer) {
  Components source = scalarizer.get(op.getSource());
  ArrayRef<int64_t> from = op.getSourceVectorType().getShape();
  ArrayRef<int64_t> to = cast<VectorType>(op.getType()).getShape();
  SmallVector<int64_t> offsets = getIntegers(op.getOffsets());
  SmallVector<int64_t> strides = getIntegers(op.getStrides());
  Components result;
  for (int64_t i = 0, e = getCount(op.getType()); i != e; ++i) {
    SmallVector<int64_t> at = getIndices(to, i);
    for (size_t d = 0; d != offsets.size(); ++d)
      at[d] = offsets[d] + at[d] * strides[d];
    result.push_back(source[getPosition(from, at)]);
  }
  scalarizer.set(op.getResult(), std::move(result));
}

static void expandInsertSlice(vector::InsertStridedSliceOp op,
                              Scalarizer &scalarizer) {
  Components source = scalarizer.get(op.getValueToStore());
  Components result = scalarizer.get(op.getDest());
  ArrayRef<int64_t> from = op.getSourceVectorType().getShape();
  ArrayRef<int64_t> to = op.getDestVectorType().getShape();
  SmallVector<int64_t> offsets = getIntegers(op.getOffsets());
  SmallVector<int64_t> strides = getIntegers(op.getStrides());
  size_t leading = to.size() - from.size();
  for (int64_t i = 0, e = source.size(); i != e; ++i) {
    SmallVector<int64_t> inner = getIndices(from, i);
    SmallVector<int64_t> at(offsets);
    for (auto [d, index] : llvm::enumerate(inner))
      at[leading + d] += index * strides[d];
    result[getPosition(to, at)] = source[i];
  }
  scalarizer.set(op.getResult(), std::move(result));
}

std::optional<LogicalResult> tai::expandVectorOp(Operation *op,
                                                 Scalarizer &scalarizer) {
  using Result = std::optional<LogicalResult>;
  auto done = [](auto expand, auto op, Scalarizer &scalarizer) -> Result {
    expand(op, scalarizer);
    return success();
  };
  return llvm::TypeSwitch<Operation *, Result>(op)
      .Case([&](vector::FromElementsOp from) -> Result {
        scalarizer.set(from.getResult(), Components(from.getElements()));
        return success();
      })
      .Case([&](vector::ToElementsOp to) -> Result {
        Components parts = scalarizer.get(to.getSource());
        to->replaceAllUsesWith(parts);
        return success();
      })
      .Case([&](vector::ShapeCastOp shapeCast) -> Result {
        scalarizer.set(shapeCast.getResult(),
                       scalarizer.get(shapeCast.getSource()));
        return success();
      })
      .Case([&](vector::FMAOp fma) -> Result {
        OpBuilder builder(fma);
        Components a = scalarizer.get(fma.getLhs());
        Components b = scalarizer.get(fma.getRhs());
        Components c = scalarizer.get(fma.getAcc());
        Components result;
        for (size_t i = 0; i != a.size(); ++i)
          result.push_back(
              math::FmaOp::create(builder, fma.getLoc(), a[i], b[i], c[i]));
        scalarizer.set(fma.getResult(), std::move(result));
        return success();
      })
      .Case([&](vector::ExtractOp x) {
        return done(expandExtract, x, scalarizer);
      })
      .Case(
          [&](vector::InsertOp x) { return done(expandInsert, x, scalarizer); })
      .Case([&](vector::BroadcastOp x) {
        return done(expandBroadcast, x, scalarizer);
      })
      .Case([&](vector::TransposeOp x) {
        return done(expandTranspose, x, scalarizer);
      })
      .Case([&](vector::ReductionOp x) -> Result {
        return expandReduction(x, scalarizer);
      })
      .Case([&](vector::MultiDimReductionOp x) {
        return done(expandMultiReduction, x, scalarizer);
      })
      .Case([&](vector::ShuffleOp x) {
        return done(expandShuffle, x, scalarizer);
      })
      .Case([&](vector::ExtractStridedSliceOp x) {
        return done(expandExtractSlice, x, scalarizer);
      })
      .Case([&](vector::InsertStridedSliceOp x) {
        return done(expandInsertSlice, x, scalarizer);
      })
      .Default([](Operation *) -> Result { return std::nullopt; });
}
