//===- NarrowIndices.cpp - Find modules whose indices fit 32 bits ---------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An index is 64 bits wide unless this pass proves that 32 are enough: device
// code is a fifth faster with them, and wrong if a single value is truncated.
//
// The proof is by induction over the execution: each value of type index must
// fit if its operands did. Values forwarded by loops, branches, locals and
// stacks are copies of values that are checked themselves.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Interfaces/DataLayoutInterfaces.h"
#include "tai/Analysis/Index/IntegerRanges.h"
#include "tai/Conversion/Passes.h"
#include "tai/Conversion/TaiToGPU/Offload.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"

namespace mlir::tai {
#define GEN_PASS_DEF_NARROWINDICES
#include "tai/Conversion/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// The limit of the size of a tree in bytes: sums of a few sizes fit i32.
static constexpr int64_t kMostBytes = int64_t(1) << 30;

/// How far the first index of a field may be from zero, and an index that is
/// used only as a subscript from the range of i32: an index that 32 bits
/// truncate is then out of bounds both before and after truncation.
static constexpr int64_t kMostShift = int64_t(1) << 28;

static ConstantIntRanges getRange(int64_t low, int64_t high) {
  return ConstantIntRanges::fromSigned(
      APInt(64, static_cast<uint64_t>(low), /*isSigned=*/true),
      APInt(64, static_cast<uint64_t>(high), /*isSigned=*/true));
}

static ConstantIntRanges getRangeOfI32() {
  return getRange(std::numeric_limits<int32_t>::min(),
                  std::numeric_limits<int32_t>::max());
}

/// True for the address of an entry of a list of active cells.
static bool isInList(Value address) {
  while (auto element = address.getDefiningOp<LLVM::GEPOp>())
    address = element.getBase();
  return address.getDefiningOp<ActiveCellsOp>() != nullptr;
}

namespace {
/// Proves that 32 bits are enough for the kernels and trees of one module.
class Proof {
public:
  Proof(ModuleOp module, bool remarks)
      : module(module), remarks(remarks),
        ranges([this](Value value) { return getInductiveRange(value); }) {}
  bool run();

private:
  std::optional<ConstantIntRanges> getInductiveRange(Value value);
  ConstantIntRanges getWhileRange(scf::WhileOp loop, BlockArgument argument);
  bool fits(FieldOp field);
  bool fits(Value index);
  bool isSubscript(Value index);
  bool readsAllBits(Operation *op);
  bool fits(scf::ForOp loop);
  bool fits(ParallelForOp loop);

  /// Fails the proof that 32 bits are enough: returns false, and emits a remark
  /// with the reason if remarks are wanted.
  bool fail(Operation *op, StringRef reason) {
    if (remarks)
      op->emitRemark("indices have 64 bits: ") << reason;
    return false;
  }

  ModuleOp module;
  bool remarks;
  IntegerRanges ranges;
};
} // namespace

/// Collects comparisons that hold wherever `condition` holds.
static void collectConditions(Value condition,
                              SmallVectorImpl<arith::CmpIOp> &conditions) {
  if (auto both = condition.getDefiningOp<arith::AndIOp>()) {
    collectConditions(both.getLhs(), conditions);
    collectConditions(both.getRhs(), conditions);
  } else if (auto compare = condition.getDefiningOp<arith::CmpIOp>()) {
    conditions.push_back(compare);
  }
}

/// The range of an argument of a while loop. The body runs only while the
/// condition holds: a counter compared with an end is below that end there, and
/// may be incremented.
ConstantIntRanges Proof::getWhileRange(scf::WhileOp loop,
                                       BlockArgument argument) {
  ConstantIntRanges range = getRangeOfI32();
  if (argument.getOwner() != loop.getAfterBody())
    return range;
  scf::ConditionOp end = loop.getConditionOp();
  Value handedOn = end.getArgs()[argument.getArgNumber()];
  SmallVector<arith::CmpIOp> conditions;
  collectConditions(end.getCondition(), conditions);
  for (arith::CmpIOp compare : conditions)
    if (compare.getPredicate() == arith::CmpIPredicate::slt &&
        compare.getLhs() == handedOn) {
      int64_t limit = ranges.get(compare.getRhs()).smax().getSExtValue();
      if (limit <= range.smax().getSExtValue())
        return getRange(range.smin().getSExtValue(), limit - 1);
    }
  return range;
}

/// Returns the range of a value, assuming that all indices computed earlier fit
/// 32 bits.
std::optional<ConstantIntRanges> Proof::getInductiveRange(Value value) {
  if (!value.getType().isIntOrIndex())
    return std::nullopt;
  Operation *op = value.getDefiningOp();
  // A level has no more cells than its tree has bytes, so numbers of cells have
  // this range.
  if (isa_and_present<ActiveCellsOp, LengthOp, AppendOp>(op))
    return value.getType().isIndex() ? std::optional(getRange(0, kMostBytes))
                                     : std::nullopt;
  if (auto load = dyn_cast_if_present<LLVM::LoadOp>(op))
    return value.getType().isInteger(64) && isInList(load.getAddr())
               ? std::optional(getRange(0, kMostBytes))
               : std::nullopt;
  if (!value.getType().isIndex())
    return std::nullopt;
  if (isa_and_present<LocalLoadOp, StackPopOp, scf::ForOp, scf::WhileOp,
                      scf::IndexSwitchOp>(op))
    return getRangeOfI32();
  if (auto argument = dyn_cast<BlockArgument>(value)) {
    Operation *parent = argument.getOwner()->getParentOp();
    if (auto loop = dyn_cast_if_present<scf::WhileOp>(parent))
      return getWhileRange(loop, argument);
    auto loop = dyn_cast_if_present<scf::ForOp>(parent);
    if (loop && argument != loop.getInductionVar())
      return getRangeOfI32();
  }
  return std::nullopt;
}

/// True if the field has few enough cells for 32 bits, and its first indices
/// are not far from zero.
bool Proof::fits(FieldOp field) {
  FailureOr<FieldLayout> layout = getFieldLayout(field);
  if (failed(layout))
    return false;
  int64_t cells = 1;
  for (const auto &level : layout->path.levels)
    if (llvm::MulOverflow(cells, level.type.getNumCells(), cells) ||
        cells > kMostBytes)
      return false;
  return llvm::all_of(layout->offset, [](int64_t first) {
    return -kMostShift <= first && first <= kMostShift;
  });
}

bool Proof::fits(Value index) {
  Type type = index.getType();
  if (auto vector = dyn_cast<VectorType>(type))
    type = vector.getElementType();
  if (!type.isIndex())
    return true;
  ConstantIntRanges range = ranges.get(index);
  if (range.smin().isSignedIntN(32) && range.smax().isSignedIntN(32))
    return true;
  // A subscript may exceed 32 bits by a small constant, as in x[t + 1] for any
  // t of type i32.
  return -kMostShift <= range.smin().getSExtValue() -
                            std::numeric_limits<int32_t>::min() &&
         range.smax().getSExtValue() - std::numeric_limits<int32_t>::max() <=
             kMostShift &&
         isSubscript(index);
}

/// True for a sum or difference that is used only as an index of accesses.
bool Proof::isSubscript(Value index) {
  if (!isa_and_present<arith::AddIOp, arith::SubIOp>(index.getDefiningOp()))
    return false;
  return llvm::all_of(index.getUses(), [&](OpOperand &use) {
    Operation *user = use.getOwner();
    unsigned number = use.getOperandNumber();
    if (isa<arith::AddIOp, arith::SubIOp>(user))
      return isSubscript(user->getResult(0));
    if (auto load = dyn_cast<LoadOp>(user))
      return number < load.getIndices().size();
    // Operand 0 of a store is the stored value; the indices follow.
    if (auto store = dyn_cast<StoreOp>(user))
      return number != 0 && number <= store.getIndices().size();
    if (auto atomic = dyn_cast<AtomicOp>(user))
      return number != 0 && number <= atomic.getIndices().size();
    return false;
  });
}

/// True if the result of the operation may depend on bits of an index above the
/// low 32: on the high bits of a negative index that is read as unsigned, say.
bool Proof::readsAllBits(Operation *op) {
  auto isNegative = [&](Value value) {
    return getElementTypeOrSelf(value).isIndex() &&
           ranges.get(value).smin().isNegative();
  };
  if (isa<math::CountLeadingZerosOp, math::CountTrailingZerosOp, math::CtPopOp>(
          op))
    return getElementTypeOrSelf(op->getResult(0)).isIndex();
  if (isa<arith::ShLIOp, arith::ShRSIOp, arith::ShRUIOp>(op) &&
      getElementTypeOrSelf(op->getResult(0)).isIndex() &&
      ranges.get(op->getOperand(1)).umax().uge(32))
    return true;
  return isa<arith::DivUIOp, arith::RemUIOp, arith::CeilDivUIOp, arith::ShRUIOp,
             arith::IndexCastUIOp>(op) &&
         llvm::any_of(op->getOperands(), isNegative);
}

bool Proof::fits(scf::ForOp loop) {
  if (!loop.getUpperBound().getType().isIndex())
    return true;
  if (loop.getUnsignedCmp())
    return false;
  // In a signed loop, the index is at most the bound minus one before the step
  // is added to it.
  ConstantIntRanges upper = ranges.get(loop.getUpperBound());
  ConstantIntRanges step = ranges.get(loop.getStep());
  return step.smin().isStrictlyPositive() &&
         upper.smax().getSExtValue() + step.smax().getSExtValue() <= int64_t(1)
                                                                         << 31;
}

bool Proof::fits(ParallelForOp loop) {
  int64_t count = 1;
  for (auto [from, to] :
       llvm::zip(loop.getLowerBounds(), loop.getUpperBounds())) {
    int64_t extent = ranges.get(to).smax().getSExtValue() -
                     ranges.get(from).smin().getSExtValue();
    if (extent > std::numeric_limits<int32_t>::max() ||
        llvm::MulOverflow(count, std::max<int64_t>(extent, 0), count))
      return false;
  }
  if (count <= kMostBytes)
    return true;
  // A loop over the iterations of a thread compares its index as unsigned and
  // only adds the stride of the grid to it; a warp's loop adds more.
  return loop.getLowerBounds().size() == 1 && !loop.getInWarp() &&
         !getConstantIntValue(loop.getUpperBounds().front());
}

bool Proof::run() {
  DataLayout layout(module);
  for (TreeOp tree : module.getOps<TreeOp>())
    if (getTreeSize(tree.getLayout(), layout).total > uint64_t(kMostBytes))
      return fail(tree, "the tree is larger than 1 GiB");
  for (FieldOp field : module.getOps<FieldOp>())
    if (!fits(field))
      return fail(field, "the field has too many cells, or begins far away");
  auto fitsAll = [&](auto values) {
    return llvm::all_of(values, [&](Value value) { return fits(value); });
  };
  for (auto kernel : module.getOps<KernelOp>()) {
    // A kernel with arrays is not narrowed, because their sizes are known only
    // at the launch.
    if (llvm::any_of(kernel.getArgumentTypes(), llvm::IsaPred<MemRefType>))
      return fail(kernel, "how large an array is, its launch says");
    WalkResult result = kernel->walk([&](Operation *op) {
      bool good = fitsAll(op->getResults());
      for (Region &region : op->getRegions())
        for (Block &block : region)
          good = good && fitsAll(block.getArguments());
      if (!good || readsAllBits(op) || isa<func::CallOp>(op))
        return fail(op, "a value may not fit 32"), WalkResult::interrupt();
      if (auto loop = dyn_cast<scf::ForOp>(op))
        good = fits(loop);
      if (auto loop = dyn_cast<ParallelForOp>(op))
        good = fits(loop);
      if (!good)
        return fail(op, "the loop may count beyond 32"),
               WalkResult::interrupt();
      return WalkResult::advance();
    });
    if (result.wasInterrupted())
      return false;
  }
  return true;
}

namespace {
struct NarrowIndices : tai::impl::NarrowIndicesBase<NarrowIndices> {
  using Base::Base;

  void runOnOperation() override {
    ModuleOp module = getOperation();
    // Modules without kernels are left as they are.
    if (module.getOps<KernelOp>().empty())
      return;
    if (Proof(module, remarks).run())
      module->setAttr(kIndexBitsAttrName,
                      OpBuilder(module).getI64IntegerAttr(32));
    else
      module->removeAttr(kIndexBitsAttrName);
  }
};
} // namespace
