//===- BlockLoop.cpp - Analysis of loops over blocks ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "BlockLoop.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Matchers.h"
#include "tai/Analysis/Index/IndexShift.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"

using namespace mlir;
using namespace mlir::tai;

/// The shortest row of elements that is worth vector operations, and the
/// longest row that LLVM splits into a few registers.
static constexpr int64_t kShortestRow = 4, kLongestRow = 64;

/// The largest distance of neighbours in a row, in elements of the field.
static constexpr int64_t kLargestStep = 4;

const IndexDigit *tai::findInnermost(const FieldInfo &field,
                                     unsigned dimension) {
  for (const IndexDigit &digit : field.storage.digits)
    if (digit.dimension == dimension && digit.divisor == 1 && digit.extent != 1)
      return &digit;
  return nullptr;
}

bool BlockLoop::findBlock(FieldTable &fields) {
  FailureOr<const FieldInfo *> found = fields.lookup(loop, loop.getFieldAttr());
  if (failed(found))
    return false;
  field = *found;
  ArrayRef<PathLevel> levels = field->layout.path.levels;
  if (levels.size() < 2 || levels.back().type.isSparse())
    return false;
  extents.assign(field->layout.shape.size(), 1);
  const IndexDigit *row = nullptr;
  for (const IndexDigit &digit : field->storage.digits) {
    if (digit.level + 1 != levels.size() || digit.extent == 1)
      continue;
    extents[digit.dimension] = digit.extent;
    if (!row || digit.stride < row->stride)
      row = &digit;
  }
  if (!row || row->extent < kShortestRow || row->extent > kLongestRow ||
      !llvm::isPowerOf2_64(row->extent))
    return false;
  rowDimension = row->dimension;
  lower = llvm::to_vector(field->layout.offset);
  for (auto [first, extent] :
       llvm::zip(field->layout.offset, field->layout.shape))
    upper.push_back(first + extent);
  return true;
}

/// True if each block of the loop lies in one cell of a sparse level of another
/// field.
bool BlockLoop::coversBlocks(const FieldInfo &other, unsigned level) const {
  if (other.layout.offset != field->layout.offset)
    return false;
  SmallVector<int64_t> inner(extents.size(), 1);
  for (const IndexDigit &digit : other.storage.digits)
    if (digit.level > level)
      inner[digit.dimension] *= digit.extent;
  return llvm::all_of(llvm::zip(inner, extents), [](auto pair) {
    return std::get<0>(pair) % std::get<1>(pair) == 0;
  });
}

/// Adds the cells whose activity `op` queries to the neighbours that must be
/// active in the interior. False if that is not possible.
bool BlockLoop::addNeighbours(IsActiveOp op, FieldTable &fields) {
  FailureOr<const FieldInfo *> found = fields.lookup(op, op.getFieldAttr());
  if (failed(found) || (*found)->sparse.empty() ||
      (*found)->sparse.back().type.isList() ||
      op.getIndices().size() != extents.size())
    return false;
  const FieldInfo &other = **found;
  unsigned level = other.layout.path.levels.size() - op.getLevel();
  if (!coversBlocks(other, level))
    return false;
  BlockAccess access{op, &other, {}, 0, std::nullopt};
  SmallVector<SmallVector<int64_t>> distances(1);
  for (auto [d, index] : llvm::enumerate(op.getIndices())) {
    IndexForm &form = access.indices.emplace_back();
    if (!getForm(index, form) || !form.isShift() || form.variable != d)
      return false;
    int64_t first = llvm::divideFloorSigned(form.shift, extents[d]);
    int64_t last =
        llvm::divideFloorSigned(form.shift + extents[d] - 1, extents[d]);
    SmallVector<SmallVector<int64_t>> longer;
    for (int64_t distance = first; distance <= last; ++distance)
      for (SmallVector<int64_t> &all : distances) {
        longer.push_back(all);
        longer.back().push_back(distance);
      }
    distances = std::move(longer);
  }
  require(access);
  for (SmallVector<int64_t> &distance : distances) {
    Neighbour neighbour{op.getFieldAttr(), int64_t(op.getLevel()),
                        std::move(distance)};
    if (!llvm::is_contained(neighbours, neighbour))
      neighbours.push_back(std::move(neighbour));
  }
  return true;
}

void BlockLoop::findAnswers(FieldTable &fields) {
  Region &body = loop.getBody();
  llvm::SmallDenseMap<Value, unsigned> dimensions;
  for (auto [dimension, iv] : llvm::enumerate(loop.getInductionVars()))
    dimensions[iv] = dimension;
  body.walk([&](Operation *op) {
    if (auto ask = dyn_cast<IsActiveOp>(op)) {
      if (addNeighbours(ask, fields))
        answers[ask.getActive()] = true;
      return;
    }
    for (Value result : op->getResults()) {
      SmallVector<Value> variables;
      if (!result.getType().isInteger(1) ||
          matchPattern(result, m_Constant()) ||
          !collectIndexVariables(result, body, variables) ||
          variables.size() != 1 || !dimensions.contains(variables.front()))
        continue;
      unsigned d = dimensions[variables.front()];
      std::optional<ConstantStretch> stretch =
          getConstantStretch(result, variables.front(), field->layout.offset[d],
                             field->layout.offset[d] + field->layout.shape[d]);
      // A condition that is constant over less than half of the dimension is
      // not split off, since little of the loop would be without the condition.
      if (!stretch ||
          2 * (stretch->upper - stretch->lower) < field->layout.shape[d])
        continue;
      answers[result] = stretch->answer;
      lower[d] = std::max(lower[d], stretch->lower);
      upper[d] = std::min(upper[d], stretch->upper);
    }
  });
  // Truth values that follow from the conditions that are constant in the
  // interior are found here.
  body.walk([&](Operation *op) {
    if (op->getNumResults() != 1 || answers.contains(op->getResult(0)) ||
        !op->getResult(0).getType().isInteger(1))
      return;
    SmallVector<Attribute> operands;
    for (Value operand : op->getOperands()) {
      Attribute constant;
      if (auto known = answers.find(operand); known != answers.end())
        constant = BoolAttr::get(op->getContext(), known->second);
      else
        matchPattern(operand, m_Constant(&constant));
      operands.push_back(constant);
    }
    SmallVector<OpFoldResult> results;
    // A clone of the op is folded, because folding may change an op in place.
    Operation *copy = op->cloneWithoutRegions();
    std::optional<bool> answer;
    if (succeeded(copy->fold(operands, results)) && results.size() == 1) {
      if (auto same = dyn_cast<Value>(results[0])) {
        // The op folds to one of its operands, whose truth value may be known
        // already.
        if (auto known = answers.find(same); known != answers.end())
          answer = known->second;
      } else if (auto constant =
                     dyn_cast<IntegerAttr>(cast<Attribute>(results[0]))) {
        answer = !constant.getValue().isZero();
      }
    }
    if (answer)
      answers[op->getResult(0)] = *answer;
    copy->destroy();
  });
}

bool BlockLoop::getForm(Value index, IndexForm &form) {
  Region &body = loop.getBody();
  SmallVector<Value> variables;
  if (!body.isAncestor(index.getParentRegion()) ||
      matchPattern(index, m_Constant())) {
    form.invariant = index;
    return true;
  }
  if (!collectIndexVariables(index, body, variables) || variables.size() != 1)
    return false;
  auto ivs = loop.getInductionVars();
  auto *iv = llvm::find(ivs, variables.front());
  if (iv == ivs.end())
    return false;
  unsigned d = iv - ivs.begin();
  int64_t first = field->layout.offset[d];
  int64_t end = first + field->layout.shape[d];
  std::optional<IndexShift> shift = getIndexShift(index, *iv, first, end);
  if (!shift)
    return false;
  form.variable = d;
  form.shift = shift->offset;
  if (shift->wraps) {
    lower[d] = std::max(lower[d], first - std::min<int64_t>(shift->offset, 0));
    upper[d] = std::min(upper[d], end - std::max<int64_t>(shift->offset, 0));
  }
  return true;
}

/// True if a row of iterations accesses elements in one row, or in parts of two
/// rows, of the field.
bool BlockLoop::isRowAccess(BlockAccess &access) {
  const FieldInfo &other = *access.field;
  for (auto [position, form] : llvm::enumerate(access.indices)) {
    if (!form.isShift() || form.variable != rowDimension)
      continue;
    if (access.rowIndex)
      return false; // a diagonal
    access.rowIndex = position;
  }
  if (!access.rowIndex)
    return true;
  const IndexDigit *digit = findInnermost(other, *access.rowIndex);
  if (!digit || digit->level + 1 != other.layout.path.levels.size() ||
      digit->stride % other.scalarSize != 0 ||
      other.cellOffset % other.scalarSize != 0 ||
      int64_t(digit->stride) / other.scalarSize > kLargestStep)
    return false;
  return digit->extent == other.layout.shape[*access.rowIndex] ||
         digit->extent == rowLength();
}

/// True if the written elements are in one row of blocks that are active, or
/// that one op can activate.
bool BlockLoop::canWrite(BlockAccess &access) {
  if (!access.rowIndex)
    return false;
  const FieldInfo &other = *access.field;
  const IndexForm &form = access.indices[*access.rowIndex];
  int64_t shift = form.shift + field->layout.offset[rowDimension] -
                  other.layout.offset[*access.rowIndex];
  const IndexDigit *digit = findInnermost(other, *access.rowIndex);
  bool isWhole = digit->extent == other.layout.shape[*access.rowIndex];
  if (!isWhole && shift % rowLength() != 0)
    return false;
  if (other.sparse.empty() || access.op->hasAttr(kActiveAttrName))
    return true;
  // One op can activate the block only if the block lies in one cell of the
  // innermost sparse level.
  if (other.sparse.back().type.isList() ||
      access.indices.size() != extents.size())
    return false;
  if (!coversBlocks(other, other.sparse.back().level))
    return false;
  for (auto [d, form] : llvm::enumerate(access.indices))
    if (!form.isShift() || form.variable != d || form.shift != 0)
      return false;
  return true;
}

void BlockLoop::require(const BlockAccess &access) {
  for (auto [index, form] : llvm::enumerate(access.indices)) {
    if (!form.isShift())
      continue;
    unsigned d = form.variable;
    int64_t first = access.field->layout.offset[index];
    int64_t end = first + access.field->layout.shape[index];
    lower[d] = std::max(lower[d], first - form.shift);
    upper[d] = std::min(upper[d], end - form.shift);
  }
}

bool BlockLoop::addAccess(Operation *op, FieldTable &fields) {
  auto named = cast<FieldAccessOpInterface>(op);
  FailureOr<const FieldInfo *> found = fields.lookup(op, named.getFieldAttr());
  if (failed(found))
    return false;
  BlockAccess access{op, *found, {}, 0, std::nullopt};
  const FieldInfo &other = *access.field;
  ValueRange indices = named.getIndices(), components = named.getComponents();
  // Only operations on an iteration's own data can be done for a whole row at a
  // time.
  if (auto atomic = dyn_cast<AtomicOp>(op);
      atomic && (!atomic.getExclusive() || !atomic->use_empty()))
    return false;
  // Truth values are stored in memory as bytes.
  Type scalar = other.scalarType;
  if (!isa<FloatType>(scalar) &&
      !(isa<IntegerType>(scalar) && !scalar.isInteger(1)))
    return false;
  for (auto [extent, component] : llvm::zip(other.elementShape, components)) {
    std::optional<int64_t> at = getConstantIntValue(component);
    if (!at)
      return false;
    access.component = access.component * extent + *at;
  }
  if (components.empty() && other.numComponents != 1)
    return false;
  for (Value index : indices)
    if (!getForm(index, access.indices.emplace_back()))
      return false;
  if (!isRowAccess(access) || (!isa<LoadOp>(op) && !canWrite(access)))
    return false;
  require(access);
  accesses.insert({op, std::move(access)});
  return true;
}

/// True if a scalar op has a vector form that does the same to each element.
static bool isRowOp(Operation *op) {
  if (isa_and_present<math::MathDialect>(op->getDialect()) &&
      !isa<math::AbsFOp, math::AbsIOp, math::SqrtOp, math::FloorOp,
           math::CeilOp, math::TruncOp, math::RoundEvenOp, math::FmaOp,
           math::CopySignOp>(op))
    return false; // calls of libm, one for each element
  return OpTrait::hasElementwiseMappableTraits(op) &&
         llvm::all_of(op->getOperandTypes(),
                      [](Type type) { return type.isIntOrIndexOrFloat(); });
}

bool BlockLoop::analyzeBody(Block &block, FieldTable &fields) {
  for (Operation &op : block) {
    ++numOps;
    if (op.hasTrait<OpTrait::IsTerminator>() ||
        op.hasTrait<OpTrait::ConstantLike>())
      continue;
    if (auto branch = dyn_cast<scf::IfOp>(op)) {
      auto answer = answers.find(branch.getCondition());
      if (answer == answers.end())
        return false;
      Region &taken =
          answer->second ? branch.getThenRegion() : branch.getElseRegion();
      if (!taken.empty() && !analyzeBody(taken.front(), fields))
        return false;
      continue;
    }
    if (isa<IsActiveOp>(op)) {
      if (!answers.contains(op.getResult(0)))
        return false;
      continue;
    }
    if (isa<LoadOp, StoreOp, AtomicOp>(op)) {
      if (!addAccess(&op, fields))
        return false;
      continue;
    }
    if (!isRowOp(&op))
      return false;
  }
  return true;
}

/// True if a storage that is written is also accessed at other places. The
/// order of the iterations of a block would then matter.
static bool readsNeighboursOfWrites(
    const llvm::MapVector<Operation *, BlockAccess> &accesses) {
  for (const auto &[op, write] : accesses) {
    if (isa<LoadOp>(op))
      continue;
    for (const auto &[other, access] : accesses) {
      if (access.field->scope != write.field->scope)
        continue;
      if (!llvm::equal(access.indices, write.indices,
                       [](const IndexForm &a, const IndexForm &b) {
                         return a.invariant == b.invariant &&
                                a.variable == b.variable && a.shift == b.shift;
                       }))
        return true;
    }
  }
  return false;
}

std::optional<BlockLoop> BlockLoop::analyze(ParallelForOp loop,
                                            FieldTable &fields) {
  BlockLoop result;
  result.loop = loop;
  if (!loop.isStructFor() || loop.getLevel() || loop.getSerialize() ||
      loop.getInOrder() || loop->getParentOfType<ParallelForOp>() ||
      !result.findBlock(fields))
    return std::nullopt;
  result.findAnswers(fields);
  if (!result.analyzeBody(loop.getBody().front(), fields) ||
      readsNeighboursOfWrites(result.accesses))
    return std::nullopt;
  llvm::SmallDenseSet<std::pair<Operation *, unsigned>> cells;
  bool writes = false;
  for (auto &[op, access] : result.accesses) {
    if (isa<LoadOp>(op))
      continue;
    writes = true;
    if (!access.field->sparse.empty() && !op->hasAttr(kActiveAttrName) &&
        cells
            .insert(
                {access.field->layout.tree, access.field->sparse.back().node})
            .second)
      result.activations.push_back(&access);
  }
  if (!writes)
    return std::nullopt;
  for (auto [low, high, extent] :
       llvm::zip(result.lower, result.upper, result.extents))
    if (high - low < extent)
      return std::nullopt; // no block is in the interior
  return result;
}
